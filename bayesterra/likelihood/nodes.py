"""Tables of many rows told by few: outcomes under a load at Chebyshev nodes over slip, spread to the rows.

Between the slips at which a model bends its outcomes are smooth, and a polynomial through the nodes of each such
piece tells any number of rows of one wheel under one load. Its last coefficients say, soil by soil, whether it does.
"""

from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.linalg import block_diag

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.models import Conditions, ForwardModel

FEWEST, MORE = 8, 20
"""Nodes of a piece: so many, and so many more for each unit of slip."""
LAST, SMALL = 3, 2e-9
"""Coefficients at the end that must be small; as a share of radius (sinkage), load (drawbar pull) or both (moment)."""


@dataclass(frozen=True)
class Nodes:
    """Conditions and loads of k nodes at which a model is run in place of the m rows of a table."""

    conditions: Conditions
    load: FloatArray  # (k,)
    spread: FloatArray  # (k, m): outcomes of the nodes times this are those of the rows
    tails: FloatArray  # (k, t): likewise the last coefficients of every piece
    sizes: FloatArray  # (3, t): what the coefficients of an outcome are small against

    @classmethod
    def of(cls, model: ForwardModel, rows: Conditions, load: FloatArray, times: int = 1) -> "Nodes | None":
        """Nodes for some rows, so many ``times`` as many as most soils need.

        None where a model is not known to be smooth, or no wheel and load has enough rows.
        """
        names = [each.name for each in fields(rows)]
        known = np.column_stack([*(getattr(rows, name) for name in names if name != "slip"), load])
        if not model.compiled or np.isnan(known).any():
            return None
        kinds, first, kind = np.unique(known, axis=0, return_index=True, return_inverse=True)
        if len(load) <= FEWEST * len(kinds):
            return None
        mine = [np.flatnonzero(kind.ravel() == i) for i in range(len(kinds))]
        ends = zip(mine, model.bends(rows)[first], strict=True)
        parts = [_interpolation(rows.slip[own], bends, times) for own, bends in ends]
        if not any(tails.size for _, _, tails in parts):
            return None
        at = np.repeat(first, [len(slip) for slip, _, _ in parts])
        columns = {name: getattr(rows, name)[at] for name in names} | {"slip": np.concatenate([p[0] for p in parts])}
        sizes = [np.outer((rows.radius[i], load[i], load[i] * rows.radius[i]), np.ones(tails.shape[1]))
                 for i, (_, _, tails) in zip(first, parts, strict=True)]  # fmt: skip
        spread = block_diag(*(part[1] for part in parts))[:, np.argsort(np.concatenate(mine))]
        tails, conditions = block_diag(*(part[2] for part in parts)), Conditions(**columns)
        return cls(conditions, load[at], np.ascontiguousarray(spread), tails, np.hstack(sizes))

    def tell(self, values: FloatArray) -> BoolArray:
        """True (n,) where outcomes (n, k, 3) of the nodes, NaN without an answer, tell all rows."""
        return np.asarray((np.abs(values.swapaxes(1, 2) @ self.tails) <= SMALL * self.sizes).all(axis=(1, 2)))

    def at_rows(self, values: FloatArray) -> FloatArray:
        """Outcomes (n, m, 3) of the rows."""
        return (values.swapaxes(1, 2) @ self.spread).swapaxes(1, 2)


def _interpolation(slip: FloatArray, bends: FloatArray, times: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slips (k,) of the nodes of one wheel under one load, and matrices as of :class:`Nodes`.

    Where rows have no more slips than there would be nodes, the slips are the nodes and there are no coefficients.
    """
    slips, place = np.unique(slip, return_inverse=True)
    ends = [slips[0], *np.unique(bends[(bends > slips[0]) & (bends < slips[-1])]), slips[-1]]
    counts = [times * (FEWEST + round(MORE * (high - low))) for low, high in pairwise(ends)]
    nodes = 1 + sum(counts) - len(counts)  # pieces share their ends
    if len(slips) <= nodes:
        return slips, np.eye(len(slips))[:, place], np.zeros((len(slips), 0))
    at, spread, tails = np.empty(nodes), np.zeros((nodes, len(slip))), np.zeros((nodes, LAST * len(counts)))
    piece, start = np.searchsorted(ends[1:-1], slip), 0
    for i, (count, (low, high)) in enumerate(zip(counts, pairwise(ends), strict=True)):
        points, own = -np.cos(np.pi * np.arange(count) / (count - 1)), slice(start, start + count)
        coefficients = np.linalg.inv(chebvander(points, count - 1))
        at[own] = np.clip(low + (high - low) * (points + 1) / 2, low, high)
        inside = np.flatnonzero(piece == i)
        spread[own, inside] = (chebvander(2 * (slip[inside] - low) / (high - low) - 1, count - 1) @ coefficients).T
        tails[own, LAST * i : LAST * (i + 1)] = coefficients[-LAST:].T
        start += count - 1
    at[-1] = slips[-1]
    return at, spread, tails


@dataclass(frozen=True)
class Squares:
    """Sums of squared residuals in units of their scale, of readings whose rows are told by nodes.

    They are |R v − a|² for outcomes v of the nodes, with R no longer than these are many.
    """

    root: FloatArray  # [R a], (at most k + 1, k + 1)
    count: int  # of readings
    logs: float  # sum of the logarithms of their scales

    @classmethod
    def of(cls, readings: FloatArray, scale: FloatArray, spread: FloatArray) -> "Squares":
        """Of readings (m,), NaN where there is none, with scales (m,)."""
        read = ~np.isnan(readings)
        columns = np.vstack([spread[:, read], readings[read]]) / scale[read]
        return cls(np.linalg.qr(columns.T)[1], int(read.sum()), float(np.log(scale[read]).sum()))

    def __call__(self, values: FloatArray) -> FloatArray:
        """Sums (n,) for outcomes (n, k) of the nodes."""
        return np.asarray((self.residuals(values) ** 2).sum(axis=1))

    def residuals(self, values: FloatArray) -> FloatArray:
        """Few residuals (..., r) with the same sum of squares, for outcomes (..., k) of the nodes."""
        return values @ self.root[:, :-1].T - self.root[:, -1]

    def slopes(self, derivatives: FloatArray) -> FloatArray:
        """Derivatives (r, p) of :meth:`residuals`, from those (k, p) of the outcomes."""
        return self.root[:, :-1] @ derivatives
