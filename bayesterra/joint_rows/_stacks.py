"""Which readings hang together, and the whitening of their joint covariance.

Readings that hang together form a block: those of a wheel where there is a discrepancy, of a sweep where
there is ripple only. Channels are apart unless errors in slip tie them. Blocks of one size are stacked, so
that all of them are factorised at once for any number of parameter sets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.data import Observations
from bayesterra.model_errors import Discrepancy, ModelErrors, Ripple

Pair = tuple[int, int]


def sweeps(rows: Observations) -> tuple[tuple[str, str], ...]:
    """The sweep of every row: its wheel, and its run where the table has such a column."""
    runs = rows.labels.get("run", ("",) * len(rows))
    return tuple(zip(rows.wheel, runs, strict=True))


@dataclass(frozen=True)
class Stack:
    """B blocks of q readings each.

    Attributes
    ----------
    rows, columns : row and channel of every reading (B, q).
    parts : which size, and the correlation (B, q, q) that it belongs to.
    slip : which size is that of errors in slip, which tie the readings of a row; None where slips are exact.
    noise : standard deviations (B, q) where they are the same for all parameter sets; else None.
    """

    rows: IntArray
    columns: IntArray
    parts: tuple[tuple[int, FloatArray], ...]
    slip: int | None
    noise: FloatArray | None = None

    @cached_property
    def axes(self) -> tuple[int, FloatArray, FloatArray, float] | None:
        """Principal axes of the one thing that ties a stack's readings beside noise that is known.

        Which size it has, variances (B, q) of its correlation in units of the noise, rows (B, q, q) along
        which readings then are independent, and the log of the noise, summed; None where there is more to it.
        """
        if self.noise is None or self.slip is not None or len(self.parts) != 1:
            return None
        which, correlation = self.parts[0]
        values, vectors = np.linalg.eigh(correlation / (self.noise[..., :, None] * self.noise[..., None, :]))
        along = vectors.swapaxes(-1, -2) / self.noise[..., None, :]
        return which, np.maximum(values, 0.0), np.asarray(along), float(np.log(self.noise).sum())

    def covariance(self, scale: FloatArray, sizes: FloatArray, slopes: FloatArray | None) -> FloatArray:
        """Covariance (n, B, q, q) for noise (n, m, k), sizes (n, j) and slopes over slip (n, m, k)."""
        variance = scale[:, self.rows, self.columns] ** 2
        matrix: FloatArray = np.zeros((*variance.shape, variance.shape[-1]))
        np.einsum("nbqq->nbq", matrix)[...] = variance
        for which, correlation in self.parts:
            matrix += sizes[:, which, None, None, None] ** 2 * correlation
        if self.slip is not None and slopes is not None:
            along = sizes[:, self.slip, None, None] * slopes[:, self.rows, self.columns]
            matrix += along[..., :, None] * along[..., None, :] * self.same_row
        return matrix

    def by_size(self, which: int, sizes: FloatArray, slopes: FloatArray | None) -> FloatArray | None:
        """Derivative (n, B, q, q) of the covariance by one of the sizes; None where it has no part in it."""
        if which == self.slip and slopes is not None:
            along = slopes[:, self.rows, self.columns]
            tied = along[..., :, None] * along[..., None, :] * self.same_row
            return np.asarray(2.0 * sizes[:, which, None, None, None] * tied)
        known = dict(self.parts)
        if which not in known:
            return None
        return np.asarray(2.0 * sizes[:, which, None, None, None] * known[which])

    def by_slopes(self, sizes: FloatArray, slopes: FloatArray | None, change: FloatArray) -> FloatArray:
        """Change (n, B, q, q) of the covariance as slopes (n, m, k) change, to first order."""
        if self.slip is None or slopes is None:
            return np.zeros((len(change), *self.same_row.shape))
        along, more = (part[:, self.rows, self.columns] for part in (slopes, change))
        tied = along[..., :, None] * more[..., None, :] * self.same_row
        return np.asarray(sizes[:, self.slip, None, None, None] ** 2 * (tied + tied.swapaxes(-1, -2)))

    @property
    def same_row(self) -> BoolArray:
        """Whether two readings of a block are of one row (B, q, q)."""
        return np.asarray(self.rows[:, :, None] == self.rows[:, None, :])

    def whitening(self, scale: FloatArray, sizes: FloatArray, slopes: FloatArray | None) -> Whitening:
        """The factor of the covariance; arguments as for :meth:`covariance`."""
        if not self.parts and self.slip is None:
            sd = scale[:, self.rows, self.columns]
            return Whitening(1.0 / sd[..., None] * np.eye(sd.shape[-1]), np.log(sd).sum(axis=(1, 2)))
        if self.axes is not None:
            which, values, vectors, level = self.axes
            spread = 1.0 + sizes[:, which, None, None] ** 2 * values
            return Whitening(
                vectors / np.sqrt(spread)[..., None], level + 0.5 * np.log(spread).sum(axis=(1, 2))
            )
        lower = np.linalg.cholesky(self.covariance(scale, sizes, slopes))
        level = np.log(np.einsum("nbqq->nbq", lower)).sum(axis=(1, 2))
        return Whitening(np.linalg.inv(lower), np.asarray(level))


@dataclass(frozen=True)
class Whitening:
    """Matrices W with W K Wᵀ = 1.

    Attributes
    ----------
    matrix : W (n or 1, B, q, q).
    level : half the log determinants of K, all blocks together (n or 1,).
    """

    matrix: FloatArray
    level: FloatArray

    def of(self, residuals: FloatArray) -> FloatArray:
        """White residuals (n, B, q)."""
        return np.asarray((self.matrix @ residuals[..., None])[..., 0])

    def back(self, white: FloatArray) -> FloatArray:
        """Wᵀ times white residuals (n, B, q)."""
        return np.asarray((self.matrix.swapaxes(-1, -2) @ white[..., None])[..., 0])

    def take(self, chosen: IntArray) -> Whitening:
        """Those of the sets, also repeatedly."""
        if len(self.matrix) == 1:
            return self
        return Whitening(self.matrix[chosen], self.level[chosen])


def stacks(
    errors: ModelErrors,
    rows: Observations,
    channels: Sequence[str],
    known: BoolArray,
    noise: FloatArray | None = None,
) -> list[Stack]:
    """All readings where ``known`` (m, channels) holds, in stacks of blocks.

    ``noise`` (m, channels) are the standard deviations, where they do not depend on the parameters.
    """
    groups: dict[tuple[object, ...], list[Pair]] = {}
    sweep, place = sweeps(rows), _placed(errors)
    for i, column in np.argwhere(known):
        key = place(channels[column], int(i), rows.wheel[i], sweep[i])
        groups.setdefault(key, []).append((int(i), int(column)))
    alone = [pair for key, pairs in groups.items() if key[-1] == "alone" for pair in pairs]
    blocks = [pairs for key, pairs in groups.items() if key[-1] != "alone"]
    alike: dict[tuple[int, int], list[list[Pair]]] = {}
    for pairs in blocks:  # of one channel, where channels are apart: then one thing ties them
        alike.setdefault((len(pairs), pairs[0][1] if errors.slip is None else 0), []).append(pairs)
    found = [_stack(np.array(same), errors, rows, channels, noise) for same in alike.values()]
    if alone:
        one = np.array([alone])
        found.append(Stack(one[..., 0], one[..., 1], (), None))
    return found


def _placed(errors: ModelErrors) -> Callable[[str, int, str, object], tuple[object, ...]]:
    """To which block a reading belongs."""
    slip = errors.slip is not None

    def place(channel: str, row: int, wheel: str, sweep: object) -> tuple[object, ...]:
        own = ("" if slip else channel,)
        if errors.discrepancy if slip else channel in errors.discrepancy:
            return (*own, wheel, "wheel")
        if errors.ripple if slip else channel in errors.ripple:
            return (*own, sweep, "sweep")
        return (*own, row, "row" if slip else "alone")

    return place


def _stack(
    pairs: IntArray,
    errors: ModelErrors,
    rows: Observations,
    channels: Sequence[str],
    noise: FloatArray | None,
) -> Stack:
    """A stack of blocks (B, q, 2)."""
    i, column = pairs[..., 0], pairs[..., 1]
    parts, slip = [], None
    for which, one in enumerate(errors):
        if isinstance(one, Discrepancy | Ripple):
            mine = column == channels.index(one.channel)
            both = mine[:, :, None] & mine[:, None, :]
            if both.any():
                whole = correlation(one, rows)
                parts.append((which, np.where(both, whole[i[:, :, None], i[:, None, :]], 0.0)))
        else:
            slip = which
    return Stack(i, column, tuple(parts), slip, None if noise is None else noise[i, column])


def correlation(one: Discrepancy | Ripple, rows: Observations) -> FloatArray:
    """Correlation (m, m) of a discrepancy or a ripple between the rows of a table."""
    if isinstance(one, Discrepancy):
        return _within(rows.wheel, one.correlation(rows.slip, rows.slip))
    number = np.array(rows.rows, dtype=np.float64)
    return _within(sweeps(rows), one.correlation(number, number))


def _within(labels: Sequence[object], matrix: FloatArray) -> FloatArray:
    """The matrix where two rows have the same label, 0 elsewhere."""
    codes = {label: code for code, label in enumerate(dict.fromkeys(labels))}
    code = np.array([codes[label] for label in labels])
    return np.where(code[:, None] == code, matrix, 0.0)
