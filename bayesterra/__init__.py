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

    from bayesterra.analysis.comparison import compare as compare
    from bayesterra.analysis.inference import run_prior as run_prior
    from bayesterra.analysis.run import load_result as load_result
    from bayesterra.analysis.run import run as run
    from bayesterra.analysis.simulation import simulate as simulate
    from bayesterra.checking.calibration import calibrate as calibrate
    from bayesterra.checking.holdout import Holdout as Holdout
    from bayesterra.checking.holdout import leave_out as leave_out
    from bayesterra.checking.ranks import Calibration as Calibration
    from bayesterra.design.choosing import Design as Design
    from bayesterra.design.recommendation import recommend as recommend
    from bayesterra.errors import BayesterraError as BayesterraError
    from bayesterra.errors import EngineError as EngineError
    from bayesterra.errors import ResultError as ResultError
    from bayesterra.errors import StudyError as StudyError
    from bayesterra.errors import SupportError as SupportError
    from bayesterra.follow.stream import Stream as Stream
    from bayesterra.follow.stream import load_stream as load_stream
    from bayesterra.identifiability.analysis import Identified as Identified
    from bayesterra.identifiability.analysis import foresee as foresee
    from bayesterra.identifiability.analysis import identify as identify
    from bayesterra.least_squares.fit import fit as fit
    from bayesterra.least_squares.results import Fit as Fit
    from bayesterra.likelihood.posterior import Posterior as Posterior
    from bayesterra.likelihood.posterior import posterior as posterior
    from bayesterra.models import Soil as Soil
    from bayesterra.models import Wheel as Wheel
    from bayesterra.prediction.outlook import predict_rover as predict_rover
    from bayesterra.prediction.prediction import predict as predict
    from bayesterra.prediction.rover import Rover as Rover
    from bayesterra.runtime.checkpoints import read_tasks as read_tasks
    from bayesterra.runtime.engines import Engine as Engine
    from bayesterra.runtime.engines import dask_cluster as dask_cluster
    from bayesterra.runtime.engines import in_process as in_process
    from bayesterra.runtime.engines import local_pool as local_pool
    from bayesterra.soiltests.analysis import soil_test as soil_test
    from bayesterra.soiltests.study import load_soil_test as load_soil_test
    from bayesterra.stats.laws import Law as Law
    from bayesterra.study.noise import Noise as Noise
    from bayesterra.study.priors import Prior as Prior
    from bayesterra.study.result import Result as Result
    from bayesterra.study.study import Study as Study
    from bayesterra.study.study import load_study as load_study

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
    "identifiability.analysis": ("foresee", "identify", "Identified"),
    "least_squares.fit": ("fit",),
    "least_squares.results": ("Fit",),
    "likelihood.posterior": ("Posterior", "posterior"),
    "models": ("Soil", "Wheel"),
    "prediction.outlook": ("predict_rover",),
    "prediction.prediction": ("predict",),
    "prediction.rover": ("Rover",),
    "runtime.engines": ("dask_cluster", "Engine", "in_process", "local_pool"),
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
__all__ = [name for names in _HOMES.values() for name in names]


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
