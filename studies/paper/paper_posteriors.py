"""A posterior with what the comparisons need of it: draws, mode, evidence, leave-one-out by row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.random import SeedSequence, default_rng
from paper_data import SCALES
from scipy.stats import chi2

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.checking.loo import CrossValidation, cross_validate
from bayesterra.least_squares.results import locate
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.evidence import Evidence, evidence
from bayesterra.sampling.sampler import sample, thin
from bayesterra.sampling.summary import find_mode
from bayesterra.study.schema import SamplingOptions

OPTIONS = SamplingOptions(target_ess=2000, walkers=32, max_steps=8000)
PARTICLES = {"load": 512, "both": 512, "sinkage": 1024}
"""Size of the adaptation; posteriors that take a sinkage for exact are narrow and need the usual one."""


@dataclass(frozen=True)
class Found:
    """A sampled posterior.

    Attributes
    ----------
    density : what was sampled.
    draws : near-independent draws (n, d), SI and radians.
    levels : log density of every draw (n,).
    mode : the most probable parameter set (d,).
    evidence : log of prior times likelihood integrated.
    loo : every row left out once; None where not asked for.
    converged : whether every check of the sampling passed.
    """

    density: Posterior
    draws: FloatArray
    levels: FloatArray
    mode: FloatArray
    evidence: Evidence
    loo: CrossValidation | None
    converged: bool

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters."""
        return self.density.names

    def summary(self) -> pd.DataFrame:
        """Mode, median, sd and central 90 % of each parameter in field units."""
        scales = np.array([SCALES.get(name, 1.0) for name in self.names])
        low, middle, high = np.quantile(self.draws, (0.05, 0.5, 0.95), axis=0) / scales
        return pd.DataFrame(
            {
                "parameter": self.names, "mode": self.mode / scales, "median": middle,
                "sd": self.draws.std(axis=0, ddof=1) / scales, "low": low, "high": high,
                "converged": self.converged,
            }
        )  # fmt: skip

    def standing(self, method: str, values: Mapping[str, float]) -> dict[str, object]:
        """Where a point estimate (SI) stands: parameters inside their central 90 %, and all together."""
        x = np.array([values[name] for name in self.names])
        low, high = np.quantile(self.draws, (0.05, 0.95), axis=0)
        inside = [name for name, good in zip(self.names, (x >= low) & (x <= high), strict=True) if good]
        away = x - self.draws.mean(axis=0)
        squared = float(away @ np.linalg.solve(np.cov(self.draws.T), away))
        found = locate(self.density, self.draws, self.levels, {method: values})[method]
        return {
            "method": method,
            "inside": len(inside),
            "of": len(self.names),
            "outside": " ".join(name for name in self.names if name not in inside),
            "mahalanobis": np.sqrt(squared),
            "gaussian_level": float(chi2.cdf(squared, len(self.names))),
            "credible_level": found.credible_level,
            "reason": found.reason,
        }


def infer(study: bt.Study, seed: int = 1, *, loo: bool = True) -> Found:
    """Sample a study's posterior with 2000 effective draws or more; the same seed, the same draws."""
    density = posterior(study)
    sampling, weighing, leaving = SeedSequence(seed).spawn(3)
    adaptation = AdaptationOptions(particles=PARTICLES[study.drive])
    samples = sample(density, OPTIONS, sampling, adaptation=adaptation)
    kept = thin(samples.chains)
    laws = [one.proposal for one in samples.adaptations]
    return Found(
        density,
        kept.flat,
        density.log_density(kept.flat),
        find_mode(density, kept.spaced(4000)).x,
        evidence(samples.target.densities, laws, default_rng(weighing)),
        cross_validate(density, kept.flat, leaving, {})[0] if loo else None,
        samples.diagnosis.converged,
    )
