"""Directions in parameter space: brought to their simplest form, gathered, and put into words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.parameters import PARAMETERS

NEGLIGIBLE = 1e-6
"""Share of a direction (of unit length in prior standard deviations) below which a parameter has no part."""


def echelon(rows: FloatArray) -> tuple[FloatArray, IntArray]:
    """Reduced echelon form of directions (q, d), and the column (q,) that each has to itself with weight 1.

    Gauss–Jordan elimination with full pivoting: the simplest basis of what the directions span.
    """
    rows, pivots = rows.copy(), np.empty(len(rows), dtype=np.int64)
    for i in range(len(rows)):
        best, column = divmod(int(np.abs(rows[i:]).argmax()), rows.shape[1])
        rows[[i, i + best]] = rows[[i + best, i]]
        rows[i] /= rows[i, column]
        others = np.arange(len(rows)) != i
        rows[others] -= rows[others, column][:, None] * rows[i]
        pivots[i] = column
    return np.where(np.abs(rows) < NEGLIGIBLE, 0.0, rows), pivots


def gathered(supports: BoolArray) -> list[list[int]]:
    """Directions whose parameters, True in ``supports`` (q, d), overlap, as groups of their numbers."""
    groups: list[list[int]] = []
    for i in range(len(supports)):
        shared = [group for group in groups if (supports[group].any(axis=0) & supports[i]).any()]
        groups = [group for group in groups if group not in shared]
        groups.append(sorted([i, *(member for group in shared for member in group)]))
    return groups


def combination(
    names: Sequence[str], weights: FloatArray, *, least: float = 0.15, terms: int = 4, digits: int = 2
) -> str:
    """Leading terms of a weighted sum, in symbols.

    Parameters
    ----------
    names : parameters.
    weights : (d,); terms with less than the share ``least`` of the largest are left out.
    terms : at most so many.
    digits : significant digits; a weight of 1 is not written.

    >>> combination(("n0", "c1", "phi"), np.array([-0.57, 0.82, 0.01]))
    '0.82 c1 − 0.57 n0'
    """
    size = np.abs(weights)
    order = np.argsort(-size, kind="stable")[:terms]
    leading = [int(i) for i in order if size[i] > 0 and size[i] >= least * size.max()]
    parts = [("−" if weights[i] < 0 else "+", _term(names[i], size[i], digits)) for i in leading]
    text = " ".join(f"{sign} {term}" for sign, term in parts)
    return text[2:] if text.startswith("+") else text.replace("− ", "−", 1)


def _term(name: str, size: float, digits: int) -> str:
    text, symbol = f"{size:.{digits}g}", PARAMETERS[name].symbol
    return symbol if text == "1" else f"{text} {symbol}"


def listed(names: Sequence[str]) -> str:
    """Symbols of parameters as in a sentence.

    >>> listed(("Ks", "n0", "n1"))
    'K_s, n0 and n1'
    """
    symbols = [PARAMETERS[name].symbol for name in names]
    return " and ".join([", ".join(symbols[:-1]), symbols[-1]] if len(symbols) > 1 else symbols)
