"""Compiled M2 (CM1) and M3 (CM2): integrals of piecewise linear stresses in closed form; and M2L.

M2L is M2 with the load effect of Ding et al. 2015, eq. (42). Written with M2's peak shear stress, (42c) says that the
stress at theta_m grows by

    d_tau = c_M (1 - F_N / W_mean) F_N  E tan(phi) / (b r A),

and (42a) then that F_N = F_0 + b r_s B d_tau with F_0, the F_N of M2: a quadratic equation for F_N at a given
sinkage. For c_M < 0 it has two roots or none. The lower one is F_0 at c_M = 0 and grows with F_0; on the
other one F_N falls as the wheel sinks, which holds no wheel. Where there is none, F_N goes on continuously,
so that a search can come back, and UNDER_ROOT is negative.
"""

from typing import Any

from bayesterra.models.kernels import lanes as at
from bayesterra.models.kernels.compiler import Lanes, called, inlined
from bayesterra.models.kernels.elementary import divide, exp, exp_minus_1, log, root, sin, versine


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


_SMALLEST = 1e-300


@called
def close_under_load(ws: Lanes) -> None:
    """Fill the integrals of M2 with the shear stress of (42c), and what multiplies F_DP in (42b)."""
    for i in range(at.LANES):
        a_1, a_2, b_1, b_2, sigma, limit, built_up = triangles(ws, i, False)
        tau = limit * built_up
        width, radius, a, b = ws[at.WIDTH + i], ws[at.RADIUS + i], a_1 + a_2, b_1 + b_2
        plain = width * (radius * sigma * a + ws[at.SHEARING_RADIUS + i] * tau * b)  # F_N of M2, (24)
        friction = divide(built_up * ws[at.TAN_PHI + i], radius * a)
        normal = _normal_force(ws, i, plain, ws[at.SHEARING_RADIUS + i] * b * friction)
        spare = 1.0 - divide(normal, ws[at.MEAN_LOAD + i])
        tau = tau + divide(ws[at.CM + i] * spare * normal * friction, width)
        fill(ws, i, (a_1, a_2, b_1, b_2), sigma, tau, 1.0)
        by_slip = 1.0 + ws[at.CP1 + i] + ws[at.CP2 + i] * ws[at.SLIP + i]
        ws[at.PULL_FACTOR + i] = by_slip * (1.0 + ws[at.CDP + i] * spare)


@inlined
def _normal_force(ws: Lanes, i: int, plain: Any, share: Any) -> Any:
    """The lower root F of F - share c_M (1 - F / W_mean) F = plain."""
    growth = ws[at.CM + i] * share
    line = 1.0 - growth
    under_root = line * line + 4.0 * divide(growth * plain, ws[at.MEAN_LOAD + i])
    ws[at.UNDER_ROOT + i] = under_root
    held = under_root if under_root.real > _SMALLEST else _SMALLEST + 0.0 * under_root
    return divide(2.0 * plain, line + root(held))


@called
def scale_pull(ws: Lanes) -> None:
    """Multiply F_DP and its components by what (42b) has beyond M2's F_DP."""
    for i in range(at.LANES):
        factor = ws[at.PULL_FACTOR + i]
        ws[at.PULL + i] *= factor
        ws[at.PULL_TAU_1 + i] *= factor
        ws[at.PULL_TAU_2 + i] *= factor
        ws[at.PULL_SIGMA_1 + i] *= factor
        ws[at.PULL_SIGMA_2 + i] *= factor
