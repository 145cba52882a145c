"""Compiled M1: the stresses integrated by quadrature.

Angles are measured from the stress-free ends, and every difference of cosines or sines is a product of
half-angle sines, so nothing cancels on short arcs. Node u of the rear part mirrors node u of the front part:
one power serves both.
"""

from typing import Any

from bayesterra.models.kernels import lanes as at
from bayesterra.models.kernels.compiler import Lanes, called, inlined
from bayesterra.models.kernels.elementary import exp, exp_minus_1, log, sin, versine
from bayesterra.models.kernels.quadrature import NODES, STARTS, WEIGHTS


@called
def integrate(ws: Lanes, which: int) -> None:
    """Fill the integrals of (4) and (9) in (14), (15) with quadrature rule `which`."""
    for i in range(at.SC1, at.SC1 + 2 * at.SUMS * at.LANES):
        ws[i] = 0.0
    for k in range(STARTS[which], STARTS[which + 1]):
        for i in range(at.LANES):
            sigma, limit = _add_front(ws, i, NODES[k], WEIGHTS[k])
            _add_rear(ws, i, NODES[k], sigma, limit)
    for q in range(at.SUMS):
        for i in range(at.LANES):
            ws[at.SC1 + q * at.LANES + i] *= 2.0 * ws[at.FRONT + i]
            ws[at.SC2 + q * at.LANES + i] *= 2.0 * ws[at.REAR + i]


@inlined
def _add_front(ws: Lanes, i: int, u: float, weight: float) -> tuple[Any, Any]:
    """Add a front node to the sums; return its normal stress and shear strength, weighted."""
    half = ws[at.FRONT + i] * u
    s, c = sin(half), 1.0 - versine(half)
    rise = 2.0 * s * (ws[at.SIN_1 + i] * c - ws[at.COS_1 + i] * s)  # cos(theta) - cos(theta_1)
    fall = 2.0 * s * (ws[at.SIN_1 + i] * s + ws[at.COS_1 + i] * c)  # sin(theta_1) - sin(theta)
    sigma = ws[at.KS + i] * weight * exp(ws[at.N + i] * log(ws[at.RADIUS + i] * rise))
    limit = ws[at.C + i] * weight + sigma * ws[at.TAN_PHI + i]
    path = ws[at.JOIN_1 + i] + 2.0 * half - (1.0 - ws[at.SLIP + i]) * fall
    tau = -limit * exp_minus_1(-ws[at.RS_OVER_K + i] * path)
    cosine, sine = ws[at.COS_1 + i] + rise, ws[at.SIN_1 + i] - fall
    ws[at.SC1 + i] += sigma * cosine
    ws[at.SS1 + i] += sigma * sine
    ws[at.TC1 + i] += tau * cosine
    ws[at.TS1 + i] += tau * sine
    ws[at.T1 + i] += tau
    return sigma, limit


@inlined
def _add_rear(ws: Lanes, i: int, u: float, sigma: Any, limit: Any) -> None:
    """Add the rear node that mirrors a front node to the sums."""
    half = ws[at.REAR + i] * u
    s, c = sin(half), 1.0 - versine(half)
    rise = 2.0 * s * (ws[at.COS_2 + i] * c - ws[at.SIN_2 + i] * s)  # sin(theta) - sin(theta_2)
    fall = 2.0 * s * (ws[at.SIN_2 + i] * c + ws[at.COS_2 + i] * s)  # cos(theta_2) - cos(theta)
    path = ws[at.JOIN_2 + i] - 2.0 * half + (1.0 - ws[at.SLIP + i]) * rise
    tau = -limit * exp_minus_1(-ws[at.RS_OVER_K + i] * path)
    cosine, sine = ws[at.COS_2 + i] - fall, ws[at.SIN_2 + i] + rise
    ws[at.SC2 + i] += sigma * cosine
    ws[at.SS2 + i] += sigma * sine
    ws[at.TC2 + i] += tau * cosine
    ws[at.TS2 + i] += tau * sine
    ws[at.T2 + i] += tau
