"""Compiled M2L: M2 with the load effect of Ding et al. 2015, eq. (42).

Written with M2's peak shear stress, (42c) says that the stress at theta_m grows by

    d_tau = c_M (1 - F_N / W_mean) F_N  E tan(phi) / (b r A),

and (42a) then that F_N = F_0 + b r_s B d_tau with F_0, the F_N of M2: a quadratic equation for F_N at a given
sinkage. For c_M < 0 it has two roots or none. The lower one is F_0 at c_M = 0 and grows with F_0; on the
other one F_N falls as the wheel sinks, which holds no wheel. Where there is none, F_N goes on continuously,
so that a search can come back, and UNDER_ROOT is negative.
"""

from typing import Any

from bayesterra.models.kernels import lanes as at
from bayesterra.models.kernels.closed_form import fill, triangles
from bayesterra.models.kernels.compiler import Lanes, called, inlined
from bayesterra.models.kernels.elementary import divide, root

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
