"""Parts for compiled code of other layers: compiler, elementary functions, forces along the sinkage."""

from bayesterra.models.kernels.compiler import Lanes, called, compiled, inlined
from bayesterra.models.kernels.curve import (
    FLAT,
    crest_of,
    derive_powers,
    place_of,
    polynomial,
    powers,
    slope,
    sum_powers,
    tail,
)
from bayesterra.models.kernels.elementary import exp, log
from bayesterra.models.kernels.evaluation import Kind
from bayesterra.models.kernels.pairs import Codes, Plan, screen
from bayesterra.models.kernels.solver import can_fall
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
    "FLAT",
    "FREE",
    "HALF",
    "LOG_NORMAL",
    "MIDDLE",
    "MOMENT",
    "POINTS",
    "PULL",
    "Codes",
    "Kind",
    "Lanes",
    "Plan",
    "called",
    "can_fall",
    "carrying_from",
    "compiled",
    "crest_of",
    "derive_powers",
    "exp",
    "guess",
    "highest",
    "inlined",
    "lay",
    "log",
    "place_of",
    "polynomial",
    "powers",
    "screen",
    "slope",
    "sum_powers",
    "tail",
    "trace",
]
