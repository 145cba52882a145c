"""Which readings hang together, and the whitening of their joint covariance.

Readings that hang together form a block: those of a wheel where there is a discrepancy, of a sweep where
there is ripple only. Channels are apart unless errors in slip tie them. Blocks of one size are stacked, so that
all of them are factorised at once for any number of parameter sets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
    slip : whether errors in slip tie the readings of a row.
    """

    rows: IntArray
    columns: IntArray
    parts: tuple[tuple[int, FloatArray], ...]
    slip: int | None

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


def stacks(errors: ModelErrors, rows: Observations, channels: Sequence[str], known: BoolArray) -> list[Stack]:
    """All readings where ``known`` (m, channels) holds, in stacks of blocks."""
    groups: dict[tuple[object, ...], list[Pair]] = {}
    sweep, place = sweeps(rows), _placed(errors)
    for i, column in np.argwhere(known):
        key = place(channels[column], int(i), rows.wheel[i], sweep[i])
        groups.setdefault(key, []).append((int(i), int(column)))
    alone = [pair for key, pairs in groups.items() if key[-1] == "alone" for pair in pairs]
    blocks = [pairs for key, pairs in groups.items() if key[-1] != "alone"]
    by_size: dict[int, list[list[Pair]]] = {}
    for pairs in blocks:
        by_size.setdefault(len(pairs), []).append(pairs)
    found = [_stack(np.array(same), errors, rows, channels) for same in by_size.values()]
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


def _stack(pairs: IntArray, errors: ModelErrors, rows: Observations, channels: Sequence[str]) -> Stack:
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
    return Stack(i, column, tuple(parts), slip)


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
