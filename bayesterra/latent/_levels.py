"""Compiled log integrand of a row over log sinkage, on polynomials of the forces.

A row's likelihood is the integral of dW = (dF_N/dx) dx over x = log z of the densities of its readings. Here
t = −1..1 is the place on a curve of :mod:`bayesterra.models.kernels`.
"""

import numpy as np

from bayesterra.models import kernels as at
from bayesterra.models.kernels import Lanes, compiled, exp, inlined, log

SINKAGE, NORMAL, PULL, MOMENT = range(4)
CHANNELS = 4
PLACES = 1024
"""Places at which the integrand can be held at once."""

# A desk is one flat array, so that LLVM can prove that nothing overlaps. Behind the model's lanes and curve
# stand: the row's specification, channel by channel: reading, scale = max(fraction |value|, floor), degrees
# of freedom, highest log density there is, zero error
READING, FLOOR, FRACTION, DOF, PEAK, SHIFT = range(6)
COLUMNS = 6
SPEC = at.FREE
# what the search knows, see _panels; the curve that the drawn load lies on; places on the curve at hand, and
# the log integrand and what a channel should read there; intervals that are still to do
FOUND = SPEC + CHANNELS * COLUMNS
CHOSEN = FOUND + 16
T = CHOSEN + at.CURVE_SIZE
LEVEL = T + PLACES + 1
MODELLED = LEVEL + PLACES + 1
STACK = MODELLED + PLACES + 1
PANELS, PARTS = 128, 64
PART = STACK + 2 * PANELS
DESK_SIZE = PART + 4 * PARTS

NOTHING = -1e300
_FLAT = 1e-12


@inlined
def spec(desk: Lanes, channel: int, column: int) -> float:
    """One entry of the specification of a row."""
    return float(desk[SPEC + channel * COLUMNS + column])


@inlined
def is_read(desk: Lanes, channel: int) -> bool:
    """Whether a channel was measured."""
    reading = spec(desk, channel, READING)
    return reading == reading


Powers = tuple[float, float, float, float, float, float, float, float]


@inlined
def powers(desk: Lanes, first: int) -> Powers:
    """Coefficients of a polynomial: in registers, so that loops over places become vector code."""
    return (
        desk[first], desk[first + 1], desk[first + 2], desk[first + 3],
        desk[first + 4], desk[first + 5], desk[first + 6], desk[first + 7],
    )  # fmt: skip


@inlined
def sum_powers(a: Powers, t: float) -> float:
    """Value of a polynomial."""
    return a[0] + t * (a[1] + t * (a[2] + t * (a[3] + t * (a[4] + t * (a[5] + t * (a[6] + t * a[7]))))))


@inlined
def derive_powers(a: Powers, t: float) -> float:
    """Derivative of a polynomial."""
    tail = 4.0 * a[4] + t * (5.0 * a[5] + t * (6.0 * a[6] + t * 7.0 * a[7]))
    return a[1] + t * (2.0 * a[2] + t * (3.0 * a[3] + t * tail))


@inlined
def polynomial(desk: Lanes, first: int, t: float) -> float:
    """Value of one of the curve's polynomials."""
    return float(sum_powers(powers(desk, first), t))


@inlined
def slope(desk: Lanes, t: float) -> float:
    """Derivative of log F_N by log z."""
    return float(derive_powers(powers(desk, at.LOG_NORMAL), t) / desk[at.HALF])


@inlined
def curve_of(channel: int) -> int:
    """Where the polynomial of a force begins."""
    return at.LOG_NORMAL if channel == NORMAL else at.PULL if channel == PULL else at.MOMENT


@compiled
def value(desk: Lanes, channel: int, t: float) -> float:
    """What a channel should read, without zero error."""
    if channel == SINKAGE:
        return float(exp(desk[at.MIDDLE] + desk[at.HALF] * t))
    found = polynomial(desk, curve_of(channel), t)
    return float(exp(found) if channel == NORMAL else found)


@compiled
def log_law(desk: Lanes, channel: int, modelled: float) -> float:
    """Log density of a channel's reading; 0 where there is none."""
    if not is_read(desk, channel):
        return 0.0
    centre = modelled + spec(desk, channel, SHIFT)
    scale = max(spec(desk, channel, FRACTION) * abs(centre), spec(desk, channel, FLOOR))
    r = (spec(desk, channel, READING) - centre) / scale
    dof = spec(desk, channel, DOF)
    shape = -0.5 * r * r if np.isinf(dof) else -0.5 * (dof + 1.0) * np.log1p(r * r / dof)
    return float(spec(desk, channel, PEAK) - np.log(scale / spec(desk, channel, FLOOR)) + shape)


@compiled
def log_law_peak(desk: Lanes, channel: int) -> float:
    """Highest log density that a channel's reading can have."""
    return float(spec(desk, channel, PEAK)) if is_read(desk, channel) else 0.0


@compiled
def fill_levels(desk: Lanes, count: int) -> None:
    """Fill the log integrand at the first ``count`` places."""
    growth, half = powers(desk, at.LOG_NORMAL), 1.0 / desk[at.HALF]
    for k in range(count):
        rise = derive_powers(growth, desk[T + k]) * half
        desk[LEVEL + k] = sum_powers(growth, desk[T + k]) + log(rise if rise > _FLAT else _FLAT)
    for channel in range(CHANNELS):
        if is_read(desk, channel):
            _fill_modelled(desk, channel, count)
            _add_law(desk, channel, count)


@inlined
def _fill_modelled(desk: Lanes, channel: int, count: int) -> None:
    """Fill what a channel should read at the first ``count`` places."""
    shift = spec(desk, channel, SHIFT)
    if channel == SINKAGE:
        middle, half = desk[at.MIDDLE], desk[at.HALF]
        for k in range(count):
            desk[MODELLED + k] = exp(middle + half * desk[T + k]) + shift
        return
    a = powers(desk, curve_of(channel))
    for k in range(count):
        desk[MODELLED + k] = sum_powers(a, desk[T + k])
    if channel == NORMAL:
        for k in range(count):
            desk[MODELLED + k] = exp(desk[MODELLED + k])


@inlined
def _add_law(desk: Lanes, channel: int, count: int) -> None:
    """Add the log density of a reading, given what it should read."""
    per, fraction = 1.0 / spec(desk, channel, FLOOR), spec(desk, channel, FRACTION)
    reading, peak, dof = spec(desk, channel, READING), spec(desk, channel, PEAK), spec(desk, channel, DOF)
    if fraction == 0.0:
        for k in range(count):
            desk[MODELLED + k] = (reading - desk[MODELLED + k]) * per
    else:
        for k in range(count):
            growth = fraction * per * abs(desk[MODELLED + k])
            growth = growth if growth > 1.0 else 1.0
            desk[MODELLED + k] = (reading - desk[MODELLED + k]) * per / growth
            desk[LEVEL + k] -= log(growth)
    if np.isinf(dof):
        for k in range(count):
            desk[LEVEL + k] += peak - 0.5 * desk[MODELLED + k] * desk[MODELLED + k]
    else:
        for k in range(count):
            far = 1.0 + desk[MODELLED + k] * desk[MODELLED + k] / dof
            desk[LEVEL + k] += peak - 0.5 * (dof + 1.0) * log(far)


@compiled
def finest(desk: Lanes, low: float, high: float) -> float:
    """Distance of places that shows every reading by itself; the whole part where the noise is Gaussian.

    A product of Gaussians is no wider than any of them, and so shows at once how narrow it is; heavy tails
    hide a narrow law inside a wide one.
    """
    step = high - low
    for channel in range(CHANNELS):
        if not is_read(desk, channel) or np.isinf(spec(desk, channel, DOF)):
            continue
        for k in range(5):
            t = low + 0.25 * k * (high - low)
            modelled, near = value(desk, channel, t), value(desk, channel, t + 1e-4 * (high - low))
            steep = abs(near - modelled) / (1e-4 * (high - low))
            scale = max(spec(desk, channel, FRACTION) * abs(modelled), spec(desk, channel, FLOOR))
            step = min(step, 0.7 * scale / max(steep, 1e-300))
    return float(step)


@compiled
def add_up(desk: Lanes, count: int, top: float) -> float:
    """Sum of the first ``count`` integrands, scaled by the level ``top``; takes the levels' place."""
    for k in range(count):
        desk[LEVEL + k] = exp(desk[LEVEL + k] - top)
    total = 0.0
    for k in range(count):
        total += desk[LEVEL + k]
    return total


@compiled
def doubt(desk: Lanes, t: float) -> float:
    """Estimate the error of the log integrand at ``t`` that the polynomials leave."""
    growth, rise = tail(desk, at.LOG_NORMAL), max(slope(desk, t), _FLAT)
    total = 16.0 * growth / (desk[at.HALF] * rise)
    for channel in range(CHANNELS):
        if not is_read(desk, channel):
            continue
        modelled = value(desk, channel, t)
        centre = modelled + spec(desk, channel, SHIFT)
        scale = max(spec(desk, channel, FRACTION) * abs(centre), spec(desk, channel, FLOOR))
        error = modelled * growth if channel == NORMAL else modelled * growth / rise  # of an end of the range
        error = error if channel < PULL else tail(desk, curve_of(channel))
        total += (1.0 + abs(spec(desk, channel, READING) - centre) / scale) * error / scale
    return float(total)


@compiled
def tail(desk: Lanes, first: int) -> float:
    """Estimate what a polynomial leaves out, from how fast its Chebyshev coefficients decay."""
    a7, a6 = desk[first + 7] / 64.0, desk[first + 6] / 32.0
    a5, a4 = (desk[first + 5] + 112.0 * a7) / 16.0, (desk[first + 4] + 48.0 * a6) / 8.0
    last, before = max(abs(a7), abs(a6)), max(abs(a5), abs(a4))
    rate = np.sqrt(min(last / max(before, 1e-300), 0.8))
    return float(2.0 * last * rate / (1.0 - rate))


@compiled
def place_of(desk: Lanes, log_normal: float, low: float, high: float) -> float:
    """Place between ``low`` and ``high`` where log F_N, which rises there, has a value; Newton, bracketed."""
    t = 0.5 * (low + high)
    for _ in range(60):
        miss = polynomial(desk, at.LOG_NORMAL, t) - log_normal
        low, high = (t, high) if miss < 0.0 else (low, t)
        move = miss / max(slope(desk, t) * desk[at.HALF], _FLAT)
        if abs(move) < 1e-12:
            break
        t = t - move if low < t - move < high else 0.5 * (low + high)
    return float(t)


@compiled
def crest_of(desk: Lanes) -> float:
    """Highest place up to which F_N rises: 1 if it rises all along, −1 if it falls from the start."""
    low = -1.0
    for k in range(1, 17):
        high = -1.0 + k / 8.0
        if slope(desk, high) <= 0.0:
            for _ in range(50):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if slope(desk, middle) > 0.0 else (low, middle)
            return low
        low = high
    return 1.0
