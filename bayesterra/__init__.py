"""Bayesian inference for the mechanical parameters of planetary soil from wheel tests.

>>> import bayesterra as bt
>>> wheel = bt.Wheel(radius=0.135, width=0.165, lug_height=0.015, lug_count=24)
>>> round(wheel.shearing_radius(0.5568), 4)
0.1462
"""

from __future__ import annotations

from importlib import import_module

_HOMES = {
    "analysis.comparison": ("compare",),
    "analysis.inference": ("run_prior",),
    "analysis.run": ("load_result", "run", "soil_test"),
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
    "stats.laws": ("Law",),
    "study.noise": ("Noise",),
    "study.priors": ("Prior",),
    "study.result": ("Result",),
    "study.soil_test_file": ("load_soil_test",),
    "study.study": ("load_study", "Study"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}
__all__ = [name for names in _HOMES.values() for name in names]


def __getattr__(name: str) -> object:
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
