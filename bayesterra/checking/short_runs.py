"""Short runs: samplings of a posterior that are repeated many times, for calibrations and refits."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeAlias

import numpy as np
from numpy.random import SeedSequence

from bayesterra.arrays import FloatArray
from bayesterra.checking.ranks import CONVERGED, DRAWS, UNCONVERGED
from bayesterra.errors import BayesterraError
from bayesterra.likelihood.joint import joint_posterior
from bayesterra.likelihood.posterior import posterior
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.joint import JointSamples, PoolingOptions, sample_joint
from bayesterra.sampling.sampler import Samples, sample, thin
from bayesterra.stats.diagnostics import R_HAT_LIMIT, Diagnosis
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study

STEPS_PER_TAU = 7.0
"""Autocorrelation times that a short run must last."""
LONG_RUNS_ONLY = ("steps for", "slowest walker")
"""Beginnings of the checks that are not asked of short runs: their thresholds are made for 50 times τ."""


@dataclass(frozen=True)
class Fitted:
    """A sampled posterior."""

    draws: FloatArray  # near-independent draws (n, d), in the order of the posterior's names
    ess: float  # smallest effective sample size behind them
    r_hat: float  # largest R-hat across ensembles
    converged: bool  # whether the draws can be relied on

    @property
    def status(self) -> str:
        """Word on whether the draws can be relied on."""
        return CONVERGED if self.converged else UNCONVERGED


Fit: TypeAlias = Callable[[Study, SeedSequence], Fitted]
"""Samples the posterior of a study. It must be picklable where there are several workers."""
FAILURES = (BayesterraError, ArithmeticError, ValueError, np.linalg.LinAlgError)
"""Errors of a fit that cost its own outcome and no other."""


@dataclass(frozen=True)
class ShortRuns:
    """The default sampler with small settings, and once more with larger ones where these were not enough.

    Attributes
    ----------
    short, adaptation : of the first run, which ends once it is :func:`enough`, or after ``short.max_steps`` steps;
        with groups after these.
    long, long_adaptation : of the second, which ends by the rules of every run.
    ensembles : of the first run; with groups four at least. Two suffice for ranks: what both miss, the ranks of
        many replications show.
    """

    short: SamplingOptions = SamplingOptions(target_ess=4 * (DRAWS + 1), walkers=64, max_steps=400)
    adaptation: AdaptationOptions = AdaptationOptions(particles=256, components=8, shores=16)
    long: SamplingOptions = SamplingOptions(target_ess=4 * (DRAWS + 1), walkers=64, max_steps=8000)
    long_adaptation: AdaptationOptions = AdaptationOptions()
    ensembles: int = 2

    def __call__(self, study: Study, seed: SeedSequence) -> Fitted:
        """Sample the posterior of a study."""
        first, second = seed.spawn(2)
        samples = self.sampled(study, self.short, first, self.adaptation)
        if enough(samples.diagnosis):
            return _fitted(samples, converged=True)
        samples = self.sampled(study, self.long, second, self.long_adaptation)
        return _fitted(samples, converged=samples.diagnosis.converged)

    def sampled(
        self, study: Study, options: SamplingOptions, seed: SeedSequence, plan: AdaptationOptions
    ) -> Samples | JointSamples:
        """Samples of the posterior of a study."""
        target = posterior(study)
        if options is not self.short:
            return sample(target, options, seed, adaptation=plan)
        return sample(target, options, seed, adaptation=plan, enough=enough, ensembles=self.ensembles)


@dataclass(frozen=True)
class ShortGroupRuns(ShortRuns):
    """The same for a study with groups: its joint posterior, whose groups begin alone."""

    short: SamplingOptions = SamplingOptions(target_ess=4 * (DRAWS + 1), walkers=32, max_steps=80)
    adaptation: AdaptationOptions = AdaptationOptions(
        particles=256, components=6, refinements=(4, 4), more=(), shores=4
    )
    ensembles: int = 4
    warm_ups: tuple[int, ...] = (15, 30, 60)  # sweeps of the short run's warm-ups

    def sampled(
        self, study: Study, options: SamplingOptions, seed: SeedSequence, plan: AdaptationOptions
    ) -> Samples | JointSamples:
        """Samples of the joint posterior of a study with groups, of which one may be left."""
        small = PoolingOptions(self.warm_ups, plan) if options is self.short else PoolingOptions(lone=plan)
        options = replace(options, ensembles=self.ensembles) if options is self.short else options
        return sample_joint(joint_posterior(study, fewest=1), options, seed, plan=small)


def short_runs(study: Study) -> ShortRuns:
    """The default sampler of a study, with or without groups."""
    return ShortRuns() if study.pooling is None else ShortGroupRuns()


def settings_of(fit: Fit) -> dict[str, Any]:
    """Settings of a fit as they are saved: all of the default sampler, the name of any other."""
    if isinstance(fit, ShortRuns):
        return {**asdict(fit), "steps_per_tau": STEPS_PER_TAU, "r_hat_limit": R_HAT_LIMIT}
    return {"fit": getattr(fit, "__qualname__", type(fit).__name__)}


def enough(diagnosis: Diagnosis) -> bool:
    """True where a short run suffices: effective draws, R-hat, no frozen walker, and a length of some τ."""
    asked = [check for check in diagnosis.checks if not check.name.startswith(LONG_RUNS_ONLY)]
    lasting = diagnosis.steps >= STEPS_PER_TAU * float(diagnosis.tau.max())
    return lasting and all(check.passed for check in asked)


def _fitted(samples: Samples | JointSamples, *, converged: bool) -> Fitted:
    diagnosis = samples.diagnosis
    return Fitted(thin(samples.chains).flat, diagnosis.ess, diagnosis.worst_r_hat, converged)
