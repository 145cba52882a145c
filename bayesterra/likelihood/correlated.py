"""Rows that hang together: the model's own smooth error, ripple along a sweep, errors of the slip readings.

    y = f(θ, s) + δ(s) + ripple + noise,    slip read as s + ε

δ is a Gaussian process over slip, one curve per wheel and channel (Kennedy and O'Hagan 2001, J. R. Stat. Soc.
B 63, 425). Everything but θ is Gaussian and integrated out: the readings of a table are jointly normal around
f(θ, s), those with heavy-tailed noise by :mod:`bayesterra.likelihood.sites`. An error of slip counts to first
order, g ε with the slopes g = ∂f/∂s, so it ties the channels of a row; f is taken as straight and δ as level
over its size. A latent load (drive ``both``) counts to first order about the load that its row's readings say
(:mod:`bayesterra.likelihood.condition_errors`). Noise that is a fraction is one of f(θ, s) in the likelihood,
of all that is drawn in draws.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import ClassVar

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.likelihood.condition_errors import Loads, slip_slopes
from bayesterra.likelihood.covariance import Drawn, Layout, TableLaw, Whitening, stacks
from bayesterra.likelihood.forward import Forward, Outcomes
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.stats.tails import GAUSSIAN
from bayesterra.study.model_errors import ModelErrors, Ripple

HUGE = 1e100
"""Modelled values beyond this (in SI units) are as impossible as none."""
DOUBLES = 2e7
"""Numbers that the matrices of parameter sets worked on at once may take."""
NEAR = 2.0
"""Standard deviations of a slip from a transition slip within which errors of slip are no straight line."""
OFF = 0.2
"""Error of the first order from which it is named, as a share of the scatter of a reading by noise and slip.

Against integrals over the true slip, with all rows at transition slips, φ is then off by 0.2 of its sd.
"""
NODES = 15
TYPICAL = 200
"""Draws at which errors of slip are looked at."""


def _rows(numbers: IntArray) -> str:
    return f"row{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"


@dataclass(frozen=True)
class CorrelatedLikelihood(Likelihood):
    """Likelihood of a table whose rows hang together. Rows that are not in use are not conditioned on.

    But for their normal forces where loads are latent, which say how they were driven. ``errors`` are
    discrepancy and ripple of the measured channels, and errors of slip.
    """

    errors: ModelErrors = field(default_factory=ModelErrors)
    together: ClassVar[bool] = True
    rows_apart: ClassVar[bool] = False

    def status(self, soil: FloatArray) -> IntArray:
        """Status (n,) of soil arrays; with latent loads 0 where the lowest of the range has an answer."""
        return self._lowest(soil).status

    def _lowest(self, soil: FloatArray, *, every_row: bool = False) -> Outcomes:
        """Outcomes under the loads of the rows, or under the lowest load where these are latent."""
        at = self.forward if self.load_range is None else self.forward.at_load(self.load_range[0])
        return at(soil, every_row=every_row)

    def log_terms(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log density (n, m, 1) of every row's readings given those of all other rows; −inf without answer.

        Their sum is not the log likelihood.
        """
        return self.log_rows(soil, noise_values)[1][:, :, None]

    def log_likelihood(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Log likelihood (n,) of soil arrays (n, p)."""
        total = np.full(len(soil), -np.inf)
        for good, law in self._laws(soil, noise_values):
            total[good] = law.log_density(self.measured)
        return total

    def log_rows(self, soil: FloatArray, noise_values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Log likelihood (n,), and log density (n, m) of every row given all others."""
        total = np.full(len(soil), -np.inf)
        rows = np.full((len(soil), len(self.observations)), -np.inf)
        for good, law in self._laws(soil, noise_values):
            total[good], rows[good] = law.log_density(self.measured), law.row_terms(self.measured)
        return total, rows

    def doubts(self, soil: FloatArray, noise_values: FloatArray) -> str:
        """A sentence on the rows where errors of slip are poorly taken to first order; empty without any.

        ``soil`` and ``noise_values`` are typical parameter sets, of the prior or of the posterior.
        """
        if self.errors.slip is None:
            return ""
        numbers, doubts = np.array(self.observations.rows), []
        sd = float(np.median(self.sizes(len(soil), noise_values)[:, -1]))
        bends, off = self.forward.model.bends(self.forward.conditions), self.beyond_first_order(soil, noise_values, sd)
        # rows whose slip, as it was read, may lie on the other side of a transition slip
        near = (np.abs(self.forward.conditions.slip[:, None] - bends) < NEAR * sd).any(axis=1)
        ends = " and ".join(f"{slip:g}" for slip in np.unique(bends[~np.isnan(bends)]))
        if near.any():
            doubts.append(f"{_rows(numbers[near])} within {NEAR:g} sd of the transition slips {ends}")
        if (off > OFF).any():
            doubts.append(f"{_rows(numbers[off > OFF])}, off by more than {OFF:.0%} of the scatter of a reading")
        if not doubts:
            return ""
        where = "; ".join(doubts)
        return f"errors of slip (sd {sd:.3g}) are taken to first order, which is doubtful in {where}"

    @property
    def at_once(self) -> int:
        """Parameter sets whose matrices find room at once."""
        return max(1, int(DOUBLES / max(1, self.layout.doubles)))

    def joint_law(self, soil: FloatArray, noise_values: FloatArray) -> TableLaw:
        """Law of the whole table at soils with an answer in every row in use."""
        return self.law(soil, self.forward(soil), noise_values)

    def beyond_first_order(self, soil: FloatArray, noise_values: FloatArray, sd: float) -> FloatArray:
        """Error of the first order in errors of slip in mean and scatter of a row's readings, (m,).

        In standard deviations of a reading, at the channel where it is most; median over parameter sets.
        """
        outcomes = self.forward(soil, every_row=True)
        middle = self.predicted(outcomes)
        slopes = slip_slopes(self.forward, soil, self.channels, outcomes) * sd
        nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
        values = np.stack([self._at_slip(soil, node * sd) for node in nodes])
        share = np.where(np.isfinite(values), weights[:, None, None, None], 0.0)
        share /= np.maximum(share.sum(axis=0), 1e-300)
        mean = (share * np.nan_to_num(values)).sum(axis=0)
        spread = np.sqrt((share * (np.nan_to_num(values) - mean) ** 2).sum(axis=0))
        scatter = np.sqrt(self.scales(middle, noise_values) ** 2 + slopes**2)
        worst = np.maximum(np.abs(mean - middle), np.abs(spread - np.abs(slopes))) / scatter
        return np.asarray(np.median(np.where(self.known, np.nan_to_num(worst), 0.0).max(axis=2), axis=0))

    def _at_slip(self, soil: FloatArray, shift: float) -> FloatArray:
        """Modelled values (n, m, k) at slips that differ by ``shift``, as far as the model goes."""
        slip = np.clip(self.forward.conditions.slip + shift, 0.0, np.nextafter(1.0, 0.0))
        return self.predicted(self.forward.at_slip(slip)(soil, every_row=True))

    def scores(self, soil: FloatArray, noise_values: FloatArray) -> FloatArray:
        """Normal scores (n, m, k) of readings given all other rows; NaN where there is none."""
        scores = np.full((len(soil), *self.measured.shape), np.nan)
        for good, law in self._laws(soil, noise_values):
            scores[good] = law.scores(self.measured)
        return scores

    def explained(self, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> Outcomes:
        """Outcomes behind the readings: discrepancy, ripple, true slips and loads drawn given these."""
        if self.load_range is None:
            return self._drawn(soil, noise_values, rng, conditioned=True)
        loads = np.full((len(soil), len(self.observations)), np.nan)
        errors = np.full((*loads.shape, len(self.channels)), np.nan)
        for good, law in self._laws(soil, noise_values):
            loads[good], errors[good] = law.draw_loads(self.measured, rng)
        outcomes = self.forward.at_load(np.clip(loads, *self.load_range))(soil, every_row=True)
        for i, name in enumerate(self.channels):
            outcomes.add(name, errors[:, :, i])
        return outcomes

    def imagined(self, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> Outcomes:
        """Outcomes before any reading: latent loads, discrepancy, ripple and slip errors drawn as stated."""
        if self.load_range is not None:
            loads = rng.uniform(*self.load_range, size=(len(soil), len(self.observations)))
            known = replace(self, forward=self.forward.at_load(loads), load_range=None)
            return known.imagined(soil, noise_values, rng)
        return self._drawn(soil, noise_values, rng, conditioned=False)

    def ahead(
        self, soil: FloatArray, noise_values: FloatArray, targets: BoolArray, rng: Generator
    ) -> tuple[FloatArray, FloatArray]:
        """Places and standard deviations (n, t, k) of readings of rows ``targets`` (m,)."""
        centre, covariance, noise = self.jointly_ahead(soil, noise_values, targets)
        variance, heavy = np.einsum("ntkk->ntk", covariance), self.layout.heavy
        if not heavy.any():
            return centre, np.sqrt(variance)
        behind = np.sqrt(np.maximum(variance - noise**2, 0.0))  # a sum with no one law: a part is drawn
        centre = centre + np.where(heavy, behind * rng.standard_normal(noise.shape), 0.0)
        return centre, np.where(heavy, noise, np.sqrt(variance))

    def jointly_ahead(
        self, soil: FloatArray, noise_values: FloatArray, targets: BoolArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Means, covariances (n, t, k, k) and noise (n, t, k) of readings of rows ``targets`` (m,)."""
        places, k = np.flatnonzero(targets), len(self.channels)
        centre, noise = np.full((2, len(soil), len(places), k), np.nan)
        covariance = np.full((*centre.shape, k), np.nan)
        for good, law in self._laws(soil, noise_values):
            centre[good], covariance[good] = law.ahead(self.measured, places)
            noise[good] = law.scale[:, places]
        return centre, covariance, noise

    def beyond(
        self, soil: FloatArray, noise_values: FloatArray, wheel: str | None, slip: FloatArray, rng: Generator
    ) -> FloatArray:
        """Draw the discrepancy (n, g, k) of a wheel at other slips, given the readings.

        For a wheel that was not driven (None) it is as before any reading. NaN where a row has no answer.
        """
        discrepancies = np.full((len(soil), len(slip), len(self.channels)), np.nan)
        for good, law in self._laws(soil, noise_values):
            discrepancies[good] = law.draw(self.measured, rng, wheel, slip).elsewhere
        return discrepancies

    def fresh(self, forward: Forward, soil: FloatArray, noise_values: FloatArray, rng: Generator) -> FloatArray:
        """Draw ripple and effect of slip errors (n, g, k) of readings of another sweep, each by itself.

        A channel that is no outcome of ``forward``, as its other drive is given it, has no effect of slip.
        """
        sizes, g = self.sizes(len(soil), noise_values), len(forward.conditions.slip)
        effects = np.zeros((len(soil), g, len(self.channels)))
        for which, error in enumerate(self.errors):
            draw = sizes[:, [which]] * rng.standard_normal((len(soil), g))
            if isinstance(error, Ripple):
                effects[:, :, self.channels.index(error.channel)] += draw
            elif error is self.errors.slip:
                columns = [i for i, name in enumerate(self.channels) if name in forward.outcomes]
                slopes = slip_slopes(forward, soil, [self.channels[i] for i in columns])
                effects[:, :, columns] += slopes * draw[:, :, None]
        return effects

    def law_where(
        self, read: BoolArray, soil: FloatArray, mean: FloatArray, noise: FloatArray, load: FloatArray | None
    ) -> TableLaw:
        """Law of readings where ``read`` (m, k) holds, made or yet to be made."""
        readings = np.where(read, np.nan_to_num(self.measured), np.nan)
        columns = dict(zip(self.channels, readings.T, strict=True))
        rows = replace(self.observations, values={**self.observations.values, **columns})
        reading = replace(self, observations=replace(rows, use=np.ones(len(rows), dtype=np.bool_)))
        return reading.law_at(soil, mean, noise, by_load=load)

    def law(self, soil: FloatArray, outcomes: Outcomes, noise_values: FloatArray) -> TableLaw:
        """The joint law of the readings at soils that have an answer in every row in use.

        Those of latent loads are about the loads that readings tell, ``outcomes`` not looked at.
        """
        if self.load_range is None:
            return self.law_at(soil, self.predicted(outcomes), noise_values, outcomes)
        numbers = self.known & (self.intervals is None or self.intervals.sides(self.measured) == 0)
        readings = np.where(numbers, self.measured, np.nan)
        sizes, none = self.sizes(len(soil), noise_values), np.zeros((len(soil), *self.measured.shape, 0))
        fields = self.layout.variance(sizes, none)

        def scatter(values: FloatArray) -> FloatArray:
            scale = self.scales(values, noise_values)
            return np.sqrt(scale**2 * self.layout.spread((readings - values) / scale) + fields)

        loads = Loads.told(self.forward, soil, self.channels, readings, self.load_range, scatter)
        about = replace(self, forward=self.forward.at_load(loads.at))
        return about.law_at(soil, loads.values, noise_values, loads.outcomes, loads.effects, loads)

    def law_at(
        self,
        soil: FloatArray,
        mean: FloatArray,
        noise_values: FloatArray,
        outcomes: Outcomes | None = None,
        by_load: FloatArray | None = None,
        loads: Loads | None = None,
    ) -> TableLaw:
        """The same, where what the model says of the measured channels (n, m, k) is known.

        ``by_load`` (n, m, k) is the effect of one standard deviation of latent loads, or of ``loads``.
        """
        scale, sizes = self.scales(mean, noise_values), self.sizes(len(soil), noise_values)
        effects: list[FloatArray] = []
        if self.errors.slip is not None:
            slopes = slip_slopes(self.forward, soil, self.channels, outcomes)
            effects.append(slopes * sizes[:, -1, None, None])
        if by_load is not None:
            effects.append(by_load)
        effect = np.stack(effects, axis=3) if effects else np.empty((*mean.shape, 0))
        whitenings = self._constant
        if whitenings is None:
            whitenings = tuple(stack.whitening(scale, sizes, effect) for stack in self.layout.stacks)
        mean = mean if loads is None else loads.predicted
        law = TableLaw(self.layout, mean, scale, sizes, effect, whitenings, loads)
        return self.reading(law, self.measured)

    def sizes(self, n: int, noise_values: FloatArray) -> FloatArray:
        """Standard deviations (n, j) of discrepancies, ripples and slip errors, given or estimated."""
        columns = iter(noise_values.T[sum(noise.parameter is not None for noise in self.noise) :])
        sizes = [np.full(n, error.size.sd) if error.parameter is None else next(columns) for error in self.errors]
        return np.column_stack([np.empty((n, 0)), *sizes])

    @cached_property
    def known(self) -> BoolArray:
        """Readings that are conditioned on (m, k)."""
        kept = [self.load_range is not None and name == "normal_force" for name in self.channels]
        return np.asarray(~np.isnan(self.measured) & (self.observations.use[:, None] | kept))

    @cached_property
    def layout(self) -> Layout:
        """Layout of the readings that hang together."""
        rows = self.observations
        tied = self.errors.slip is not None or self.load_range is not None
        blocks = stacks(self.errors, rows, self.channels, self.known, self._given_noise, tied=tied)
        return Layout(self.errors, rows, self.channels, tuple(entry.tails for entry in self.noise), blocks)

    @cached_property
    def _given_noise(self) -> FloatArray | None:
        """Noise (m, k) where it does not depend on the parameters; else None."""
        if any(noise.sd is None or noise.tails != GAUSSIAN for noise in self.noise) or self.intervals is not None:
            return None
        return np.asarray(self.scales(np.zeros((1, *self.measured.shape)), np.empty((1, 0)))[0])

    @cached_property
    def _constant(self) -> tuple[Whitening, ...] | None:
        """Whitenings where the covariance does not depend on the parameters; else None."""
        ties = self.errors.slip is not None or self.load_range is not None
        if self.errors.laws or ties or self._given_noise is None:
            return None
        scale, sizes = self._given_noise[None], self.sizes(1, np.empty((1, 0)))
        effects = np.empty((1, *self.measured.shape, 0))
        return tuple(stack.whitening(scale, sizes, effects) for stack in self.layout.stacks)

    def _laws(
        self, soil: FloatArray, noise_values: FloatArray, outcomes: Outcomes | None = None
    ) -> Iterator[tuple[IntArray, TableLaw]]:
        """Indices of soils with an answer in every row in use, a part of them at a time, and their law."""
        at_once = self.at_once
        for first in range(0, len(soil), at_once):
            part = slice(first, first + at_once)
            if outcomes is None:
                answers = self._lowest(soil[part], every_row=not self.observations.use.all())
            else:
                answers = outcomes.take(part)
            counted = answers.values[:, self.known.any(axis=1) | self.observations.use]
            good = np.flatnonzero((np.abs(counted) < HUGE).all(axis=(1, 2)))
            if good.size:
                own, given = self, self.forward.given
                if given.ndim > 1:  # every parameter set has loads of its own
                    own = replace(self, forward=replace(self.forward, given=given[first + good]))
                yield first + good, own.law(soil[part][good], answers.take(good), noise_values[part][good])

    def _drawn(self, soil: FloatArray, noise_values: FloatArray, rng: Generator, *, conditioned: bool) -> Outcomes:
        outcomes = self.forward(soil, every_row=True)
        for good, law in self._laws(soil, noise_values, outcomes):
            drawn: Drawn = law.draw(self.measured if conditioned else None, rng)
            for i, name in enumerate(self.channels):
                outcomes[name][good] += drawn.at_rows[:, :, i]
        return outcomes
