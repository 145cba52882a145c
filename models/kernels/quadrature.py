"""Quadrature on (0, 1) for integrands that leave 0 like a broken power, and how many nodes a pair needs."""

import numpy as np

from bayesterra.models.checks import FloatArray
from bayesterra.models.kernels.compiler import called

ROUGH_COUNT = 8
COUNTS = (12, 14, 16, 18, 20, 24, 28, 32, 36, 44, 64, 96)
RULES = len(COUNTS)
ROUGH = RULES  # the index of the rule that brings the sinkage solver near


def rule(count: int, power: int = 3) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights (count,) in u = v^power, v Gauss-Legendre on (0, 1)."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    v = 0.5 * (nodes + 1.0)
    return v**power, 0.5 * weights * power * v ** (power - 1)


_ALL = [rule(count) for count in (*COUNTS, ROUGH_COUNT)]
NODES = np.concatenate([nodes for nodes, _ in _ALL])
WEIGHTS = np.concatenate([weights for _, weights in _ALL])
STARTS = np.concatenate([[0], np.cumsum([*COUNTS, ROUGH_COUNT])])  # rule i occupies STARTS[i]:STARTS[i + 1]
_RULE_OF = np.searchsorted(COUNTS, np.arange(COUNTS[-1] + 1))  # the first rule of at least so many nodes


@called
def choose_rule(theta: FloatArray, row: FloatArray, sinkage: float) -> int:
    """Index of the smallest rule that serves a pair to 1e-9, mostly to 1e-10.

    Fitted to 56 000 pairs over the prior box with its corners. What asks for nodes: a small exponent N; shear
    that builds up over a small part of the arc, measured by the growth of j/K over the front and the rear
    part (the rear counts only as far as the front has left 1 - exp(-j/K) short of 1); a long arc; a leaving
    angle.
    """
    slip, c3 = row[0], theta[8]
    n, ratio = theta[1] + theta[2] * row[1], theta[6] + theta[7] * slip
    depth = sinkage / row[2]
    angle = np.sqrt(2.0 * depth) * (1.0 + depth / 12.0)
    growth = angle * row[5] / theta[5]
    bend = angle * angle * (1.0 - slip) / 6.0
    front = growth * (slip * (1.0 - ratio) + bend * (1.0 - ratio**3))
    bent = growth * bend * (ratio**3 - c3**3)
    rear = growth * slip * (ratio - c3) + bent
    need = max(10.6 + 2.5 * angle, 10.5 + 1.6 * np.sqrt(front), _need_of_exponent(n))
    most = max(36.0 + rear / 16.0, 0.27 * rear, 0.8 * bent)  # beyond 44: K below the prior box
    need = max(need, min(10.3 + 6.0 * np.sqrt(rear) - 0.85 * front, most))
    if c3 != 0.0:
        need = 64.0 if ratio < 0.0 or n < 0.3 else need + 8.0
    return int(_RULE_OF[int(need + 0.3) if need < COUNTS[-1] else COUNTS[-1]])


@called
def _need_of_exponent(n: float) -> float:
    """Nodes that the broken power at the stress-free ends asks for."""
    if n >= 0.65:
        return 12.0
    if n >= 0.3:
        return 14.0 if n >= 0.6 else (18.0 if n >= 0.4 else 20.0)
    return 28.0 if n >= 0.2 else 36.0
