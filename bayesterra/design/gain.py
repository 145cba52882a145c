"""Expected information and expected standard deviations of candidate drives.

The whole gain is I(y; x) = E log p(y | x) − E log p(y), where p(y) is the mean density over the draws. The
gain about some parameters θ is I(y; x) − I(y; x | θ), where p(y | θ) is a kernel-weighted mean over draws
whose predictions a quadratic regression has moved to θ. The leading bias of the log of a mean with the draw
itself in it, −½ E[Σ w²] for weights w, is taken out. Where a reading leaves too few effective draws for that,
lower bounds come from a regression of the parameters on the readings (:func:`normal_estimate`).
"""

from dataclasses import dataclass, fields
from functools import cached_property
from itertools import combinations_with_replacement
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy.special import ndtri
from scipy.stats import rankdata

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.design.candidates import Reading, standard_noise

GROUPS = 20
"""Groups of draws that are left out in turn for Monte Carlo errors."""
FEWEST = 50
"""Draws with an answer below which nothing is estimated."""
STEADY = 0.05
"""Least share of the weight that a variance is divided by."""
TINY = 1e-150
"""Sums of densities, relative to their peak, that count as none."""
PER_TERM = 20
"""Draws per term of a regression on the readings, at least."""


@dataclass(frozen=True)
class Estimate:
    """Expected information of a candidate, with the same from all groups of draws but one.

    Attributes
    ----------
    replicates : (1 + groups, 2 + s): first from all draws. Columns: gain about the parameters of interest,
        gain about all, nats; then expected standard deviation of each parameter of interest, SI.
    answered : share of draws for which the model has an answer.
    effective : median effective number of draws after a reading, the smaller of those behind the two gains.
    """

    replicates: FloatArray
    answered: float
    effective: float

    @property
    def values(self) -> FloatArray:
        """Estimates (2 + s,)."""
        return np.asarray(self.replicates[0])

    @property
    def errors(self) -> FloatArray:
        """Monte Carlo standard errors (2 + s,)."""
        return jackknife(self.replicates)


def jackknife(replicates: FloatArray) -> FloatArray:
    """Standard errors from estimates (1 + groups, ...) of which all but the first left one group out."""
    left = replicates[1:]
    return np.asarray(np.sqrt((len(left) - 1) * left.var(axis=0)))


def estimate(densities: "Pairs", interest: "Interest") -> Estimate:
    """Gains by mixtures over the draws, standard deviations by weighing them; NaN with too few answers."""
    kept = np.flatnonzero(densities.answered)
    if len(kept) < FEWEST:
        return _nothing(densities, interest)
    square = np.ix_(kept, kept)
    group = kept * GROUPS // len(densities.answered)
    values = interest.values[kept] - interest.values[kept].mean(axis=0)
    marginal = _Mixture.of(densities.log[square], np.zeros((1, 1)), group, np.column_stack([values, values**2]))
    mixtures, conditional = [marginal], None
    if densities.conditional is not None:
        conditional = _Mixture.of(densities.conditional[square], interest.log_kernel[square], group, values[:, :0])
        mixtures.append(conditional)
    rows = [_replicate(marginal, conditional, left_out) for left_out in (-1, *range(GROUPS))]
    effective = min(float(np.median(1 / mixture.share(-1))) for mixture in mixtures)
    return Estimate(np.array(rows), float(densities.answered.mean()), effective)


def _nothing(densities: "Pairs", interest: "Interest") -> Estimate:
    blank = np.full((1 + GROUPS, 2 + len(interest.columns)), np.nan)
    return Estimate(blank, float(densities.answered.mean()), np.nan)


def _replicate(marginal: "_Mixture", conditional: "_Mixture | None", left_out: int) -> FloatArray:
    """Gain of interest, gain of all, standard deviations; without one group of draws."""
    gain = marginal.gain(left_out)
    about = gain - conditional.gain(left_out) if conditional else gain
    return np.array([about, gain, *marginal.deviations(left_out)])


@dataclass(frozen=True)
class _Mixture:
    """Mean densities of n readings over weighted draws, less each one's own, summed group by group."""

    group: IntArray
    own: FloatArray
    sums: FloatArray
    squares: FloatArray
    weights: FloatArray

    @classmethod
    def of(cls, log: FloatArray, log_kernel: FloatArray, group: IntArray, features: FloatArray) -> "_Mixture":
        """From log densities (n, n) and log weights (n, n) or (1, 1), own weight 1; features (n, f)."""
        total = log + log_kernel
        own = np.diagonal(total).copy()
        np.fill_diagonal(total, -np.inf)
        peak = total.max(axis=1)
        weights = np.exp(total - peak[:, None])
        kernel = np.broadcast_to(np.exp(log_kernel), log.shape)
        columns = np.column_stack([np.ones(len(features)), features])
        members = [group == g for g in range(GROUPS)]
        return cls(
            group,
            own - peak,
            np.stack([weights[:, member] @ columns[member] for member in members]),
            np.stack([np.square(weights[:, member]).sum(axis=1) for member in members]),
            np.stack([kernel[:, member].sum(axis=1) for member in members]),
        )

    def _left(self, left_out: int, sums: FloatArray) -> FloatArray:
        """Sums over all groups but one, for the readings outside that group."""
        groups = [g for g in range(GROUPS) if g != left_out]
        return np.asarray(sums[groups].sum(axis=0)[self.group != left_out])

    def share(self, left_out: int) -> FloatArray:
        """1 over the effective number of the other draws, for each reading."""
        total = self._left(left_out, self.sums)[:, 0]
        seen = total > TINY
        squares = self._left(left_out, self.squares) / np.where(seen, total, 1.0) ** 2
        return np.where(seen, np.minimum(squares, 1.0), 1.0)

    def gain(self, left_out: int) -> float:
        """Mean log of p(y | x) over the mean density, without its leading bias."""
        own, others = self.own[self.group != left_out], self._left(left_out, self.sums)[:, 0]
        log_sum = np.logaddexp(np.log(np.maximum(others, TINY)), own)
        mine = np.exp(own - log_sum)
        squares = self.share(left_out) * (1 - mine) ** 2 + mine**2
        log_weights = np.log(self._left(left_out, self.weights))
        return float(np.mean(own - log_sum + log_weights + mine - 0.5 * squares))

    def deviations(self, left_out: int) -> FloatArray:
        """Root mean variance (s,) after a reading, of features that are values and their squares."""
        sums = self._left(left_out, self.sums)
        moments = sums[:, 1:] / np.maximum(sums[:, :1], TINY)
        mean, square = np.split(moments, 2, axis=1)
        variance = (square - mean**2) / np.maximum(1 - self.share(left_out), STEADY)[:, None]
        return np.asarray(np.sqrt(np.maximum(variance, 0.0).mean(axis=0)))


def normal_estimate(densities: "Pairs", interest: "Interest") -> Estimate:
    """Lower bounds of the gains, by regression of normal scores of the parameters on the readings.

    With R the covariance of what a regression of z on terms of y leaves, I(y; z) ≥ h(z) − ½ log det 2πe R
    (Barber and Agakov 2003), and h(z) is taken as that of a normal law. It holds for any number of readings.
    """
    kept = np.flatnonzero(densities.answered)
    if len(kept) < FEWEST:
        return _nothing(densities, interest)
    group = kept * GROUPS // len(densities.answered)
    terms = _terms(densities.readings[kept])
    scores, values = interest.scores[kept], interest.values[kept]
    targets = np.column_stack([scores, values / values.std(axis=0)])
    both = np.column_stack([terms, targets])
    products = np.stack([part.T @ part for part in (both[group == g] for g in range(GROUPS))])
    rows = []
    for left_out in (-1, *range(GROUPS)):
        on = [g for g in range(GROUPS) if g != left_out]
        before, after = _covariances(products[on].sum(axis=0), terms.shape[1])
        d = scores.shape[1]
        gains = [_log_ratio(before, after, list(c)) for c in (interest.columns, range(d))]
        rows.append([*gains, *(np.sqrt(np.diagonal(after)[d:]) * values.std(axis=0))])
    return Estimate(np.array(rows), float(densities.answered.mean()), np.inf)


def _terms(readings: FloatArray) -> FloatArray:
    """Terms (n, q) of a regression: one, readings, squares and, where draws suffice, products."""
    n, k = readings.shape
    y = (readings - readings.mean(axis=0)) / readings.std(axis=0)
    every = k * (k + 3) // 2 < n / PER_TERM
    chosen = [(a, b) for a in range(k) for b in range(a, k if every else a + 1)]
    products = [y[:, a] * y[:, b] for a, b in chosen]
    return np.column_stack([np.ones(n), y, *(products if 2 * k < n / PER_TERM else ())])


def _covariances(products: FloatArray, q: int) -> tuple[FloatArray, FloatArray]:
    """Covariances of targets before and after regression on q terms, of which the first is one."""
    n = products[0, 0]
    cross, targets = products[:q, q:], products[q:, q:]
    before = (targets - np.outer(cross[0], cross[0]) / n) / (n - 1)
    ridge = 1e-9 * n * np.eye(q)
    after = (targets - cross.T @ np.linalg.solve(products[:q, :q] + ridge, cross)) / (n - q)
    return before, after


def _log_ratio(before: FloatArray, after: FloatArray, columns: list[int]) -> float:
    square = np.ix_(columns, columns)
    return float(0.5 * (np.linalg.slogdet(before[square])[1] - np.linalg.slogdet(after[square])[1]))


BLOCK = 500
BANDWIDTH = 2.0
"""Width of the kernel in units of n^(−1/(s + 4)); wide, as a regression takes out what varies inside it."""


@dataclass(frozen=True)
class Interest:
    """Draws of all parameters, and which of them are asked about."""

    draws: FloatArray  # (n, d)
    columns: tuple[int, ...]  # those of the s parameters of interest

    def __getstate__(self) -> dict[str, Any]:
        """Without what can be computed again, which is large."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @property
    def whole(self) -> bool:
        """True where all parameters are of interest."""
        return len(self.columns) == int(self.draws.shape[1])

    @property
    def values(self) -> FloatArray:
        """Draws (n, s) of the parameters of interest."""
        return self.draws[:, self.columns]

    @cached_property
    def scores(self) -> FloatArray:
        """Normal scores (n, d) of all parameters."""
        return np.asarray(ndtri((rankdata(self.draws, axis=0) - 0.5) / len(self.draws)))

    @cached_property
    def log_kernel(self) -> FloatArray:
        """Log weights (n, n) of draws by their distance in the scores of interest, own weight one."""
        z = self.scores[:, self.columns]
        factor = np.linalg.cholesky(np.atleast_2d(np.cov(z.T)) + 1e-12 * np.eye(z.shape[1]))
        z = np.linalg.solve(factor, z.T).T / (BANDWIDTH * len(z) ** (-1 / (z.shape[1] + 4)))
        size = (z**2).sum(axis=1)
        return np.asarray(np.minimum(z @ z.T - 0.5 * (size[:, None] + size[None, :]), 0.0))

    @cached_property
    def terms(self) -> FloatArray:
        """Terms (n, q) of a quadratic in the scores of interest."""
        z = self.scores[:, self.columns]
        products = [z[:, a] * z[:, b] for a, b in combinations_with_replacement(range(z.shape[1]), 2)]
        return np.column_stack([np.ones(len(z)), z, *products])


@dataclass(frozen=True)
class Pairs:
    """Log densities of readings, pair by pair of draws."""

    log: FloatArray  # (n, n) log density of the readings that draw i makes, under draw j
    conditional: FloatArray | None  # the same, draw j moved to what is of interest of draw i; None where all is
    answered: BoolArray  # draws (n,) for which the model has an answer; the others have no part
    readings: FloatArray  # those readings (n, k)

    def __add__(self, other: "Pairs") -> "Pairs":
        """Readings of both, which are independent given the parameters."""
        parts = self.conditional, other.conditional
        conditional = None if parts[0] is None or parts[1] is None else parts[0] + parts[1]
        both = np.column_stack([self.readings, other.readings])
        return Pairs(self.log + other.log, conditional, self.answered & other.answered, both)


def pairs(readings: tuple[Reading, ...], interest: Interest, rng: Generator) -> Pairs:
    """Draw the readings of every draw, row by row, and compute their densities under all draws."""
    first, *others = (_row(reading, interest, rng) for reading in readings)
    return sum(others, first)


def _row(reading: Reading, interest: Interest, rng: Generator) -> Pairs:
    drawn = reading.draw(standard_noise(reading, rng))
    log = _densities(reading, drawn)
    if interest.whole:
        return Pairs(log, None, reading.answered, drawn)
    # means as a quadratic in the parameters of interest explains them
    terms, answered, middle = interest.terms, reading.answered, np.zeros(reading.mean.shape)
    if answered.sum() > terms.shape[1]:
        middle = terms @ np.linalg.lstsq(terms[answered], reading.mean[answered], rcond=None)[0]
    rest = Reading(reading.mean - middle, reading.whitening, reading.noise)
    return Pairs(log, _densities(rest, drawn - middle), reading.answered, drawn)


def _densities(reading: Reading, drawn: FloatArray) -> FloatArray:
    """Log densities (n, n) of readings (n, k), a block of them at a time."""
    blocks = range(0, len(drawn), BLOCK)
    return np.concatenate([reading.log_density(drawn[start : start + BLOCK]) for start in blocks])
