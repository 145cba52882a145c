"""Compiled integrals of the stresses over the contact arc: M1 by quadrature, M2 and M3 in closed form."""

import numpy as np

from bayesterra.models._compiled import compiled
from bayesterra.models._elementary import angle_of_versine, exp, log, sin, versine
from bayesterra.models._lanes import (
    C1, C2, C3, COMPONENTS, COS_1, COS_2, EXPONENT_SLIP, FRONT, JOIN_1, JOIN_2, KS, LANES, MOMENT, N0, N1, NORMAL,
    PHI, PULL, RADIUS, REAR, RS_OVER_K, SC1, SC2, SHEARING_RADIUS, SIN_1, SIN_2, SLIP, SS1, SS2, START_RADIUS, SUMS,
    T1, T2, TAN_PHI, TC1, TC2, THETA_2, TS1, TS2, WIDTH, C, K, N, Z,
)  # fmt: skip
from bayesterra.models._quadrature import NODES, STARTS, WEIGHTS
from bayesterra.models.checks import FloatArray

INTEGRAL, LINEAR, LINEAR_COSINE = 1, 2, 3


@compiled
def geometry(ws: FloatArray) -> None:
    """Fill the geometry from the inputs, eqs. (5)-(8), (11), (12)."""
    for i in range(LANES):
        depth = ws[Z + i] / ws[RADIUS + i]
        ws[COS_1 + i] = 1.0 - depth
        ws[SIN_1 + i] = np.sqrt(depth * (2.0 - depth))
        theta_1 = angle_of_versine(depth)
        reach = (ws[START_RADIUS + i] - ws[RADIUS + i] + ws[Z + i]) / ws[START_RADIUS + i]
        start = angle_of_versine(reach)
        sin_start = np.sqrt(reach * (2.0 - reach))
        ratio = ws[C1 + i] + ws[C2 + i] * ws[SLIP + i]
        theta_2 = ws[C3 + i] * theta_1
        ws[THETA_2 + i] = theta_2
        ws[SIN_2 + i] = sin(theta_2)
        ws[COS_2 + i] = 1.0 - versine(theta_2)
        ws[FRONT + i] = 0.5 * theta_1 * (1.0 - ratio)
        ws[REAR + i] = 0.5 * theta_1 * (ratio - ws[C3 + i])
        drag = 1.0 - ws[SLIP + i]
        ws[JOIN_1 + i] = (start - theta_1) - drag * (sin_start - ws[SIN_1 + i])
        ws[JOIN_2 + i] = (start - theta_2) - drag * (sin_start - ws[SIN_2 + i])
        ws[N + i] = ws[N0 + i] + ws[N1 + i] * ws[EXPONENT_SLIP + i]
        ws[TAN_PHI + i] = sin(ws[PHI + i]) / (1.0 - versine(ws[PHI + i]))
        ws[RS_OVER_K + i] = ws[SHEARING_RADIUS + i] / ws[K + i]


@compiled
def integrate(ws: FloatArray, which: int) -> None:
    """Integrate (4), (9) and (11) over both parts with rule `which`.

    Angles are measured from the stress-free ends, d from theta_1 and e from theta_2, and every difference of
    cosines or sines is a product of half-angle sines, so nothing cancels on short arcs.
    """
    for i in range(SUMS, SUMS + 10 * LANES):
        ws[i] = 0.0
    for k in range(STARTS[which], STARTS[which + 1]):
        u, weight = NODES[k], WEIGHTS[k]
        for i in range(LANES):
            drag = 1.0 - ws[SLIP + i]
            half = ws[FRONT + i] * u
            s, c = sin(half), 1.0 - versine(half)
            rise = 2.0 * s * (ws[SIN_1 + i] * c - ws[COS_1 + i] * s)  # cos(theta) - cos(theta_1)
            fall = 2.0 * s * (ws[SIN_1 + i] * s + ws[COS_1 + i] * c)  # sin(theta_1) - sin(theta)
            sigma = ws[KS + i] * exp(ws[N + i] * log(ws[RADIUS + i] * rise)) * weight
            limit = ws[C + i] * weight + sigma * ws[TAN_PHI + i]
            tau = limit - limit * exp(-ws[RS_OVER_K + i] * (ws[JOIN_1 + i] + 2.0 * half - drag * fall))
            cosine, sine = ws[COS_1 + i] + rise, ws[SIN_1 + i] - fall
            ws[SC1 + i] += sigma * cosine
            ws[SS1 + i] += sigma * sine
            ws[TC1 + i] += tau * cosine
            ws[TS1 + i] += tau * sine
            ws[T1 + i] += tau
            half = ws[REAR + i] * u
            s, c = sin(half), 1.0 - versine(half)
            rise = 2.0 * s * (ws[COS_2 + i] * c - ws[SIN_2 + i] * s)  # sin(theta) - sin(theta_2)
            fall = 2.0 * s * (ws[SIN_2 + i] * c + ws[COS_2 + i] * s)  # cos(theta_2) - cos(theta)
            tau = limit - limit * exp(-ws[RS_OVER_K + i] * (ws[JOIN_2 + i] - 2.0 * half + drag * rise))
            cosine, sine = ws[COS_2 + i] - fall, ws[SIN_2 + i] + rise
            ws[SC2 + i] += sigma * cosine
            ws[SS2 + i] += sigma * sine
            ws[TC2 + i] += tau * cosine
            ws[TS2 + i] += tau * sine
            ws[T2 + i] += tau
    for i in range(LANES):
        front, rear = 2.0 * ws[FRONT + i], 2.0 * ws[REAR + i]
        ws[SC1 + i] *= front
        ws[SS1 + i] *= front
        ws[TC1 + i] *= front
        ws[TS1 + i] *= front
        ws[T1 + i] *= front
        ws[SC2 + i] *= rear
        ws[SS2 + i] *= rear
        ws[TC2 + i] *= rear
        ws[TS2 + i] *= rear
        ws[T2 + i] *= rear


@compiled
def close(ws: FloatArray, cosine_is_linear: bool) -> None:
    """Fill the integrals in closed form, eqs. (18)-(26): sigma and tau linear (CM1), or sigma cos and tau cos (CM2)."""
    for i in range(LANES):
        front, rear = ws[FRONT + i], ws[REAR + i]
        theta_m = ws[THETA_2 + i] + 2.0 * rear
        sin_m, cos_m = sin(theta_m), 1.0 - versine(theta_m)
        s, c = sin(front), 1.0 - versine(front)
        sin_front, cos_front = ws[SIN_1 + i] * c - ws[COS_1 + i] * s, ws[COS_1 + i] * c + ws[SIN_1 + i] * s
        rise = 2.0 * s * sin_front  # cos(theta_m) - cos(theta_1)
        slip_path = ws[JOIN_1 + i] + 2.0 * front - (1.0 - ws[SLIP + i]) * 2.0 * s * cos_front
        mean_front = s / front
        s, c = sin(rear), 1.0 - versine(rear)
        sin_rear, cos_rear = ws[SIN_2 + i] * c + ws[COS_2 + i] * s, ws[COS_2 + i] * c - ws[SIN_2 + i] * s
        mean_rear = s / rear
        sigma = ws[KS + i] * exp(ws[N + i] * log(ws[RADIUS + i] * rise))
        limit = ws[C + i] + sigma * ws[TAN_PHI + i]
        tau = limit - limit * exp(-ws[RS_OVER_K + i] * slip_path)
        ws[SS1 + i] = sigma * (cos_m - mean_front * cos_front)
        ws[SS2 + i] = sigma * (mean_rear * cos_rear - cos_m)
        cosine_1 = front * cos_m if cosine_is_linear else mean_front * sin_front - sin_m
        cosine_2 = rear * cos_m if cosine_is_linear else sin_m - mean_rear * sin_rear
        sine_share = 0.0 if cosine_is_linear else 1.0
        ws[SC1 + i] = sigma * cosine_1
        ws[SC2 + i] = sigma * cosine_2
        ws[TC1 + i] = tau * cosine_1
        ws[TC2 + i] = tau * cosine_2
        ws[TS1 + i] = tau * (cos_m - mean_front * cos_front) * sine_share
        ws[TS2 + i] = tau * (mean_rear * cos_rear - cos_m) * sine_share
        ws[T1 + i] = tau * front
        ws[T2 + i] = tau * rear


@compiled
def assemble(ws: FloatArray) -> None:
    """Fill the forces and components from the integrals, eqs. (14), (15)."""
    for i in range(LANES):
        normal_arm = ws[WIDTH + i] * ws[RADIUS + i]
        shear_arm = ws[WIDTH + i] * ws[SHEARING_RADIUS + i]
        ws[NORMAL + i] = normal_arm * (ws[SC1 + i] + ws[SC2 + i]) + shear_arm * (ws[TS1 + i] + ws[TS2 + i])
        ws[PULL + i] = shear_arm * (ws[TC1 + i] + ws[TC2 + i]) - normal_arm * (ws[SS1 + i] + ws[SS2 + i])
        ws[MOMENT + i] = shear_arm * ws[SHEARING_RADIUS + i] * (ws[T1 + i] + ws[T2 + i])
        ws[COMPONENTS + i] = normal_arm * ws[SC1 + i]
        ws[COMPONENTS + LANES + i] = normal_arm * ws[SC2 + i]
        ws[COMPONENTS + 2 * LANES + i] = shear_arm * ws[TS1 + i]
        ws[COMPONENTS + 3 * LANES + i] = shear_arm * ws[TS2 + i]
        ws[COMPONENTS + 4 * LANES + i] = shear_arm * ws[TC1 + i]
        ws[COMPONENTS + 5 * LANES + i] = shear_arm * ws[TC2 + i]
        ws[COMPONENTS + 6 * LANES + i] = normal_arm * ws[SS1 + i]
        ws[COMPONENTS + 7 * LANES + i] = normal_arm * ws[SS2 + i]


@compiled
def evaluate(ws: FloatArray, model: int, which: int) -> None:
    """Fill the results from the inputs; `which` is the quadrature rule of M1."""
    geometry(ws)
    if model == INTEGRAL:
        integrate(ws, which)
    else:
        close(ws, model == LINEAR_COSINE)
    assemble(ws)
