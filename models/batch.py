"""Arrays in, arrays out: the numerical interface of the models, on flat parameter sets and rows."""

from collections.abc import Callable, Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesterra.models.checks import FloatArray
from bayesterra.models.forces import SINKAGE
from bayesterra.models.kernels import drivers
from bayesterra.models.soil import LOAD_EFFECT_FIELDS, Soil

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


def jacobian(theta: FloatArray, rows: FloatArray, sinkage: ArrayLike, plan: Plan) -> FloatArray:
    """d(F_N, F_DP, M_DR)/d(theta, sinkage) (n, m, 3, p + 1)."""
    return run(drivers.jacobian, theta, rows, sinkage, plan, (3, theta.shape[1] + 1))[0]


def response_jacobian(theta: FloatArray, rows: FloatArray, load: ArrayLike, plan: Plan) -> FloatArray:
    """d(z, F_DP, M_DR)/d theta (n, m, 3, p), by implicit derivatives of F_N(z, theta) = W."""
    at_root = jacobian(theta, rows, response(theta, rows, load, plan)[0][..., SINKAGE], plan)
    by_theta, by_sinkage = at_root[..., :-1], at_root[..., -1:]
    sinkage = -by_theta[..., :1, :] / by_sinkage[..., :1, :]
    return np.concatenate([sinkage, by_theta[..., 1:, :] + by_sinkage[..., 1:, :] * sinkage], axis=-2)


KINDS = {"M1": (0,), "M2": (0, 0), "M2L": (0, 0, 0)}
"""Models by whose names compiled code differs: M3 runs that of M2."""


def warm_up(names: Iterable[str]) -> None:
    """Run every kernel of models once on a typical soil and wheel."""
    theta = Soil(Ks=2.5e6, n0=0.76, n1=1.3, c=250.0, phi=0.5568, K=0.012, c1=0.5, c2=-0.3).as_array()[None]
    rows = np.array([[0.2, 0.2, 0.157, 0.165, 0.167, 0.1635]])
    for name in names:
        more = len(LOAD_EFFECT_FIELDS) if name == "M2L" else 0  # parameters of its own, and a column of the rows
        sets = np.pad(theta, ((0, 0), (0, more)))
        conditions = np.pad(rows, ((0, 0), (0, min(more, 1))), constant_values=80.0)
        response_jacobian(sets, conditions, 80.0, (KINDS[name], 0, False))
        components(sets, conditions, 0.01, (KINDS[name], 0, False))
