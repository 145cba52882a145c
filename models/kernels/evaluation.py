"""Compiled evaluation of eight lanes by one of the models: the contact arc, integrals, and the forces from them."""

from bayesterra.models.kernels import lanes as at
from bayesterra.models.kernels.closed_form import close, close_under_load, scale_pull
from bayesterra.models.kernels.compiler import Lanes, called
from bayesterra.models.kernels.elementary import angle_of_versine, divide, root, sin, versine
from bayesterra.models.kernels.integral import integrate


@called
def measure(ws: Lanes) -> None:
    """Fill the arc from the inputs, Ding et al. 2015, eqs. (5)-(8), (11), (12)."""
    for i in range(at.LANES):
        depth = divide(ws[at.Z + i], ws[at.RADIUS + i])
        ws[at.COS_1 + i] = 1.0 - depth
        ws[at.SIN_1 + i] = root(depth * (2.0 - depth))
        theta_1 = angle_of_versine(depth)
        reach = divide(ws[at.START_RADIUS + i] - ws[at.RADIUS + i] + ws[at.Z + i], ws[at.START_RADIUS + i])
        start = angle_of_versine(reach)
        sin_start = root(reach * (2.0 - reach))
        ratio = ws[at.C1 + i] + ws[at.C2 + i] * ws[at.SLIP + i]
        theta_2 = ws[at.C3 + i] * theta_1
        ws[at.THETA_2 + i] = theta_2
        ws[at.SIN_2 + i] = sin(theta_2)
        ws[at.COS_2 + i] = 1.0 - versine(theta_2)
        ws[at.FRONT + i] = 0.5 * theta_1 * (1.0 - ratio)
        ws[at.REAR + i] = 0.5 * theta_1 * (ratio - ws[at.C3 + i])
        drag = 1.0 - ws[at.SLIP + i]
        ws[at.JOIN_1 + i] = (start - theta_1) - drag * (sin_start - ws[at.SIN_1 + i])
        ws[at.JOIN_2 + i] = (start - theta_2) - drag * (sin_start - ws[at.SIN_2 + i])
        ws[at.N + i] = ws[at.N0 + i] + ws[at.N1 + i] * ws[at.EXPONENT_SLIP + i]
        ws[at.TAN_PHI + i] = divide(sin(ws[at.PHI + i]), 1.0 - versine(ws[at.PHI + i]))
        ws[at.RS_OVER_K + i] = divide(ws[at.SHEARING_RADIUS + i], ws[at.K + i])


@called
def assemble(ws: Lanes) -> None:
    """Fill forces and components from the integrals, eqs. (14), (15)."""
    for i in range(at.LANES):
        normal_arm = ws[at.WIDTH + i] * ws[at.RADIUS + i]
        shear_arm = ws[at.WIDTH + i] * ws[at.SHEARING_RADIUS + i]
        ws[at.MOMENT + i] = shear_arm * ws[at.SHEARING_RADIUS + i] * (ws[at.T1 + i] + ws[at.T2 + i])
        ws[at.N_SIGMA_1 + i] = normal_arm * ws[at.SC1 + i]
        ws[at.N_SIGMA_2 + i] = normal_arm * ws[at.SC2 + i]
        ws[at.N_TAU_1 + i] = shear_arm * ws[at.TS1 + i]
        ws[at.N_TAU_2 + i] = shear_arm * ws[at.TS2 + i]
        ws[at.PULL_TAU_1 + i] = shear_arm * ws[at.TC1 + i]
        ws[at.PULL_TAU_2 + i] = shear_arm * ws[at.TC2 + i]
        ws[at.PULL_SIGMA_1 + i] = normal_arm * ws[at.SS1 + i]
        ws[at.PULL_SIGMA_2 + i] = normal_arm * ws[at.SS2 + i]
        sigma_share = ws[at.N_SIGMA_1 + i] + ws[at.N_SIGMA_2 + i]
        ws[at.NORMAL + i] = sigma_share + (ws[at.N_TAU_1 + i] + ws[at.N_TAU_2 + i])
        thrust = ws[at.PULL_TAU_1 + i] + ws[at.PULL_TAU_2 + i]
        ws[at.PULL + i] = thrust - (ws[at.PULL_SIGMA_1 + i] + ws[at.PULL_SIGMA_2 + i])


Kind = tuple[int, ...]
"""A model: how many numbers there are is a type, so no code is made of other branches; all 1 for M3, else 0."""
M1, M2_OR_M3, M2L = 1, 2, 3


@called
def evaluate(ws: Lanes, kind: Kind, which: int) -> None:
    """Fill the results from the inputs; `which` is the quadrature rule of M1."""
    measure(ws)
    if len(kind) == M1:
        integrate(ws, which)
    elif len(kind) == M2L:
        close_under_load(ws)
    else:
        close(ws, kind[0] == 1)
    assemble(ws)
    if len(kind) == M2L:
        scale_pull(ws)
