"""Compiled M2 (CM1) and M3 (CM2): integrals of piecewise linear stresses in closed form."""

from typing import Any

from bayesterra.models.kernels import lanes as at
from bayesterra.models.kernels.compiler import Lanes, called, inlined
from bayesterra.models.kernels.elementary import divide, exp, exp_minus_1, log, sin, versine


@called
def close(ws: Lanes, cosine_is_linear: bool) -> None:
    """Fill the integrals of Ding et al. 2015, eqs. (18)-(24) for CM1, (25) and (26) for CM2.

    A and B of (24) are split at theta_m: the front part of A is its second term less sin(theta_m), the rest
    the rear part; likewise B with cos(theta_m).
    """
    keep = 0.0 if cosine_is_linear else 1.0  # CM2 drops F_Ntau
    for i in range(at.LANES):
        a_1, a_2, b_1, b_2, sigma, limit, built_up = triangles(ws, i, cosine_is_linear)
        fill(ws, i, (a_1, a_2, b_1, b_2), sigma, limit * built_up, keep)


@inlined
def triangles(ws: Lanes, i: int, cosine_is_linear: bool) -> tuple[Any, Any, Any, Any, Any, Any, Any]:
    """Both parts of A, both of B, sigma_m, c + sigma_m tan(phi) and the share E of it in tau_m."""
    front, rear = ws[at.FRONT + i], ws[at.REAR + i]
    theta_m = ws[at.THETA_2 + i] + 2.0 * rear
    sin_m, cos_m = sin(theta_m), 1.0 - versine(theta_m)
    sine_1, cosine_1 = _mean(front, ws[at.SIN_1 + i], ws[at.COS_1 + i], -1.0)
    sine_2, cosine_2 = _mean(rear, ws[at.SIN_2 + i], ws[at.COS_2 + i], 1.0)
    sigma, limit, built_up = _peaks(ws, i, 2.0 * front * sine_1, 2.0 * front * cosine_1)
    a_1 = front * cos_m if cosine_is_linear else sine_1 - sin_m
    a_2 = rear * cos_m if cosine_is_linear else sin_m - sine_2
    return a_1, a_2, cos_m - cosine_1, cosine_2 - cos_m, sigma, limit, built_up


@inlined
def fill(ws: Lanes, i: int, parts: tuple[Any, Any, Any, Any], sigma: Any, tau: Any, keep: float) -> None:
    """Fill the integrals of a lane from both parts of A and B and the peaks; `keep` = 0 drops F_Ntau."""
    a_1, a_2, b_1, b_2 = parts
    ws[at.SC1 + i] = sigma * a_1
    ws[at.SC2 + i] = sigma * a_2
    ws[at.SS1 + i] = sigma * b_1
    ws[at.SS2 + i] = sigma * b_2
    ws[at.TC1 + i] = tau * a_1
    ws[at.TC2 + i] = tau * a_2
    ws[at.TS1 + i] = tau * b_1 * keep
    ws[at.TS2 + i] = tau * b_2 * keep
    ws[at.T1 + i] = tau * ws[at.FRONT + i]
    ws[at.T2 + i] = tau * ws[at.REAR + i]


@inlined
def _mean(half: Any, sin_end: Any, cos_end: Any, side: float) -> tuple[Any, Any]:
    """Mean sine and cosine over a part of half-width `half` that begins at the end given."""
    s, c = sin(half), 1.0 - versine(half)
    share = divide(s, half)
    return share * (sin_end * c + side * cos_end * s), share * (cos_end * c - side * sin_end * s)


@inlined
def _peaks(ws: Lanes, i: int, rise: Any, fall: Any) -> tuple[Any, Any, Any]:
    """sigma_m and both factors of tau_m, (18), (19); `rise`, `fall` as in _integral, at theta_m."""
    sigma = ws[at.KS + i] * exp(ws[at.N + i] * log(ws[at.RADIUS + i] * rise))
    limit = ws[at.C + i] + sigma * ws[at.TAN_PHI + i]
    path = ws[at.JOIN_1 + i] + 2.0 * ws[at.FRONT + i] - (1.0 - ws[at.SLIP + i]) * fall
    return sigma, limit, -exp_minus_1(-ws[at.RS_OVER_K + i] * path)
