"""Prior and likelihood joined: one callable that knows why a parameter set is impossible."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar, Literal, Protocol

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, IntArray, in_parts
from bayesterra.errors import SupportError, check_kind
from bayesterra.likelihood.correlated import CorrelatedLikelihood
from bayesterra.likelihood.experiments import Experiment
from bayesterra.likelihood.forward import Forward, Outcomes, offset_of
from bayesterra.likelihood.likelihood import LatentLoad, Likelihood
from bayesterra.models import Status
from bayesterra.parameters import NOISE_PREFIX, WHEEL_SIZES
from bayesterra.study.observations import Observations
from bayesterra.study.priors import Prior
from bayesterra.study.study import Study

INSIDE, OUTSIDE_PRIOR, OUTSIDE_PHYSICS = 0, -1, -2
"""Codes of :meth:`Posterior.reasons` beside those of :class:`bayesterra.models.Status`."""

REASONS: Mapping[int, str] = {
    INSIDE: "inside the support",
    OUTSIDE_PRIOR: "outside the prior",
    OUTSIDE_PHYSICS: "Ks, K ≤ 0, c < 0 or φ outside [0°, 90°)",
    int(Status.EXPONENT): "N = n0 + n1 s ≤ 0",
    int(Status.CONTACT_ANGLE): "θm outside (θ2, θ1)",
    int(Status.LOAD): "no sinkage below the wheel radius carries the load",
    int(Status.SINKAGE): "sinkage outside (0, r)",
    int(Status.NORMAL_FORCE): "no normal force in (42) at the sinkage",
    int(Status.NO_ANSWER): "the model has no finite forces",
}


class Drawable(Protocol):
    """A prior that can be drawn from."""

    def sample(self, n: int, rng: Generator) -> FloatArray:
        """Draw parameter sets (n, d), before the physical cut."""


class Density(Protocol):
    """Outline of a :class:`Posterior`: all that sampling needs to know of one."""

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters."""

    @property
    def prior(self) -> Drawable:
        """The stated prior."""

    def reasons(self, x: FloatArray) -> IntArray:
        """Reason why each parameter set (n, d) has no density: a key of ``REASONS``, 0 where it has one."""

    def log_prior_and_likelihood(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log prior and log likelihood, each (n,), both −inf outside the support."""


@dataclass(frozen=True)
class Posterior:
    """Posterior density of the free parameters of a study.

    Parameters are in physical units (SI, radians), one column per entry of :attr:`names`. The density holds
    every constant of prior and likelihood; the prior is the stated law, set to zero outside the physical
    support and not renormalised (:func:`draw_cut_prior` counts what the cut takes).

    Attributes
    ----------
    likelihood : of the rows of wheels.
    experiments : soil tests, whose log likelihoods add to it.
    """

    prior: Prior
    likelihood: Likelihood
    experiments: tuple[Experiment, ...] = ()
    grouped: ClassVar[Literal[False]] = False

    @property
    def driven(self) -> bool:
        """Whether there are rows of a wheel; else ``likelihood`` is about nothing."""
        return bool(len(self.likelihood.observations))

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters: soil parameters first, then ``noise_<channel>``."""
        return self.prior.names

    @property
    def groups(self) -> "Mapping[str, Posterior]":
        """The one group of a study without groups, which has no name."""
        return {"": self}

    @property
    def places(self) -> tuple[IntArray, ...]:
        """Columns of parameter sets that are the parameters of every group: all."""
        return (np.arange(len(self.names)),)

    def values_of_groups(self, x: FloatArray) -> tuple[FloatArray, ...]:
        """Parameter sets (n, d) of every group: ``x`` itself."""
        return (x,)

    def cut_prior(self, n: int, rng: Generator) -> FloatArray:
        """Draws (n, d) of the prior cut to the physical support, see :func:`draw_cut_prior`."""
        return draw_cut_prior(self, n, rng).x

    def one_group(self, group: str, x: FloatArray, rng: Generator) -> "tuple[Posterior, FloatArray]":
        """Posterior of the only group, and its parameter sets (n, d): ``x`` itself."""
        return self, x

    @cached_property
    def _noise_columns(self) -> list[int]:
        return [i for i, name in enumerate(self.names) if name.startswith(WHEEL_SIZES)]

    def noise_values(self, x: FloatArray, channels: tuple[str, ...] | None = None) -> FloatArray:
        """Estimated standard deviations (n, k) among parameter sets ``x`` (n, d), of some channels or all."""
        if channels is None:
            return x[:, self._noise_columns]
        wanted = [NOISE_PREFIX + name for name in channels]
        return x[:, [i for i in self._noise_columns if self.names[i] in wanted]]

    def outcomes(self, x: FloatArray) -> Outcomes:
        """Model the rows in the fit for parameter sets ``x`` (n, d) inside the physical ranges."""
        return self.likelihood.forward(self.prior.soil_values(x))

    def log_terms(self, x: FloatArray) -> FloatArray:
        """Log likelihood (n, rows, terms) of every row in the fit; see ``likelihood.terms``.

        Where rows hang together it is given all other rows, and the sum is not the log likelihood.
        """
        whole = self.likelihood
        return in_parts(whole.log_terms, whole.at_once, self.prior.soil_values(x), self.noise_values(x))

    def log_rows(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log likelihood (n,), and log density (n, rows) of every row given all other rows."""
        return self.likelihood.log_rows(self.prior.soil_values(x), self.noise_values(x))

    def scores(self, x: FloatArray) -> FloatArray:
        """Normal scores (n, rows, channels) of readings given all other rows, NaN where there is none."""
        return self.likelihood.scores(self.prior.soil_values(x), self.noise_values(x))

    def doubts(self, x: FloatArray) -> str:
        """A sentence on rows for which an approximation is poor, at typical sets ``x``; or nothing."""
        return self.likelihood.doubts(self.prior.soil_values(x), self.noise_values(x))

    def explained(self, x: FloatArray, rng: Generator) -> Outcomes:
        """Outcomes behind the readings of the rows in the fit; a latent load is drawn given ``x`` and row."""
        return self.likelihood.explained(self.prior.soil_values(x), self.noise_values(x), rng)

    def drive(self, forward: Forward, outcomes: Outcomes, x: FloatArray, wheel: str | None, rng: Generator) -> Outcomes:
        """Readings of a new drive of a wheel, NaN for channels that have no noise; ``outcomes`` are changed.

        What the model says at the rows of ``forward`` becomes that and the discrepancy: as the readings of
        the wheel tell it, or for a wheel of no name (None) as stated. Sinkages are read with the zero error,
        which ``forward`` may say already. Ripple and errors of slip are those
        of another sweep.
        """
        soil, values, whole = self.prior.soil_values(x), self.noise_values(x), self.likelihood
        noise = tuple(entry for entry in whole.noise if entry.channel in outcomes.names)
        names, columns = [entry.channel for entry in noise], [whole.channels.index(n.channel) for n in noise]
        curve = whole.beyond(soil, values, wheel, forward.conditions.slip, rng)
        fresh = whole.fresh(forward, soil, values, rng)
        for name, column in zip(names, columns, strict=True):
            if curve is not None:
                outcomes.add(name, curve[:, :, column])
        read = replace(outcomes, values=outcomes.values.copy())
        if not forward.as_read:
            read.add("sinkage", offset_of(soil))
        rows = tuple(range(len(forward.given)))
        blank = replace(whole.observations, given_sd={}, values={}, limits={}, rows=rows)
        drawn = Likelihood(forward, blank, noise).draw(read, self.noise_values(x, tuple(names)), rng)
        readings = replace(outcomes, values=np.full(outcomes.values.shape, np.nan))
        for i, (name, column) in enumerate(zip(names, columns, strict=True)):
            readings[name][...] = drawn[:, :, i] + (0.0 if fresh is None else fresh[:, :, column])
        return readings

    def log_prior(self, x: FloatArray) -> FloatArray:
        """Log density (n,) of the stated prior, −inf outside its range and outside the physical ranges."""
        x = np.atleast_2d(np.asarray(x, dtype=np.float64))
        finite = np.asarray(np.isfinite(x).all(axis=1))
        safe = np.where(finite[:, None], x, 0.0)
        return np.where(finite & self._physical(safe), self.prior.log_density(safe), -np.inf)

    def _log_likelihood(self, x: FloatArray) -> FloatArray:
        """Log likelihood (n,) of sets (n, d) inside the physical ranges: of wheels and of soil tests."""
        if self.driven:
            driven = self.likelihood.log_likelihood(self.prior.soil_values(x), self.noise_values(x))
            return driven + self.log_tests(x) if self.experiments else driven
        return self.log_tests(x)

    def log_tests(self, x: FloatArray) -> FloatArray:
        """Log likelihood (n,) of all soil tests at sets (n, d) inside the physical ranges."""
        return np.asarray(sum((each.log_likelihood(x) for each in self.experiments), np.zeros(len(x))))

    def log_before(self, x: FloatArray) -> FloatArray:
        """Log prior (n,) and what soil tests say: all but the readings of wheels; −inf outside the support."""
        prior = self.log_prior(x)
        if self.experiments:
            inside = np.flatnonzero(prior > -np.inf)
            prior[inside] += self.log_tests(np.atleast_2d(x)[inside])
        return prior

    def log_prior_and_likelihood(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log prior and log likelihood, each (n,), both −inf outside the support."""
        x = np.atleast_2d(np.asarray(x, dtype=np.float64))
        prior, likelihood = self.log_prior(x), np.full(len(x), -np.inf)
        candidates = np.flatnonzero(prior > -np.inf)
        if candidates.size:
            inside = x[candidates]
            likelihood[candidates] = self._log_likelihood(inside)
        if np.isnan(likelihood).any() or np.isnan(prior).any():
            worst = x[np.isnan(likelihood) | np.isnan(prior)][0]
            raise FloatingPointError(f"log density is NaN at {dict(zip(self.names, worst, strict=True))}")
        return np.where(likelihood > -np.inf, prior, -np.inf), likelihood

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log posterior density (n,) of parameter sets ``x`` (n, d); −inf outside the support, never NaN.

        Raises
        ------
        ValueError : ``x`` does not have one column per free parameter.
        """
        prior, likelihood = self.log_prior_and_likelihood(checked_sets(x, self.names))
        return prior + np.where(likelihood > -np.inf, likelihood, 0.0)

    def reasons(self, x: FloatArray) -> IntArray:
        """Reason why each parameter set (n, d) has no density: a key of ``REASONS``, 0 where it has one."""
        x = np.atleast_2d(np.asarray(x, dtype=np.float64))
        reasons = np.where(np.isneginf(self.prior.log_density(x)), OUTSIDE_PRIOR, INSIDE)
        reasons[(reasons == INSIDE) & ~self._physical(x)] = OUTSIDE_PHYSICS
        candidates = np.flatnonzero(reasons == INSIDE)
        if candidates.size and self.driven:
            reasons[candidates] = self.likelihood.status(self.prior.soil_values(x[candidates]))
        return reasons

    def _physical(self, x: FloatArray) -> BoolArray:
        tested = np.ones(len(x), dtype=np.bool_)
        for experiment in self.experiments:
            tested &= experiment.physical(x)
        if not self.driven and self.experiments:
            return tested
        soil = self.prior.soil_values(x)
        inside = tested & (self.noise_values(x) > 0).all(axis=1)
        for _, theta in self.likelihood.forward.by_wheel(soil):
            inside &= self.likelihood.forward.model.admits(theta)
        return np.asarray(inside)


def checked_sets(x: FloatArray, names: Sequence[str]) -> FloatArray:
    """Parameter sets (n, d); ValueError where there is not one column per name."""
    x = np.atleast_2d(np.asarray(x, dtype=np.float64))
    if x.ndim != 2 or x.shape[1] != len(names):
        raise ValueError(f"'x' must have shape (n, {len(names)}) (got {x.shape})")
    return x


@dataclass(frozen=True)
class PriorDraws:
    """Draws from the prior cut to the physical support, and what the cut took."""

    x: FloatArray  # accepted parameter sets (n, d)
    shares: Mapping[str, float]  # share of the stated prior in each reason of ``REASONS`` (the support itself included)
    tried: int  # number of draws from the stated prior behind the shares


def draw_cut_prior(posterior: Density, n: int, rng: Generator, batch: int = 4096) -> PriorDraws:
    """Draw ``n`` parameter sets from the prior cut to the physical support.

    SupportError where fewer than one in 50 000 draws of the stated prior lies in the support.
    """
    kept: list[FloatArray] = []
    counts = dict.fromkeys(REASONS, 0)
    accepted = tried = 0
    while accepted < n:
        x = posterior.prior.sample(batch, rng)
        reasons = posterior.reasons(x)
        for code, count in zip(*np.unique(reasons, return_counts=True), strict=True):
            counts[int(code)] += int(count)
        kept.append(x[reasons == INSIDE])
        accepted, tried = accepted + len(kept[-1]), tried + batch
        if tried >= 50_000 and accepted < tried / 50_000:
            shares = _percentages({code: count for code, count in counts.items() if count}, tried)
            listed = ", ".join(f"{shares[code]}: {REASONS[code]}" for code in sorted(shares, key=lambda c: -counts[c]))
            rule = "no parameter set of the prior fits the conditions of the data"
            raise SupportError(f"{rule}: of {tried} draws {listed}")
    reached = {REASONS[code]: count / tried for code, count in counts.items() if count}
    return PriorDraws(np.concatenate(kept)[:n], reached, tried)


def _percentages(counts: Mapping[int, int], tried: int) -> dict[int, str]:
    """Shares of ``tried`` as text, to a tenth of a percent, such that they add up to 100 %."""
    exact = {code: 1000 * count / tried for code, count in counts.items()}
    tenths = {code: int(share) for code, share in exact.items()}
    left = 1000 - sum(tenths.values())
    for code in sorted(exact, key=lambda code: tenths[code] - exact[code])[:left]:
        tenths[code] += 1
    return {code: f"{share / 10:g} %" if share else "less than 0.1 %" for code, share in tenths.items()}


def posterior(study: Study) -> Posterior:
    """Build the posterior density of a study.

    Raises
    ------
    StudyError : no study is given.
    """
    check_kind("bt.posterior", study, Study)
    experiments = tuple(Experiment(test, study.prior) for test in study.soil_tests.values())
    return Posterior(study.prior, likelihood_of(study, study.observations.used()), experiments)


def likelihood_of(study: Study, rows: Observations) -> Likelihood:
    """The likelihood of a study for some or all of its rows."""
    forward = Forward.of(study.model, study.drive, rows, dict(study.wheels))
    if study.load_range is not None:  # where loads are taken for known, they are inside it
        known = np.where(np.isnan(forward.given), study.middle_load, forward.given)
        forward = forward.at_load(np.clip(known, *study.load_range))
    noise = tuple(study.noise.values())
    if study.errors:
        return CorrelatedLikelihood(forward, rows, noise, study.load_range, study.errors)
    if study.load_range is None:
        return Likelihood(forward, rows, noise)
    return LatentLoad(forward, rows, noise, study.load_range)
