"""Quadrature rules on (0, 1) for integrands that leave 0 like a broken power."""

import numpy as np

from bayesterra.models.checks import FloatArray

COUNTS = (32,)
_POWER = 3


def rule(count: int, power: int = _POWER) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights (count,) in u = v^power, v Gauss-Legendre on (0, 1)."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    v = 0.5 * (nodes + 1.0)
    return v**power, 0.5 * weights * power * v ** (power - 1)


# All rules end to end; rule i occupies STARTS[i]:STARTS[i + 1].
STARTS = np.concatenate([[0], np.cumsum(COUNTS)])
NODES = np.concatenate([rule(count)[0] for count in COUNTS])
WEIGHTS = np.concatenate([rule(count)[1] for count in COUNTS])
