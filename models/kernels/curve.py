"""The curve of a traced row at a place t = −1..1: log F_N, F_DP and M_DR as polynomials over log sinkage."""

from __future__ import annotations

import numpy as np

from bayesterra.models.kernels.compiler import Lanes, called, inlined
from bayesterra.models.kernels.tracing import HALF, LOG_NORMAL

FLAT = 1e-12
"""Smallest slope of log F_N that counts as one."""
Powers = tuple[float, float, float, float, float, float, float, float]


@inlined
def powers(workspace: Lanes, first: int) -> Powers:
    """Coefficients of a polynomial: in registers, so that loops over places become vector code."""
    return (
        workspace[first], workspace[first + 1], workspace[first + 2], workspace[first + 3],
        workspace[first + 4], workspace[first + 5], workspace[first + 6], workspace[first + 7],
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
def polynomial(workspace: Lanes, first: int, t: float) -> float:
    """Value of one of the curve's polynomials."""
    return float(sum_powers(powers(workspace, first), t))


@inlined
def slope(workspace: Lanes, t: float) -> float:
    """Derivative of log F_N by log z."""
    return float(derive_powers(powers(workspace, LOG_NORMAL), t) / workspace[HALF])


@called
def tail(workspace: Lanes, first: int) -> float:
    """Estimate what a polynomial leaves out, from how fast its Chebyshev coefficients decay."""
    a7, a6 = workspace[first + 7] / 64.0, workspace[first + 6] / 32.0
    a5, a4 = (workspace[first + 5] + 112.0 * a7) / 16.0, (workspace[first + 4] + 48.0 * a6) / 8.0
    last, before = max(abs(a7), abs(a6)), max(abs(a5), abs(a4))
    rate = np.sqrt(min(last / max(before, 1e-300), 0.8))
    return float(2.0 * last * rate / (1.0 - rate))


@called
def place_of(workspace: Lanes, log_normal: float, low: float, high: float) -> float:
    """Place between ``low`` and ``high`` where log F_N, which rises there, has a value; Newton, bracketed."""
    t = 0.5 * (low + high)
    for _ in range(60):
        miss = polynomial(workspace, LOG_NORMAL, t) - log_normal
        low, high = (t, high) if miss < 0.0 else (low, t)
        move = miss / max(slope(workspace, t) * workspace[HALF], FLAT)
        if abs(move) < 1e-12:
            break
        t = t - move if low < t - move < high else 0.5 * (low + high)
    return float(t)


@called
def crest_of(workspace: Lanes) -> float:
    """Highest place up to which F_N rises: 1 if it rises all along, −1 if it falls from the start."""
    low = -1.0
    for k in range(1, 17):
        high = -1.0 + k / 8.0
        if slope(workspace, high) <= 0.0:
            for _ in range(50):
                middle = 0.5 * (low + high)
                low, high = (middle, high) if slope(workspace, middle) > 0.0 else (low, middle)
            return low
        low = high
    return 1.0
