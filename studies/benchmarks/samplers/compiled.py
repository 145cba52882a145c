"""The likelihood and our coordinates for one point at a time, compiled: scalar peers lose no time in Python.

The numbers are those of the package (a test holds them together); slopes of the forces are exact, slopes of
the coordinates central differences.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.models.kernels import compiled, drivers

STEP = 1e-5
SHEAR_AXES = 8
EVERY = drivers.directions_of(None)


class Rows(NamedTuple):
    """Rows, load or sinkage (1, m), readings (m, 3), noise (3,), ends of the box (8,), and the drive."""

    rows: FloatArray
    given: FloatArray
    measured: FloatArray
    scale: FloatArray
    low: FloatArray
    high: FloatArray
    load: bool


@compiled
def _outcomes(x, rows):  # type: ignore[no-untyped-def]
    """Outcomes (1, m, 3) and status (1, m) of one parameter set (8,)."""
    theta = np.zeros((1, 9))
    theta[0, :8] = x
    m = rows.given.shape[1]
    out, status = np.empty((1, m, 3)), np.empty((1, m), np.int8)
    if rows.load:
        drivers.response(theta, rows.rows, rows.given, ((0,), 0, False), out, status)
    else:
        drivers.forces(theta, rows.rows, rows.given, ((0,), 0, False), out, status)
    return theta, out, status


@compiled
def density(x, rows):  # type: ignore[no-untyped-def]
    """Log posterior density of physical parameters (8,)."""
    constant = -np.log(rows.high - rows.low).sum()
    if not ((x >= rows.low).all() and (x <= rows.high).all()) or x[5] <= 0:
        return -np.inf
    _, out, status = _outcomes(x, rows)
    if status.any():
        return -np.inf
    total = constant
    for k in range(3):
        z = (rows.measured[:, k] - out[0, :, k]) / rows.scale[k]
        total -= 0.5 * (z**2).sum() + len(z) * math.log(rows.scale[k] * math.sqrt(2 * math.pi))
    return total


@compiled
def gradient(x, rows):  # type: ignore[no-untyped-def]
    """Log posterior density of physical parameters (8,) and its gradient (8,)."""
    slope = np.zeros(8)
    value = density(x, rows)
    if value == -np.inf:
        return value, slope
    theta, out, status = _outcomes(x, rows)
    m = rows.given.shape[1]
    jacobian = np.empty((1, m, 3, 10))
    depth = out[:, :, 0].copy() if rows.load else rows.given
    drivers.jacobian(EVERY, theta, rows.rows, depth, ((0,), 0, True), jacobian, status)
    for j in range(m):
        by = jacobian[0, j]
        for k in range(3):
            pull = (rows.measured[j, k] - out[0, j, k]) / rows.scale[k] ** 2
            for i in range(8):
                sinkage = -by[0, i] / by[0, 9]  # at constant load
                if not rows.load:
                    slope[i] += pull * by[k, i]
                elif k == 0:
                    slope[i] += pull * sinkage
                else:
                    slope[i] += pull * (by[k, i] + by[k, 9] * sinkage)
    return value, slope


@compiled
def box_density(u, rows):  # type: ignore[no-untyped-def]
    """Log density at a point (8,) of the unit cube."""
    return density(rows.low + u * (rows.high - rows.low), rows)


@compiled
def box_gradient(u, rows):  # type: ignore[no-untyped-def]
    """The same and its gradient (8,)."""
    value, slope = gradient(rows.low + u * (rows.high - rows.low), rows)
    return value, slope * (rows.high - rows.low)


@compiled
def _below(u):  # type: ignore[no-untyped-def]
    return 0.5 * math.erfc(-u / math.sqrt(2.0))


@compiled
def _log_normal(u):  # type: ignore[no-untyped-def]
    return -0.5 * u * u - 0.5 * math.log(2 * math.pi)


@compiled
def to_physical(u, shear, low, high):  # type: ignore[no-untyped-def]
    """Physical parameters and, last, log |dx/du| (9,) of our coordinates (8,)."""
    s0, s1, e0, e1, radius, share, stress, displacement = shear
    out = np.empty(9)
    Ks = low[0] + (high[0] - low[0]) * _below(u[0])
    log_jacobian = _log_normal(u[0]) + math.log(high[0] - low[0])
    r0, r1, width = _below(u[6]), _below(u[7]), s1 - s0
    out[7] = (r1 - r0) / width
    out[6] = r0 - out[7] * s0
    log_jacobian += _log_normal(u[6]) + _log_normal(u[7]) - 2 * math.log(width)
    r0, r1 = min(max(r0, 1e-6), 1 - 1e-6), min(max(r1, 1e-6), 1 - 1e-6)
    d0 = math.log(share * radius * (math.cos(r0 * e0) - math.cos(e0)))
    d1 = math.log(share * radius * (math.cos(r1 * e1) - math.cos(e1)))
    n_low, n_high = (u[1] - math.log(Ks)) / d0, (u[2] - math.log(Ks)) / d1
    log_jacobian -= math.log(abs(d0)) + math.log(abs(d1))
    out[0], out[2] = Ks, (n_high - n_low) / width
    out[1] = n_low - out[2] * s0
    log_strength = u[3] - math.log(-math.expm1(-displacement * math.exp(-u[5])))
    strength = math.exp(log_strength)
    slope = strength * _below(u[4]) / stress
    out[3], out[4], out[5] = strength * _below(-u[4]), math.atan(slope), math.exp(u[5])
    log_jacobian += 2 * log_strength + _log_normal(u[4]) - math.log1p(slope**2) - math.log(stress) + u[5]
    out[8] = log_jacobian
    return out


@compiled
def sheared_density(u, shear, rows):  # type: ignore[no-untyped-def]
    """Log density at a point (8,) of our coordinates."""
    if np.abs(u).max() > 30:
        return -np.inf
    x = to_physical(u, shear, rows.low, rows.high)
    value = density(x[:8], rows)
    return value + x[8] if value > -np.inf else value


@compiled
def sheared_gradient(u, shear, rows):  # type: ignore[no-untyped-def]
    """The same and its gradient (8,)."""
    slope = np.zeros(8)
    if np.abs(u).max() > 30:
        return -np.inf, slope
    x = to_physical(u, shear, rows.low, rows.high)
    value, by_x = gradient(x[:8], rows)
    if value == -np.inf:
        return value, slope
    for i in range(8):
        moved = u.copy()
        moved[i] += STEP
        ahead = to_physical(moved, shear, rows.low, rows.high)
        moved[i] -= 2 * STEP
        change = (ahead - to_physical(moved, shear, rows.low, rows.high)) / (2 * STEP)
        slope[i] = (by_x * change[:8]).sum() + change[8]
    return value + x[8], slope
