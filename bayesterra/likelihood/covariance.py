"""Covariance of correlated readings: which hang together, and the law of a whole table.

Readings that hang together form a block: those of a wheel where there is a discrepancy, of a sweep where
there is ripple only. Channels are apart unless errors of conditions tie them: each is a standard normal
number of its row, which moves the outcomes along its effects (n, m, k, e). Blocks of one size are stacked, so
that all of them are factorised at once for any number of parameter sets.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, IntArray, frozen
from bayesterra.likelihood.condition_errors import Loads
from bayesterra.likelihood.sites import VAGUE, Sites
from bayesterra.stats.tails import GAUSSIAN, Tails
from bayesterra.study.model_errors import Discrepancy, ModelErrors, Ripple
from bayesterra.study.observations import Observations

Pair = tuple[int, int]


def sweeps(rows: Observations) -> tuple[tuple[str, str], ...]:
    """The sweep of every row: its wheel, and its run where the table has such a column."""
    runs = rows.labels.get("run", ("",) * len(rows))
    return tuple(zip(rows.wheel, runs, strict=True))


@dataclass(frozen=True)
class Stack:
    """B blocks of q readings each."""

    rows: IntArray  # of every reading (B, q)
    columns: IntArray  # channel of every reading (B, q)
    terms: tuple[tuple[int, FloatArray], ...]  # which size, and the correlation (B, q, q) that it belongs to
    tied: bool  # errors of conditions tie the readings of a row
    noise: FloatArray | None = None  # standard deviations (B, q) where all parameter sets have the same; else None

    @cached_property
    def axes(self) -> tuple[int, FloatArray, FloatArray, float] | None:
        """Principal axes of the one thing that ties a stack's readings beside noise that is known.

        Which size it has, variances (B, q) of its correlation in units of the noise, rows (B, q, q) along
        which readings then are independent, and the log of the noise, summed; None where there is more to it.
        """
        if self.noise is None or self.tied or len(self.terms) != 1:
            return None
        which, correlation = self.terms[0]
        values, vectors = np.linalg.eigh(correlation / (self.noise[..., :, None] * self.noise[..., None, :]))
        along = vectors.swapaxes(-1, -2) / self.noise[..., None, :]
        return which, np.maximum(values, 0.0), np.asarray(along), float(np.log(self.noise).sum())

    def covariance(self, scale: FloatArray, sizes: FloatArray, effects: FloatArray) -> FloatArray:
        """Covariance (n, B, q, q) for noise (n, m, k), sizes (n, j) and effects (n, m, k, e)."""
        variance = scale[:, self.rows, self.columns] ** 2
        matrix: FloatArray = np.zeros((*variance.shape, variance.shape[-1]))
        np.einsum("nbqq->nbq", matrix)[...] = variance
        for which, correlation in self.terms:
            matrix += sizes[:, which, None, None, None] ** 2 * correlation
        if self.tied:
            matrix += self.tie(effects, effects)
        return matrix

    def tie(self, effects: FloatArray, others: FloatArray) -> FloatArray:
        """Covariance (n, B, q, q) of effects (n, m, k, e) with others of the same errors."""
        first, second = (part[:, self.rows, self.columns] for part in (effects, others))
        return np.asarray((first @ second.swapaxes(-1, -2)) * self.same_row)

    def by_size(self, which: int, sizes: FloatArray) -> FloatArray | None:
        """Derivative (n, B, q, q) of the covariance by the size of a field; None where it has no part."""
        correlations = dict(self.terms)
        if which not in correlations:
            return None
        return np.asarray(2.0 * sizes[:, which, None, None, None] * correlations[which])

    @property
    def same_row(self) -> BoolArray:
        """Mask of pairs of readings of a block that are of one row (B, q, q)."""
        return np.asarray(self.rows[:, :, None] == self.rows[:, None, :])

    def whitening(self, scale: FloatArray, sizes: FloatArray, effects: FloatArray) -> "Whitening":
        """The factor of the covariance; arguments as for :meth:`covariance`."""
        if not self.terms and not self.tied:
            sd = scale[:, self.rows, self.columns]
            return Whitening(1.0 / sd[..., None] * np.eye(sd.shape[-1]), np.log(sd).sum(axis=(1, 2)))
        if self.axes is not None:
            which, values, vectors, level = self.axes
            spread = 1.0 + sizes[:, which, None, None] ** 2 * values
            return Whitening(vectors / np.sqrt(spread)[..., None], level + 0.5 * np.log(spread).sum(axis=(1, 2)))
        lower = np.linalg.cholesky(self.covariance(scale, sizes, effects))
        level = np.log(np.einsum("nbqq->nbq", lower)).sum(axis=(1, 2))
        return Whitening(np.linalg.inv(lower), np.asarray(level))


@dataclass(frozen=True)
class Whitening:
    """Matrices W (n or 1, B, q, q) with W K Wᵀ = 1.

    ``level`` (n or 1,) is half the log determinants of K, all blocks together.
    """

    matrix: FloatArray
    level: FloatArray

    def of(self, residuals: FloatArray) -> FloatArray:
        """White residuals (n, B, q)."""
        return np.asarray((self.matrix @ residuals[..., None])[..., 0])

    def back(self, white: FloatArray) -> FloatArray:
        """Wᵀ times white residuals (n, B, q)."""
        return np.asarray((self.matrix.swapaxes(-1, -2) @ white[..., None])[..., 0])

    def take(self, chosen: IntArray) -> "Whitening":
        """Those of the sets, also repeatedly."""
        if len(self.matrix) == 1:
            return self
        return Whitening(self.matrix[chosen], self.level[chosen])


def stacks(
    errors: ModelErrors,
    rows: Observations,
    channels: Sequence[str],
    conditioned: BoolArray,
    noise: FloatArray | None = None,
    *,
    tied: bool,
) -> list[Stack]:
    """All readings where ``conditioned`` (m, channels) holds, in stacks of blocks.

    ``noise`` (m, channels) are the standard deviations, where they do not depend on the parameters; ``tied``
    holds where conditions have errors.
    """
    groups: dict[tuple[object, ...], list[Pair]] = {}
    sweep = sweeps(rows)
    for i, column in np.argwhere(conditioned):
        key = _block(errors, channels[column], int(i), rows.wheel[i], sweep[i], tied=tied)
        groups.setdefault(key, []).append((int(i), int(column)))
    alone = [pair for key, pairs in groups.items() if key[-1] == "alone" for pair in pairs]
    blocks = [pairs for key, pairs in groups.items() if key[-1] != "alone"]
    alike: dict[tuple[int, int], list[list[Pair]]] = {}
    for pairs in blocks:  # of one channel, where channels are apart: then one thing ties them
        alike.setdefault((len(pairs), 0 if tied else pairs[0][1]), []).append(pairs)
    stacked = [
        Stack(i, at, _terms(i, at, errors, rows, channels), tied, None if noise is None else noise[i, at])
        for i, at in (np.moveaxis(np.array(pairs), -1, 0) for pairs in alike.values())
    ]
    if alone:
        block = np.array([alone])
        stacked.append(Stack(block[..., 0], block[..., 1], (), tied=False))
    return stacked


def _block(errors: ModelErrors, channel: str, row: int, wheel: str, sweep: object, *, tied: bool) -> tuple[object, ...]:
    """To which block a reading belongs."""
    own = ("" if tied else channel,)
    if errors.discrepancy if tied else channel in errors.discrepancy:
        return (*own, wheel, "wheel")
    if errors.ripple if tied else channel in errors.ripple:
        return (*own, sweep, "sweep")
    return (*own, row, "row" if tied else "alone")


def _terms(
    i: IntArray, column: IntArray, errors: ModelErrors, rows: Observations, channels: Sequence[str]
) -> tuple[tuple[int, FloatArray], ...]:
    """Fields that readings (B, q) in rows ``i`` and columns have a part in; see :class:`Stack`."""
    terms = []
    for which, error in enumerate(errors.fields):
        mine = column == channels.index(error.channel)
        both = mine[:, :, None] & mine[:, None, :]
        if both.any():
            whole = correlation(error, rows)
            terms.append((which, np.where(both, whole[i[:, :, None], i[:, None, :]], 0.0)))
    return tuple(terms)


def correlation(error: Discrepancy | Ripple, rows: Observations) -> FloatArray:
    """Correlation (m, m) of a discrepancy or a ripple between the rows of a table."""
    if isinstance(error, Discrepancy):
        return _within(rows.wheel, error.correlation(rows.slip, rows.slip))
    number = np.array(rows.rows, dtype=np.float64)
    return _within(sweeps(rows), error.correlation(number, number))


def _within(labels: Sequence[object], matrix: FloatArray) -> FloatArray:
    """The matrix where two rows have the same label, 0 elsewhere."""
    codes = {label: code for code, label in enumerate(dict.fromkeys(labels))}
    code = np.array([codes[label] for label in labels])
    return np.where(code[:, None] == code, matrix, 0.0)


LOG_2_PI = float(np.log(2 * np.pi))
ROUNDS = 6
"""How often every law in place of a reading is told by the others."""
NONE = frozen(np.empty(0))


@dataclass(frozen=True)
class Layout:
    """Layout of the readings: all that does not depend on the parameters."""

    errors: ModelErrors  # discrepancy, ripple and slip errors
    rows: Observations  # the table
    channels: tuple[str, ...]  # measured outcomes, the k columns
    tails: tuple[Tails, ...]  # laws of their noise
    stacks: Sequence[Stack]  # readings that hang together, of those that are conditioned on

    @cached_property
    def heavy(self) -> BoolArray:
        """Channels (k,) whose noise is not Gaussian."""
        return np.array([tails != GAUSSIAN for tails in self.tails])

    def spread(self, z: FloatArray) -> FloatArray:
        """Variances (n, m, k) of normal noise that pulls as much at residuals, in units of the scale."""
        laws = [tails.spread(z[..., i]) for i, tails in enumerate(self.tails)]
        return np.nan_to_num(np.stack(laws, axis=-1), nan=1.0)

    @cached_property
    def correlations(self) -> list[FloatArray]:
        """Of every field between all rows (m, m)."""
        return [correlation(error, self.rows) for error in self.errors.fields]

    @cached_property
    def columns(self) -> list[int]:
        """Column of the channel that every field is an error of."""
        return [self.channels.index(error.channel) for error in self.errors.fields]

    def variance(self, sizes: FloatArray, effects: FloatArray) -> FloatArray:
        """Variance (n, m, k) of fields and errors of conditions before any reading."""
        variance = np.asarray((effects**2).sum(axis=3))
        for which, column in enumerate(self.columns):
            variance[:, :, column] += sizes[:, [which]] ** 2
        return variance

    @cached_property
    def doubles(self) -> int:
        """Numbers that the whitening of one parameter set takes."""
        return sum(stack.rows.shape[0] * stack.rows.shape[1] ** 2 for stack in self.stacks)


@dataclass(frozen=True)
class Drawn:
    """Draws of the model errors."""

    at_rows: FloatArray  # discrepancy, ripple and effects of errors of conditions at every row (n, m, k)
    discrepancy: FloatArray  # at every row (n, m, k)
    elsewhere: FloatArray  # the discrepancy at other slips (n, g, k)
    shifts: FloatArray  # errors of conditions in standard deviations (n, m, e)


@dataclass(frozen=True)
class TableLaw:
    """Law of the readings of a table at n parameter sets."""

    layout: Layout  # what hangs together
    mean: FloatArray  # what the model says (n, m, k)
    scale: FloatArray  # noise of single readings (n, m, k)
    sizes: FloatArray  # standard deviations of discrepancies, ripples and slip errors (n, j)
    effects: FloatArray  # of one standard deviation of every error of a condition (n, m, k, e)
    whitenings: tuple[Whitening, ...]  # of every stack
    loads: Loads | None = None  # latent loads, whose effects are the last; None where loads are known
    sites: Sites | None = None  # what stands in the place of readings without a normal law; None without any

    def told(self, side: FloatArray, readings: FloatArray) -> "TableLaw":
        """The same with normal laws in place of readings that have none; see :class:`Sites`.

        ``side`` (m, k) is 1 and −1 for readings known to lie above and below what they say, 0 for numbers.
        """
        needed = self.known & ((side != 0) | self.layout.heavy)
        if not needed.any():
            return self if self.sites is None else self._with(None)
        sd = np.sqrt(self.scale**2 + self.layout.variance(self.sizes, self.effects))
        start = self.scale * np.sqrt(self.layout.spread((readings - self.mean) / sd))
        start = np.where(side == 0, start, VAGUE * sd)
        side = np.where(needed, side, np.nan)
        sites = Sites.begun(side, readings, self.scale, start, self.layout.tails)
        law, place = self._with(sites), (slice(None), sites.row, sites.column)
        for _ in range(ROUNDS if len(sites.row) > 1 else 1):
            variance = 1.0 / np.einsum("nmkk->nmk", law.precisions)[place]
            off = law.pulls(law.residuals(readings))[place]
            sites = sites.given(sites.values - off * variance, variance)
            law = law._with(sites)
        return law

    def _with(self, sites: Sites | None) -> "TableLaw":
        """The same with other laws in place of readings."""
        law = replace(self, sites=sites)
        parts = (stack.whitening(law.noise, self.sizes, self.effects) for stack in self.layout.stacks)
        return replace(law, whitenings=tuple(parts))

    @cached_property
    def expected(self) -> "TableLaw":
        """The same with normal noise of the information that heavy-tailed noise has about its place."""
        if self.sites is None or not self.layout.heavy.any():
            return self
        root = np.sqrt([tails.information[0] for tails in self.layout.tails])
        sites, wider = self.sites, replace(self, scale=self.scale / root)
        sd = np.where(sites.low < sites.high, sites.sd, sites.scale / root[sites.column])
        return wider._with(replace(sites, sd=sd))

    @property
    def noise(self) -> FloatArray:
        """Noise (n, m, k) of readings, and of what stands in the place of some."""
        if self.sites is None:
            return self.scale
        noise = self.scale.copy()
        noise[:, self.sites.row, self.sites.column] = self.sites.sd
        return noise

    def residuals(self, readings: FloatArray) -> FloatArray:
        """Readings (m, k), or what stands in the place of some, off the mean (n, m, k)."""
        off, sites = readings - self.mean, self.sites
        if sites is not None:
            off[:, sites.row, sites.column] = sites.values - self.mean[:, sites.row, sites.column]
        return off

    def take(self, chosen: IntArray) -> "TableLaw":
        """At some of the sets, also repeatedly."""
        return replace(
            self, mean=self.mean[chosen], scale=self.scale[chosen], sizes=self.sizes[chosen],
            effects=self.effects[chosen],
            whitenings=tuple(whitening.take(chosen) for whitening in self.whitenings),
            loads=None if self.loads is None else self.loads.take(chosen),
            sites=None if self.sites is None else self.sites.take(chosen),
        )  # fmt: skip

    @property
    def levels(self) -> FloatArray:
        """What latent loads and sites add to the log density of every row (n or 1, m)."""
        levels = np.zeros((1, len(self.known)))
        if self.loads is not None:
            levels = np.where(self.known.any(axis=1), self.loads.level, levels)
        if self.sites is not None:
            levels = np.repeat(levels, len(self.mean) // len(levels), axis=0)
            for row, level in zip(self.sites.row, self.sites.level.T, strict=True):
                levels[:, row] += level
        return levels

    def white(self, residuals: FloatArray) -> list[FloatArray]:
        """White residuals (n, B, q) of every stack."""
        pairs = zip(self.layout.stacks, self.whitenings, strict=True)
        return [whitening.of(residuals[:, stack.rows, stack.columns]) for stack, whitening in pairs]

    def log_density(self, readings: FloatArray) -> FloatArray:
        """Log density (n,) of readings (m, k); only those that the layout conditions on count."""
        total = np.broadcast_to(self.levels.sum(axis=1), len(self.mean)).copy()
        for white, whitening in zip(self.white(self.residuals(readings)), self.whitenings, strict=True):
            total -= 0.5 * (white**2).sum(axis=(1, 2)) + whitening.level + 0.5 * white[0].size * LOG_2_PI
        return total

    def pulls(self, residuals: FloatArray) -> FloatArray:
        """K⁻¹ times residuals (n, m, k), 0 where there is no reading."""
        pulls = np.zeros(residuals.shape)
        for stack, whitening, white in zip(self.layout.stacks, self.whitenings, self.white(residuals), strict=True):
            pulls[:, stack.rows, stack.columns] = whitening.back(white)
        return pulls

    @cached_property
    def precisions(self) -> FloatArray:
        """Blocks of K⁻¹ for the readings of each row (n or 1, m, k, k); 1 where there is no reading."""
        sets = max((len(whitening.matrix) for whitening in self.whitenings), default=1)
        m, k = self.mean.shape[1:]
        precisions = np.broadcast_to(np.eye(k), (sets, m, k, k)).copy()
        for stack, whitening in zip(self.layout.stacks, self.whitenings, strict=True):
            block, i, j = np.nonzero(stack.same_row)
            columns = whitening.matrix.swapaxes(-1, -2)
            value = (columns[:, block, i] * columns[:, block, j]).sum(axis=-1)
            place = (stack.rows[block, i], stack.columns[block, i], stack.columns[block, j])
            precisions[:, *place] = value
        return precisions

    def row_terms(self, readings: FloatArray) -> FloatArray:
        """Log density (n, m) of each row's readings given those of all other rows.

        With a = K⁻¹(y − μ) and Q the block of K⁻¹ of a row, that is a normal law of covariance Q⁻¹ around
        y − Q⁻¹a (Bürkner, Gabry and Vehtari 2021, Computational Statistics 36, 1243).
        """
        pull, Q = self.pulls(self.residuals(readings)), self.precisions
        _, log_det = np.linalg.slogdet(Q)
        square = (pull * np.linalg.solve(Q, pull[..., None])[..., 0]).sum(axis=2)
        counts = self.known.sum(axis=1)
        return np.asarray(0.5 * (log_det - square - counts * LOG_2_PI) + self.levels)

    def scores(self, readings: FloatArray) -> FloatArray:
        """Normal scores (n, m, k) of readings given all other rows; NaN where there is none."""
        pull, Q = self.pulls(self.residuals(readings)), self.precisions
        deviation = np.linalg.solve(Q, pull[..., None])[..., 0]
        variance = np.einsum("nmkk->nmk", np.linalg.inv(Q))
        scores = deviation / np.sqrt(variance)
        if self.sites is not None:
            place = (slice(None), self.sites.row, self.sites.column)
            scores[place] = self.sites.scores(self.sites.values - deviation[place], variance[place])
        return np.where(self.known, scores, np.nan)

    def ahead(self, readings: FloatArray, targets: IntArray) -> tuple[FloatArray, FloatArray]:
        """Mean (n, t, k) and covariance (n, t, k, k) of readings of rows not conditioned on, given others.

        Noise, ripple and errors of conditions of these rows are among it.
        """
        centre, effects = self.mean[:, targets].copy(), self.effects[:, targets]
        covariance = effects @ effects.swapaxes(-1, -2)
        fields = self.layout.variance(self.sizes, np.zeros((*self.mean.shape, 0)))
        np.einsum("ntkk->ntk", covariance)[...] += (self.scale**2 + fields)[:, targets]
        channels = range(centre.shape[2])
        residuals = self.white(self.residuals(readings))
        for stack, whitening, white in zip(self.layout.stacks, self.whitenings, residuals, strict=True):
            told = np.stack([whitening.matrix @ self._between(stack, targets, c) for c in channels], axis=-1)
            centre += (white[..., None, None] * told).sum(axis=(1, 2))
            covariance -= np.einsum("nbqtk,nbqtl->ntkl", told, told)
        return centre, covariance

    def _between(self, stack: Stack, targets: IntArray, column: int) -> FloatArray:
        """Covariance (n, B, q, t) of the readings of a stack with those of a channel in other rows."""
        effects = self.effects[:, stack.rows, stack.columns] @ self.effects[:, None, targets, column].mT
        covariance = effects * (stack.rows[..., None] == targets)
        mine = (stack.columns == column)[..., None]
        for which, between in enumerate(self.layout.correlations):
            if self.layout.columns[which] == column:
                shared = np.where(mine, between[stack.rows[..., None], targets], 0.0)
                covariance += self.sizes[:, which, None, None, None] ** 2 * shared
        return np.asarray(covariance)

    @cached_property
    def known(self) -> BoolArray:
        """Readings that are conditioned on (m, k)."""
        conditioned = np.zeros(self.mean.shape[1:], dtype=np.bool_)
        for stack in self.layout.stacks:
            conditioned[stack.rows, stack.columns] = True
        return conditioned

    def draw(
        self, readings: FloatArray | None, rng: Generator, wheel: str | None = None, slip: FloatArray = NONE
    ) -> Drawn:
        """Draw discrepancy, ripple and errors of conditions given readings (m, k), or before any (None).

        By Matheron's rule: a draw before the readings, moved by what the readings say against it. The
        discrepancy is drawn at slips (g,) of a wheel of the table, or of another one (None), too.
        """
        columns, m = self.layout.columns, self.mean.shape[1]
        across = [self._across(i, error, wheel, slip) for i, error in enumerate(self.layout.errors.fields)]
        fields = [self._before(which, matrix, rng) for which, matrix in enumerate(across)]
        shifts = rng.standard_normal((*self.effects.shape[:2], self.effects.shape[3]))
        if readings is not None:
            noise = self.noise * rng.standard_normal(self.scale.shape)
            pull = self.pulls(self.residuals(readings) - sum(self._sums(fields, shifts)) - noise)
            for which, column in enumerate(columns):
                told = pull[:, :, column] @ across[which][:, :m].T
                fields[which] = fields[which] + self.sizes[:, [which]] ** 2 * told
            shifts = shifts + (pull[..., None] * self.effects).sum(axis=2)
        curves, others = self._sums(fields, shifts)
        there = np.zeros((len(self.mean), len(slip), self.mean.shape[2]))
        for column, field in zip(columns[: len(self.layout.errors.discrepancy)], fields, strict=False):
            there[:, :, column] = field[:, m:]
        return Drawn(curves + others, curves, there, shifts)

    def draw_loads(self, readings: FloatArray, rng: Generator) -> tuple[FloatArray, FloatArray]:
        """Draw latent loads (n, m), and all else that is not the model's (n, m, k), given readings."""
        drawn, loads = self.draw(readings, rng), self.loads
        if loads is None:
            raise ValueError("the loads of this table are known")
        shift = drawn.shifts[:, :, -1]
        others = drawn.at_rows - self.effects[..., -1] * shift[..., None]
        return loads.mean + loads.sd * shift, others

    def _across(self, which: int, error: object, wheel: str | None, slip: FloatArray) -> FloatArray:
        """Correlation of a field at rows and, for a discrepancy, at other slips, among themselves."""
        inside, rows = self.layout.correlations[which], self.layout.rows
        if not isinstance(error, Discrepancy):
            return inside
        same = np.array([wheel == own for own in rows.wheel])
        between = np.where(same[:, None], error.correlation(rows.slip, slip), 0.0)
        return np.block([[inside, between], [between.T, error.correlation(slip, slip)]])

    def _before(self, which: int, matrix: FloatArray, rng: Generator) -> FloatArray:
        """A field (n, m + g) before any reading."""
        values, vectors = np.linalg.eigh(matrix)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        unit = rng.standard_normal((len(self.mean), len(root))) @ root.T
        return np.asarray(self.sizes[:, [which]] * unit)

    def _sums(self, fields: Sequence[FloatArray], shifts: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Discrepancies, and all else, as they enter the readings of the rows, (n, m, k) each."""
        m, curves = self.mean.shape[1], np.zeros(self.mean.shape)
        others = np.einsum("nmke,nme->nmk", self.effects, shifts)
        for which, column in enumerate(self.layout.columns):
            part = curves if which < len(self.layout.errors.discrepancy) else others
            part[:, :, column] += fields[which][:, :m]
        return curves, others
