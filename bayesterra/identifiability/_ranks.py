"""Rank of the noise-free sensitivities over many parameter sets, and the directions that stay unseen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.identifiability._directions import NEGLIGIBLE, echelon, gathered
from bayesterra.identifiability.fisher import without_load
from bayesterra.identifiability.sensitivities import known_inputs, read_where, sensitivities
from bayesterra.parameters import SIZES
from bayesterra.posteriors import Posterior

RANK_TOLERANCE = 1e-10
"""Singular value, for rows and columns of unit length, below which a direction is not seen.

Rounding leaves 1e-15 where nothing is seen; where something is, the least found over the paper's box is 1e-7.
"""
COMMON = 0.05
"""Share of the parameter sets that must have a rank for it to be the rank of the design."""


@dataclass(frozen=True)
class Unseen:
    """Directions (count, d) that change no reading and share parameters; see ``structure.Null``."""

    directions: FloatArray
    straight: bool


@dataclass(frozen=True)
class Ranks:
    """Singular values of the sensitivities at n parameter sets, and what they leave unseen.

    Attributes
    ----------
    matrices : (n, q, d) with rows and columns of unit length; noise parameters are not among the columns.
    lengths : (n, d) by which columns in units of the prior's standard deviations were divided.
    """

    matrices: FloatArray
    lengths: FloatArray

    @cached_property
    def _decomposed(self) -> tuple[FloatArray, FloatArray]:
        _, values, vectors = np.linalg.svd(_tall(self.matrices), full_matrices=False)
        return values, vectors

    @property
    def values(self) -> FloatArray:
        """Singular values (n, d), largest first."""
        return self._decomposed[0]

    @cached_property
    def of_sets(self) -> IntArray:
        """Rank (n,) at every parameter set."""
        return np.asarray((self.values > RANK_TOLERANCE).sum(axis=1))

    @cached_property
    def rank(self) -> int:
        """The rank almost everywhere: the highest that is not rare."""
        return int(np.quantile(self.of_sets, 1.0 - COMMON, method="lower"))

    @cached_property
    def bases(self) -> FloatArray:
        """Orthonormal unseen directions (g, d − rank, d) of the sets that show them best, the best first.

        In units of the prior's standard deviations.
        """
        gap = np.where(self.of_sets == self.rank, self.values[:, max(self.rank - 1, 0)], -1.0)
        order = np.argsort(-gap, kind="stable")
        best = order[: max(1, int((gap > 0).sum()) // 2)]
        raw = self._decomposed[1][best, self.rank :] / self.lengths[best, None]
        return np.asarray(np.linalg.qr(raw.transpose(0, 2, 1))[0].transpose(0, 2, 1))

    def unseen(self) -> list[Unseen]:
        """Unseen directions in their simplest form: those that are the same everywhere, then the others."""
        if self.rank == self.values.shape[1]:
            return []
        projector = (self.bases.transpose(0, 2, 1) @ self.bases).mean(axis=0)
        shares, vectors = np.linalg.eigh(projector)
        straight, pivots = echelon(vectors[:, shares > 1.0 - NEGLIGIBLE].T)
        bent = self.bases[0] - self.bases[0] @ np.linalg.pinv(straight) @ straight
        bent = np.linalg.svd(bent)[2][: len(bent) - len(straight)]
        bent = echelon(bent - bent[:, pivots] @ straight)[0]
        alone = (straight != 0).sum(axis=1) == 1
        found = [Unseen(straight[alone], True)] if alone.any() else []
        for rows, same in ((straight[~alone], True), (bent, False)):
            found += [Unseen(rows[group], same) for group in gathered(rows != 0)]
        return sorted(found, key=lambda each: int(each.directions.any(axis=0).argmax()))


def ranks(posterior: Posterior, x: FloatArray, channels: Sequence[str]) -> Ranks:
    """Ranks at sets ``x`` (n, d), in units of their standard deviations, where ``channels`` are read.

    Sets for which the model has no answer are left out. See :func:`read_where` for the rows.
    """
    soil = soil_columns(posterior)
    found = sensitivities(posterior, x).of(tuple(channels))
    read = read_where(posterior, channels)
    by_x = np.where(read[..., None], found.by_parameter[..., soil] * x[:, soil].std(axis=0), 0.0)
    by_load = np.where(read, found.by_load * known_inputs(posterior.likelihood)[:, None], 0.0)
    rows = _lengths(np.concatenate([by_x, by_load[..., None]], axis=3), axis=3)
    by_x, by_load = by_x / rows[..., None], by_load / rows
    lengths = _lengths(by_x, axis=(1, 2))
    seen = without_load(by_x / lengths[:, None, None], by_load, 0.0)
    seen = seen.reshape(len(x), read.size, len(soil))
    answered = np.isfinite(seen).all(axis=(1, 2))
    return Ranks(seen[answered], lengths[answered])


def soil_columns(posterior: Posterior) -> list[int]:
    """Free parameters that are no noise."""
    return [i for i, name in enumerate(posterior.names) if not name.startswith(SIZES)]


def _lengths(values: FloatArray, axis: int | tuple[int, ...]) -> FloatArray:
    """Euclidean lengths, 1 where they are 0."""
    length = np.sqrt((values**2).sum(axis=axis))
    return np.where(length == 0, 1.0, length)


def _tall(matrices: FloatArray) -> FloatArray:
    """The same with at least as many rows as columns."""
    n, q, d = matrices.shape
    return matrices if q >= d else np.concatenate([matrices, np.zeros((n, d - q, d))], axis=1)
