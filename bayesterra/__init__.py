"""Bayesian inference for the mechanical parameters of planetary soil from wheel tests.

>>> import bayesterra as bt
>>> wheel = bt.Wheel(radius=0.135, width=0.165, lug_height=0.015, lug_count=24)
>>> round(wheel.shearing_radius(0.5568), 4)
0.1462
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from bayesterra.calibrating import CalibrationResult, calibrate
    from bayesterra.designing import Recommendation, recommend
    from bayesterra.engines import Engine, dask_cluster, in_process, local_pool
    from bayesterra.errors import BayesterraError, EngineError, ResultError, StudyError, SupportError
    from bayesterra.followup import compare, predict
    from bayesterra.identification import Fit, fit
    from bayesterra.identifying import IdentifyResult, foresee, identify
    from bayesterra.leaving import HoldoutResult, leave_out
    from bayesterra.models import Soil, Wheel
    from bayesterra.noise import Noise
    from bayesterra.posteriors import Posterior, posterior
    from bayesterra.priors import Law, Prior
    from bayesterra.rover.geometry import Rover
    from bayesterra.roving import predict_rover
    from bayesterra.simulation import simulate
    from bayesterra.soiltesting import load_soil_test, soil_test
    from bayesterra.streaming.stream import Stream, load_stream
    from bayesterra.study import Study, load_study
    from bayesterra.taskstore import read_tasks
    from bayesterra.workflow import RunResult, load_result, run, run_prior

_HOMES = {
    "calibrating": ("CalibrationResult", "calibrate"),
    "designing": ("Recommendation", "recommend"),
    "engines": ("Engine", "dask_cluster", "in_process", "local_pool"),
    "errors": ("BayesterraError", "EngineError", "ResultError", "StudyError", "SupportError"),
    "followup": ("compare", "predict"),
    "identification": ("Fit", "fit"),
    "identifying": ("IdentifyResult", "foresee", "identify"),
    "leaving": ("HoldoutResult", "leave_out"),
    "models": ("Soil", "Wheel"),
    "noise": ("Noise",),
    "posteriors": ("Posterior", "posterior"),
    "priors": ("Law", "Prior"),
    "rover.geometry": ("Rover",),
    "roving": ("predict_rover",),
    "simulation": ("simulate",),
    "streaming.stream": ("Stream", "load_stream"),
    "taskstore": ("read_tasks",),
    "soiltesting": ("load_soil_test", "soil_test"),
    "study": ("Study", "load_study"),
    "workflow": ("RunResult", "load_result", "run", "run_prior"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [
    "BayesterraError",
    "CalibrationResult",
    "Engine",
    "EngineError",
    "Fit",
    "HoldoutResult",
    "IdentifyResult",
    "Law",
    "Noise",
    "Posterior",
    "Prior",
    "Recommendation",
    "ResultError",
    "Rover",
    "RunResult",
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
    if name not in _HOME:
        raise AttributeError(f"module 'bayesterra' has no attribute {name!r}")
    return getattr(import_module(f"bayesterra.{_HOME[name]}"), name)
