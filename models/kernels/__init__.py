"""Parts for compiled code of other layers: compiler, elementary functions, forces along the sinkage."""

from bayesterra.models.kernels.compiler import Lanes, compiled, inlined
from bayesterra.models.kernels.elementary import exp, log
from bayesterra.models.kernels.grid_search import can_fall
from bayesterra.models.kernels.pairs import Codes, Plan, screen
from bayesterra.models.kernels.tracing import (
    CURVE,
    CURVE_SIZE,
    DEGREE,
    FREE,
    HALF,
    LOG_NORMAL,
    MIDDLE,
    MOMENT,
    POINTS,
    PULL,
    carrying_from,
    guess,
    highest,
    lay,
    trace,
)

__all__ = [
    "CURVE",
    "CURVE_SIZE",
    "DEGREE",
    "FREE",
    "HALF",
    "LOG_NORMAL",
    "MIDDLE",
    "MOMENT",
    "POINTS",
    "PULL",
    "Codes",
    "Lanes",
    "Plan",
    "can_fall",
    "carrying_from",
    "compiled",
    "exp",
    "guess",
    "highest",
    "inlined",
    "lay",
    "log",
    "screen",
    "trace",
]
