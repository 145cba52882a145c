"""Posteriors of simulated tables: the default sampler, stopped when there are enough draws to rank among."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any, TypeAlias

from numpy.random import SeedSequence

from bayesterra.arrays import FloatArray
from bayesterra.calibration.ranks import DRAWS
from bayesterra.diagnostics import R_HAT_LIMIT, Diagnosis
from bayesterra.inference import keep
from bayesterra.posteriors import posterior
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.sampler import Samples, sample
from bayesterra.study import SamplingOptions, Study

STEPS_PER_TAU = 7.0
"""Autocorrelation times that a short run must last."""
LONG_RUNS_ONLY = ("steps for", "slowest walker")
"""Beginnings of the checks that are not asked of short runs: their thresholds are made for 50 times τ."""


@dataclass(frozen=True)
class Fitted:
    """A sampled posterior.

    Attributes
    ----------
    draws : near-independent draws (n, d), in the order of the posterior's names.
    ess : smallest effective sample size behind them.
    r_hat : largest R-hat across ensembles.
    converged : whether the draws can be relied on.
    """

    draws: FloatArray
    ess: float
    r_hat: float
    converged: bool


Fit: TypeAlias = Callable[[Study, SeedSequence], Fitted]
"""Samples the posterior of a study. It must be picklable where there are several workers."""


@dataclass(frozen=True)
class ShortRuns:
    """The default sampler with small settings, and once more with larger ones where these were not enough.

    Attributes
    ----------
    short, adaptation : of the first run, which takes ``short.max_steps`` steps.
    long, long_adaptation : of the second, which ends by the rules of every run.
    """

    short: SamplingOptions = field(
        default_factory=lambda: SamplingOptions(target_ess=4 * (DRAWS + 1), walkers=64, max_steps=200)
    )
    adaptation: AdaptationOptions = field(
        default_factory=lambda: AdaptationOptions(particles=256, components=8)
    )
    long: SamplingOptions = field(
        default_factory=lambda: SamplingOptions(target_ess=4 * (DRAWS + 1), walkers=64, max_steps=8000)
    )
    long_adaptation: AdaptationOptions = field(default_factory=AdaptationOptions)

    def __call__(self, study: Study, seed: SeedSequence) -> Fitted:
        """Sample the posterior of a study."""
        first, second = seed.spawn(2)
        target = posterior(study)
        samples = sample(target, self.short, first, adaptation=self.adaptation)
        if enough(samples.diagnosis):
            return _fitted(samples, converged=True)
        samples = sample(target, self.long, second, adaptation=self.long_adaptation)
        return _fitted(samples, converged=samples.diagnosis.converged)

    def record(self) -> dict[str, Any]:
        """All settings, as they are saved."""
        return {**asdict(self), "steps_per_tau": STEPS_PER_TAU, "r_hat_limit": R_HAT_LIMIT}


def enough(diagnosis: Diagnosis) -> bool:
    """Whether a short run suffices: effective draws, R-hat, no frozen walker, and a length of some τ."""
    asked = [check for check in diagnosis.checks if not check.name.startswith(LONG_RUNS_ONLY)]
    lasting = diagnosis.steps >= STEPS_PER_TAU * float(diagnosis.tau.max())
    return lasting and all(check.passed for check in asked)


def _fitted(samples: Samples, *, converged: bool) -> Fitted:
    diagnosis = samples.diagnosis
    return Fitted(keep(samples.chains).flat, diagnosis.ess, diagnosis.worst_r_hat, converged)
