"""Change-point detection: candidates of a change of soil from row to row, and the alarm.

For a candidate row t0 another soil takes over: one drawn about the present posterior with a spread of
``CHANGE`` more in every sampling coordinate (a factor of e^0.5 or so in a stress). Its readings are followed
with a Gaussian filter (cubature Kalman filter, Arasaratnam and Haykin 2009), which gives a density q of every
row's readings given the rows since t0. Against the predictive density p of the stream, that of an unchanged
soil, the factor of t0 after row t is

    B(t0, t) = Π q(y_i | y_t0 … y_i−1) / p(y_i | y_1 … y_i−1),    i = t0 … t,

and the statistic is R(t) = Σ B(t0, t) over the candidates (Shiryaev 1963, Roberts 1966). Soils for which the
model has no answer in a row are left out of q and of p alike: the wheel drove there, so that a row whose
readings say nothing leaves B as it was. However rough the filter is, q is a density: while the soil is the
same, the expectation of R(t) is at most t. So the mean number of rows to a false alarm at R ≥ A is at least
A, and the chance of one within m rows at most m/A. That is an average over the soils of the prior and over
their readings, as p is: a soil that the prior holds to be rare may raise more.

A single wild reading is no change of soil. So every factor is also reckoned against an unchanged soil whose
rows are odd, each by itself, with probability ``ODD``, and an odd row is as likely as under the candidate of
that very row. The smaller of the two factors counts, and the bound above still holds.

Memory is bounded: at most ``MOST`` candidates are kept, those with the greatest factors and the youngest few.
To leave one out can only lower R.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace

import numpy as np
from scipy.special import logsumexp

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.follow.particles import Particles
from bayesterra.follow.rows import Alarm
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.parameters import OFFSET, SIZES
from bayesterra.sampling.coordinates import Coordinates, coordinates

CHANGE = 0.5
"""Standard deviation of a change of soil in every sampling coordinate."""
FIRST = 5
"""First row that may be a change: before it too little is known to tell."""
MOST, YOUNG = 32, 8
"""Candidates that are kept, and how many of the youngest are among them whatever their factors."""
ODD = 1e-3
"""Probability that a row is odd by itself."""
ANSWERED = 0.25
"""Share of a filter's points that must have an answer in a row."""


@dataclass(frozen=True)
class Candidates:
    """Rows at which the soil may have changed, and a Gaussian law of the soil since then."""

    since: IntArray  # row numbers (h,)
    log_factors: FloatArray  # log B(t0, t), (h,)
    log_sober: FloatArray  # the same against an unchanged soil with odd rows, (h,)
    means: FloatArray  # of the soil since then in sampling coordinates, (h, d)
    covariances: FloatArray  # likewise, (h, d, d)

    @classmethod
    def none(cls, d: int) -> "Candidates":
        """No candidate yet."""
        return cls(np.empty(0, dtype=np.int64), np.empty(0), np.empty(0), np.empty((0, d)), np.empty((0, d, d)))

    def __len__(self) -> int:
        return len(self.since)

    @property
    def log_counted(self) -> FloatArray:
        """Log of the smaller factor (h,) of every candidate."""
        return np.minimum(self.log_factors, self.log_sober)

    @property
    def log_statistic(self) -> float:
        """Log of R(t); −inf without candidates."""
        return float(logsumexp(self.log_counted)) if len(self) else -np.inf

    @property
    def shares(self) -> FloatArray:
        """Share (h,) of every candidate in R(t)."""
        return np.asarray(np.exp(self.log_counted - self.log_statistic))

    def take(self, chosen: IntArray | BoolArray) -> "Candidates":
        """Some of the candidates."""
        return Candidates(*(getattr(self, column.name)[chosen] for column in fields(self)))

    def joined(self, row: int, mean: FloatArray, covariance: FloatArray) -> "Candidates":
        """One candidate more, with B = 1."""
        factors, sober = (np.append(of, 0.0) for of in (self.log_factors, self.log_sober))
        means, covariances = np.vstack([self.means, mean]), np.concatenate([self.covariances, covariance[None]])
        return Candidates(np.append(self.since, row), factors, sober, means, covariances)

    def pruned(self) -> "Candidates":
        """At most ``MOST`` of them; those without any hope are left out too."""
        ranks = np.where(np.arange(len(self)) >= len(self) - YOUNG, np.inf, self.log_counted)
        ranks[np.isneginf(self.log_counted)] = -np.inf
        best = np.argsort(-ranks, kind="stable")[:MOST]
        return self.take(np.sort(best[ranks[best] > -np.inf]))


@dataclass(frozen=True)
class Basis:
    """Sampling coordinates that candidates are held in, and the posterior they belong to."""

    posterior: Posterior
    coordinates: Coordinates

    def opened(self, candidates: Candidates, row: int, particles: Particles) -> Candidates:
        """The candidates and a new one: the soil may change at ``row``, before which the particles stand."""
        with np.errstate(all="ignore"):
            u = self.coordinates.from_physical(particles.x)
        sound = np.flatnonzero(np.isfinite(u).all(axis=1) & (particles.log_weights > -np.inf))
        weights = particles.weights[sound] / particles.weights[sound].sum()
        mean = weights @ u[sound]
        offsets = u[sound] - mean
        # noise and the zero of the sinkage do not change
        fixed = [name.startswith(SIZES) or name == OFFSET for name in self.posterior.names]
        covariance = (offsets * weights[:, None]).T @ offsets + np.diag(np.where(fixed, 0.0, CHANGE**2))
        return candidates.joined(row, mean, covariance)

    def rebased(self, candidates: Candidates, other: "Basis") -> Candidates:
        """The same candidates in the coordinates of another basis."""
        if not len(candidates):
            return candidates
        h, d = candidates.means.shape
        x, _ = self.coordinates.to_physical(_points(candidates).reshape(-1, d))
        with np.errstate(all="ignore"):
            u = other.coordinates.from_physical(x).reshape(h, 2 * d, d)
        sound: BoolArray = np.asarray(np.isfinite(u).all(axis=2))
        share = sound / np.maximum(sound.sum(axis=1, keepdims=True), 1)
        u = np.where(sound[:, :, None], u, 0.0)
        means = np.einsum("hp,hpd->hd", share, u)
        offsets = np.where(sound[:, :, None], u - means[:, None, :], 0.0)
        covariances = np.einsum("hp,hpi,hpj->hij", share, offsets, offsets)
        moved = replace(candidates, means=means, covariances=covariances)
        return moved.take(sound.mean(axis=1) >= ANSWERED)

    def followed(self, candidates: Candidates, row: Likelihood, log_predictive: float) -> Candidates:
        """Let the filter of every candidate see a row; the last candidate is the one opened for that row.

        Parameters
        ----------
        row : likelihood of that row.
        log_predictive : log density of its readings if the soil is the same, among soils that have an answer.
        """
        read = ~np.isnan(row.measured[0])
        if not len(candidates):
            return candidates
        h, d = candidates.means.shape
        points = _points(candidates)
        predicted, variance, share = self._predicted(points.reshape(-1, d), row, read, h)
        mean = np.einsum("hp,hpk->hk", share, predicted)
        spread = np.where(share[:, :, None] > 0, predicted - mean[:, None, :], 0.0)
        offsets = points - candidates.means[:, None, :]
        alive = share.sum(axis=1) > 0
        noise = np.where(alive[:, None], np.einsum("hp,hpk->hk", share, variance), 1.0)
        expected = np.einsum("hp,hpi,hpj->hij", share, spread, spread) + noise[:, :, None] * np.eye(int(read.sum()))
        cross = np.einsum("hp,hpi,hpj->hij", share, offsets, spread)
        residual = row.measured[0][read] - mean
        gain = np.swapaxes(np.linalg.solve(expected, np.swapaxes(cross, 1, 2)), 1, 2)
        covariances = candidates.covariances - gain @ expected @ np.swapaxes(gain, 1, 2)
        density = np.where(alive, _log_normal(residual, expected), -np.inf)
        odd = np.logaddexp(np.log1p(-ODD) + log_predictive, np.log(ODD) + density[-1])
        factors, sober = candidates.log_factors + density - log_predictive, candidates.log_sober + density - odd
        means = candidates.means + np.einsum("hij,hj->hi", gain, residual)
        return Candidates(candidates.since, factors, sober, means, 0.5 * (covariances + np.swapaxes(covariances, 1, 2)))

    def _predicted(
        self, u: FloatArray, row: Likelihood, read: BoolArray, h: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Readings and their variance (h, points, k), and shares (h, points), 0 where too few have an answer."""
        x, log_jacobian = self.coordinates.to_physical(u)
        # a changed soil may lie outside the prior's range; all that is asked is that the model has an answer
        sound = np.isfinite(log_jacobian) & np.isfinite(x).all(axis=1)
        k = int(read.sum())
        predicted, variance = np.zeros((len(u), k)), np.ones((len(u), k))
        inside = np.flatnonzero(sound)
        if inside.size:
            outcomes = row.forward(self.posterior.prior.soil_values(x[inside]), every_row=True)
            modelled = row.predicted(outcomes)
            scales = row.scales(modelled, self.posterior.noise_values(x[inside]))[:, 0][:, read]
            answered = np.isfinite(modelled[:, 0]).all(axis=1)
            sound[inside] = answered
            heavier = np.array([noise.tails.variance for noise in row.noise])[read]
            predicted[inside[answered]] = modelled[answered][:, 0][:, read]
            variance[inside[answered]] = scales[answered] ** 2 * heavier
        sound = sound.reshape(h, -1)
        enough = sound.mean(axis=1, keepdims=True) >= ANSWERED
        share = np.where(enough, sound / np.maximum(sound.sum(axis=1, keepdims=True), 1), 0.0)
        return predicted.reshape(h, -1, k), variance.reshape(h, -1, k), share


def _points(candidates: Candidates) -> FloatArray:
    """Points (h, 2 d, d) of equal weight with the mean and covariance of every candidate."""
    values, vectors = np.linalg.eigh(candidates.covariances)
    d = candidates.means.shape[1]
    steps = np.swapaxes(vectors * np.sqrt(d * np.maximum(values, 1e-14))[:, None, :], 1, 2)
    middle = candidates.means[:, None, :]
    return np.concatenate([middle + steps, middle - steps], axis=1)


def _log_normal(residual: FloatArray, covariance: FloatArray) -> FloatArray:
    """Log density (h,) of residuals (h, k) under normal laws of covariance (h, k, k)."""
    factor = np.linalg.cholesky(covariance)
    standard = np.linalg.solve(factor, residual[:, :, None])[:, :, 0]
    log_det = np.log(np.diagonal(factor, axis1=1, axis2=2)).sum(axis=1)
    return np.asarray(-0.5 * (standard**2).sum(axis=1) - log_det - 0.5 * residual.shape[1] * np.log(2 * np.pi))


EVIDENCE = 0.9
"""Share of the evidence between the first and the last row that an alarm names."""


class ChangeDetector:
    """Detector of a change of soil, until it finds one.

    Parameters
    ----------
    rate : false alarms per row, at most, on average over the prior; None does not look.
    d : number of parameters.
    posterior_of : posterior of the first rows by their number; gives the coordinates of the candidates.
    """

    def __init__(self, rate: float | None, d: int, posterior_of: Callable[[int], Posterior]) -> None:
        self.rate, self._posterior_of = rate, posterior_of
        self.candidates = Candidates.none(d)
        self.alarm: Alarm | None = None
        self.basis = 0
        self._based: Basis | None = None

    def see(self, number: int, rows: int, before: Particles, row: Likelihood, log_predictive: float) -> Alarm | None:
        """Take in a row; an alarm where it first seems that the soil has changed.

        Parameters
        ----------
        number, rows : of the row, and of all rows of this soil.
        before : cloud of the rows before it.
        log_predictive : log density of its readings if the soil is the same, among soils that have an answer.
        """
        if self.rate is None or self.alarm is not None or rows < FIRST:
            return None
        # coordinates that suit the rows so far, looked for anew whenever these have doubled
        basis = self.based(1 << ((rows - 1).bit_length() - 1))
        candidates = basis.opened(self.candidates, number, before)
        self.candidates = basis.followed(candidates, row, log_predictive).pruned()
        if self.candidates.log_statistic >= -np.log(self.rate):
            self.alarm = alarm_of(number, self.candidates, self.rate)
        return self.alarm

    def based(self, rows: int) -> Basis:
        """Coordinates after so many rows; candidates are carried over to them."""
        if self._based is None or self.basis != rows:
            posterior = self._posterior_of(rows)
            basis = Basis(posterior, coordinates(posterior))
            if self._based is not None:
                self.candidates = self._based.rebased(self.candidates, basis)
            self.basis, self._based = rows, basis
        return self._based

    def go_on(self, candidates: Candidates, basis: int, alarm: Alarm | None) -> None:
        """Stand where another watch stood."""
        if basis:
            self.based(basis)
        self.candidates, self.alarm = candidates, alarm


def alarm_of(number: int, candidates: Candidates, rate: float) -> Alarm:
    """The alarm that candidates raise at a row."""
    order = np.argsort(-candidates.shares, kind="stable")
    enough = 1 + int((np.cumsum(candidates.shares[order]) < EVIDENCE).sum())
    likely = candidates.since[order[:enough]]
    return Alarm(
        row=number, since=int(likely[0]), first=int(likely.min()), last=int(likely.max()),
        log_statistic=candidates.log_statistic, rate=rate,
    )  # fmt: skip
