"""One posterior of a wheel and plates against quadrature, and of tests that share nothing against each alone."""

import numpy as np
import pytest
from numpy.random import SeedSequence, default_rng

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.sampling.evidence import ensembles_evidence
from bayesterra.sampling.sampler import sample
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study
from tests.support.adaptation import LITTLE
from tests.support.soil_tests import (
    KNOWN,
    PLATE_PRIORS,
    SHEAR_PRIORS,
    SOIL,
    both,
    plate_table,
    plates,
    shear,
    shear_table,
)

ENOUGH = SamplingOptions(target_ess=2000, walkers=32)


def sampled(study: Study) -> tuple[Posterior, FloatArray, float, float]:
    """Posterior, draws (n, d), and log evidence with its error."""
    whole = posterior(study)
    samples = sample(whole, ENOUGH, SeedSequence(3), adaptation=LITTLE)
    densities = samples.target.densities
    found = ensembles_evidence(densities, samples.adaptations, default_rng(4))
    return whole, samples.chains.reshape(-1, samples.chains.shape[-1]), found.log_z, found.error


@pytest.mark.slow
def test_three_parameters_agree_with_quadrature() -> None:
    """A modulus and the exponent that wheel and plates share, and φ: means, spreads and evidence."""
    own = {"test": "plate", "table": plate_table(), "tie": {"n": "n0"}, "noise": {**KNOWN, "scatter": 0.05}}
    priors = {"kc": SOIL["kc"], "kphi": bt.Law("uniform", lower=2e5, upper=2e6)}
    whole, draws, log_z, error = sampled(both(priors=priors, soil_tests={"plates": own}))
    assert whole.names == ("kphi", "n0", "phi")
    centre, factor = draws.mean(axis=0), np.linalg.cholesky(np.cov(draws.T))
    axis = np.linspace(-6.0, 6.0, 37)
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    x = centre + grid @ factor.T
    level = np.concatenate([whole.log_density(part) for part in np.array_split(x, 40)])
    weights = np.exp(level - level.max())
    cell = (axis[1] - axis[0]) ** 3 * np.prod(np.diagonal(factor))
    assert abs(np.log(weights.sum() * cell) + level.max() - log_z) < 4 * error + 0.01
    mean = weights @ x / weights.sum()
    sd = np.sqrt(weights @ (x - mean) ** 2 / weights.sum())
    np.testing.assert_allclose((draws.mean(axis=0) - mean) / sd, 0.0, atol=4 / np.sqrt(ENOUGH.target_ess))
    np.testing.assert_allclose(draws.std(axis=0) / sd, 1.0, atol=4 / np.sqrt(ENOUGH.target_ess))


def test_tests_that_share_nothing_do_not_hear_of_each_other() -> None:
    """Plates and a ring in one posterior: its density is the product of those of each alone, prior and all."""
    series = {
        "plate": {"test": "plate", "table": plate_table(), "noise": KNOWN},
        "shear": {"test": "shear", "table": shear_table(), "noise": {"memory": 2.0}},
    }
    whole = posterior(Study(priors={**PLATE_PRIORS, **SHEAR_PRIORS}, soil_tests=series))
    apart = [posterior(plates(noise=KNOWN)), posterior(shear(noise={"memory": 2.0}))]
    x = draw_cut_prior(whole, 200, default_rng(5)).x
    total = np.zeros(len(x))
    for alone in apart:
        total += alone.log_density(x[:, [whole.names.index(name) for name in alone.names]])
    assert sum(len(alone.names) for alone in apart) == len(whole.names)
    assert np.isfinite(total).mean() > 0.5
    np.testing.assert_allclose(whole.log_density(x), total, rtol=1e-10)
