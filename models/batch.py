"""Arrays in, arrays out: the numerical interface of the models, on flat parameter sets and rows."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesterra.models.checks import FloatArray
from bayesterra.models.forces import SINKAGE
from bayesterra.models.kernels import drivers

Codes = NDArray[np.int8]
Plan = tuple[tuple[int, ...], int, bool]
Kernel = Callable[[FloatArray, FloatArray, FloatArray, Plan, FloatArray, Codes], None]


def parameters(theta: ArrayLike, columns: int) -> FloatArray:
    """`theta` as a C-contiguous, writable (n, columns) array."""
    array = np.require(theta, dtype=np.float64, requirements=["C", "W"])  # one kernel: read-only is another type
    if array.ndim != 2 or array.shape[1] != columns:
        raise ValueError(f"'theta' must have shape (n, {columns}) (got {array.shape})")
    return array


def run(
    kernel: Kernel, theta: FloatArray, rows: FloatArray, given: ArrayLike, plan: Plan, shape: tuple[int, ...]
) -> tuple[FloatArray, Codes]:
    """Run a kernel for every pair and return its output (n, m, *shape) and status (n, m)."""
    pairs = (len(theta), 1 if plan[1] else len(rows))
    values, out, status = np.empty(pairs), np.empty((*pairs, *shape)), np.empty(pairs, dtype=np.int8)
    values[...] = given
    kernel(theta, rows, values, plan, out, status)
    return out, status


def forces(theta: FloatArray, rows: FloatArray, sinkage: ArrayLike, plan: Plan) -> tuple[FloatArray, Codes]:
    """F_N, F_DP, M_DR (n, m, 3) and status."""
    return run(drivers.forces, theta, rows, sinkage, plan, (3,))


def components(theta: FloatArray, rows: FloatArray, sinkage: ArrayLike, plan: Plan) -> tuple[FloatArray, Codes]:
    """The three forces and the eight components (n, m, 11) and status."""
    return run(drivers.forces, theta, rows, sinkage, plan, (11,))


def response(theta: FloatArray, rows: FloatArray, load: ArrayLike, plan: Plan) -> tuple[FloatArray, Codes]:
    """z, F_DP, M_DR (n, m, 3) and status."""
    return run(drivers.response, theta, rows, load, plan, (3,))


def jacobian(
    theta: FloatArray, rows: FloatArray, sinkage: ArrayLike, plan: Plan, only: Sequence[int] | None = None
) -> FloatArray:
    """d(F_N, F_DP, M_DR)/d(theta, sinkage) (n, m, 3, p + 1); with `only`, columns of others may be 0."""
    kernel = partial(drivers.jacobian, drivers.directions_of(only))
    return run(kernel, theta, rows, sinkage, plan, (3, theta.shape[1] + 1))[0]


def response_jacobian(theta: FloatArray, rows: FloatArray, load: ArrayLike, plan: Plan) -> FloatArray:
    """d(z, F_DP, M_DR)/d theta (n, m, 3, p), by implicit derivatives of F_N(z, theta) = W."""
    at_root = jacobian(theta, rows, response(theta, rows, load, plan)[0][..., SINKAGE], plan)
    by_theta, by_sinkage = at_root[..., :-1], at_root[..., -1:]
    sinkage = -by_theta[..., :1, :] / by_sinkage[..., :1, :]
    return np.concatenate([sinkage, by_theta[..., 1:, :] + by_sinkage[..., 1:, :] * sinkage], axis=-2)
