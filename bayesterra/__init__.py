"""Bayesian inference for the mechanical parameters of planetary soil from wheel tests.

>>> import bayesterra as bt
>>> wheel = bt.Wheel(radius=0.135, width=0.165, lug_height=0.015, lug_count=24)
>>> round(wheel.shearing_radius(0.5568), 4)
0.1462
"""

from __future__ import annotations

from importlib import import_module

TYPE_CHECKING = False  # checkers of types take it as true; the module 'typing' itself takes time to load
if TYPE_CHECKING:
    from typing import Any

    from bayesterra.analysis.comparison import compare
    from bayesterra.analysis.inference import run_prior
    from bayesterra.analysis.run import load_result, run
    from bayesterra.analysis.simulation import simulate
    from bayesterra.checking.calibration import calibrate
    from bayesterra.checking.holdout import Holdout, leave_out
    from bayesterra.checking.ranks import Calibration
    from bayesterra.design.choosing import Design
    from bayesterra.design.recommendation import recommend
    from bayesterra.errors import BayesterraError, EngineError, ResultError, StudyError, SupportError
    from bayesterra.follow.stream import Stream, load_stream
    from bayesterra.identifiability.identify import Identified, foresee, identify
    from bayesterra.least_squares.fit import fit
    from bayesterra.least_squares.results import Fit
    from bayesterra.likelihood.posterior import Posterior, posterior
    from bayesterra.models import Soil, Wheel
    from bayesterra.prediction.outlook import predict_rover
    from bayesterra.prediction.prediction import predict
    from bayesterra.prediction.rover import Rover
    from bayesterra.runtime.checkpoints import read_tasks
    from bayesterra.runtime.dask import dask_cluster
    from bayesterra.runtime.engines import Engine, in_process, local_pool
    from bayesterra.soiltests.analysis import soil_test
    from bayesterra.soiltests.study import load_soil_test
    from bayesterra.stats.laws import Law
    from bayesterra.study.noise import Noise
    from bayesterra.study.priors import Prior
    from bayesterra.study.result import Result
    from bayesterra.study.study import Study, load_study

_HOMES = {
    "analysis.comparison": ("compare",),
    "analysis.inference": ("run_prior",),
    "analysis.run": ("load_result", "run"),
    "analysis.simulation": ("simulate",),
    "checking.calibration": ("calibrate",),
    "checking.holdout": ("Holdout", "leave_out"),
    "checking.ranks": ("Calibration",),
    "design.choosing": ("Design",),
    "design.recommendation": ("recommend",),
    "errors": ("BayesterraError", "EngineError", "ResultError", "StudyError", "SupportError"),
    "follow.stream": ("load_stream", "Stream"),
    "identifiability.identify": ("foresee", "identify", "Identified"),
    "least_squares.fit": ("fit",),
    "least_squares.results": ("Fit",),
    "likelihood.posterior": ("Posterior", "posterior"),
    "models": ("Soil", "Wheel"),
    "prediction.outlook": ("predict_rover",),
    "prediction.prediction": ("predict",),
    "prediction.rover": ("Rover",),
    "runtime.dask": ("dask_cluster",),
    "runtime.engines": ("Engine", "in_process", "local_pool"),
    "runtime.checkpoints": ("read_tasks",),
    "soiltests.analysis": ("soil_test",),
    "soiltests.study": ("load_soil_test",),
    "stats.laws": ("Law",),
    "study.noise": ("Noise",),
    "study.priors": ("Prior",),
    "study.result": ("Result",),
    "study.study": ("load_study", "Study"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "BayesterraError",
    "Calibration",
    "Design",
    "Engine",
    "EngineError",
    "Fit",
    "Holdout",
    "Identified",
    "Law",
    "Noise",
    "Posterior",
    "Prior",
    "Result",
    "ResultError",
    "Rover",
    "Soil",
    "Stream",
    "Study",
    "StudyError",
    "SupportError",
    "Wheel",
    "calibrate",
    "compare",
    "dask_cluster",
    "fit",
    "foresee",
    "identify",
    "in_process",
    "leave_out",
    "load_result",
    "load_soil_test",
    "load_stream",
    "load_study",
    "local_pool",
    "posterior",
    "predict",
    "predict_rover",
    "read_tasks",
    "recommend",
    "run",
    "run_prior",
    "simulate",
    "soil_test",
]


def __getattr__(name: str) -> Any:
    """Import a public name where it is first used: help and version must come at once."""
    if name == "__version__":
        from importlib.metadata import version

        return version("bayesterra")
    if name not in _HOME:
        raise AttributeError(f"module 'bayesterra' has no attribute {name!r}")
    return getattr(import_module(f"bayesterra.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    """Public names too, so that a notebook completes them before they are imported."""
    return sorted({*globals(), *__all__, "__version__"})
