"""Sampling coordinates: the map, its inverse, its Jacobian, and that the posterior does not notice it."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.sampling import sampler
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.coordinates import Coordinates, Logarithm, NormalScore, coordinates
from bayesterra.stats.diagnostics import effective_size
from bayesterra.stats.laws import Law
from bayesterra.stats.quantile_law import QuantileLaw
from bayesterra.study.noise import Noise
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study
from tests.support.plain import plain_coordinates

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]

ALL = ("Ks", "n0", "n1", "c", "phi", "K", "c1", "c2")
ESTIMATED = {
    name: Noise(name, law=Law("halfnorm", {"scale": scale}, lower=0.1 * scale))
    for name, scale in (("sinkage", 1e-3), ("resistance_moment", 0.3))
}
OTHER_LAWS: Mapping[str, Law] = {
    "Ks": Law("lognorm", {"s": 1.0, "scale": 2e6}),
    "n0": Law("norm", {"loc": 1.0, "scale": 0.2}),
    "n1": Law("norm", {"loc": 1.0, "scale": 0.3}),
    "c": Law("gamma", {"a": 1.5, "scale": 500.0}),
    "phi": Law("norm", {"loc": 0.55, "scale": 0.08}, lower=0.3, upper=0.9),
    "K": Law("loguniform", lower=0.002, upper=0.05),
    "c1": Law("norm", {"loc": 0.4, "scale": 0.1}),
    "c2": Law("cauchy", {"scale": 0.1}),
}
MODULI: Mapping[str, Law] = {
    "kc": Law("uniform", lower=0.0, upper=50e3),
    "kphi": Law("uniform", lower=0.2e6, upper=5e6),
}
TABLE = QuantileLaw(
    lower=0.0, upper=1e7, scores=(-2.0, -1.0, 0.0, 1.0, 2.0), values=(0.5e6, 1.2e6, 2.0e6, 3.0e6, 5.5e6)
)
CASES: Mapping[str, Mapping[str, Any]] = {
    "all free": {},
    "sinkage drive": {"drive": "sinkage"},
    "Ks fixed": {"free": ALL[1:]},
    "n1 fixed": {"free": ("Ks", "n0", *ALL[3:])},
    "n1 fixed, no angles": {"free": ("Ks", "n0", "phi")},
    "constant exponent": {"free": ALL, "priors": {"n1": 0.0}, "model_options": {"constant_exponent": True}},
    "c fixed": {"free": tuple(n for n in ALL if n != "c")},
    "phi fixed": {"free": tuple(n for n in ALL if n != "phi")},
    "K fixed": {"free": tuple(n for n in ALL if n != "K")},
    "angles fixed": {"free": ALL[:6]},
    "c2 fixed": {"free": ALL[:7]},
    "only angles": {"free": ("c1", "c2")},
    "c3 free": {"priors": {"c3": Law("uniform", lower=-0.3, upper=0.2)}},
    "c3 fixed": {"priors": {"c3": -0.2}},
    "noise estimated": {"noise": ESTIMATED},
    "other laws": {"priors": OTHER_LAWS},
    "tables that correlate": {"priors": {"Ks": TABLE, "correlation": {"Ks, n0": 0.7, "c, phi": -0.6}}},
    "one slip": {"slips": (0.3,)},
    "nearly one slip": {"slips": (0.3, 0.3004)},
    "one parameter": {"free": ("phi",)},
    "moduli": {"free": ALL[1:], "priors": MODULI},
    "moduli without angles": {"free": ("n0", "n1"), "priors": MODULI},
    "kphi free": {"free": ALL[1:], "priors": {**MODULI, "kc": 15e3}},
    "tied angles": {"priors": {"c2": "c1"}},
    "c3 tied": {"free": ALL[:7], "priors": {"c3": "c2", "c2": 0.0}},
    "offset": {"priors": {"sinkage_offset": Law("norm", {"scale": 1e-3})}},
    "both": {"drive": "both", "priors": {"sinkage_offset": Law("norm", {"scale": 1e-3})}},
}

each_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


def settled(make_study: MakeStudy, case: Mapping[str, Any], n: int) -> tuple[Posterior, Coordinates, FloatArray]:
    """Posterior, coordinates and prior draws of a case."""
    density = posterior(make_study(**case))
    return density, coordinates(density), draw_cut_prior(density, n, np.random.default_rng(1)).x


@each_case
def test_the_map_is_inverted(case: Mapping[str, Any], make_study: MakeStudy) -> None:
    """Every draw of the cut prior has finite coordinates that lead back to it: nothing is cut away."""
    density, chosen, x = settled(make_study, case, 3000)
    u = chosen.from_physical(x)
    assert np.isfinite(u).all()
    again, log_jacobian = chosen.to_physical(u)
    size = np.maximum(np.abs(x), 1e-3 * x.std(axis=0))
    assert np.abs((again - x) / size).max() < 1e-9
    assert np.isfinite(log_jacobian).all()
    assert sorted(sum((columns for columns, _ in chosen.blocks), ())) == list(range(len(density.names)))


@each_case
def test_the_jacobian_is_that_of_differences(case: Mapping[str, Any], make_study: MakeStudy) -> None:
    """The log Jacobian agrees with fourth-order differences of the map to 1e-6."""
    _, chosen, x = settled(make_study, case, 60)
    u, d, h = chosen.from_physical(x), x.shape[1], 1e-3
    spread = x.std(axis=0)
    matrix = np.empty((len(x), d, d))
    for j in range(d):
        step = h * np.eye(d)[j]
        near, far = (chosen.to_physical(u + k * step)[0] - chosen.to_physical(u - k * step)[0] for k in (1, 2))
        matrix[:, :, j] = (8 * near - far) / (12 * h) / spread
    numerical = np.linalg.slogdet(matrix)[1] + np.log(spread).sum()
    np.testing.assert_allclose(chosen.to_physical(u)[1], numerical, atol=1e-6)


def test_prior_draws_integrate_to_one_in_coordinates(make_study: MakeStudy) -> None:
    """Volume is kept: a wide normal proposal in coordinates finds the share of the prior in the support."""
    density, chosen, x = settled(make_study, {"free": ("c", "phi", "c1", "c2")}, 4000)
    u, rng = chosen.from_physical(x), np.random.default_rng(2)
    mean, factor = u.mean(axis=0), 1.5 * np.linalg.cholesky(np.cov(u.T))
    z = rng.standard_normal((60_000, u.shape[1]))
    proposed, log_jacobian = chosen.to_physical(mean + z @ factor.T)
    log_normal = -0.5 * (z**2).sum(axis=1) - 0.5 * u.shape[1] * np.log(2 * np.pi)
    log_proposal = log_normal - np.linalg.slogdet(factor)[1]
    prior, _ = density.log_prior_and_likelihood(proposed)
    weights = np.exp(prior + log_jacobian - log_proposal)
    share = draw_cut_prior(density, 20_000, np.random.default_rng(3)).shares["inside the support"]
    assert weights.mean() == pytest.approx(share, abs=4 * weights.std() / np.sqrt(len(z)) + 0.01)


@pytest.mark.parametrize("far", [-20.0, -9.0, 9.0, 20.0])
def test_normal_scores_reach_both_far_tails(far: float) -> None:
    """Data that pull a parameter 20 standard deviations from its prior on either side can be followed."""
    score = NormalScore(Law("norm", {"loc": 0.5, "scale": 0.01}))
    x, log_jacobian = score.to_physical(np.array([[far]]))
    assert x[0, 0] == pytest.approx(0.5 + 0.01 * far, rel=1e-9)
    assert score.from_physical(x)[0, 0] == pytest.approx(far, rel=1e-9)
    assert log_jacobian[0] == pytest.approx(np.log(0.01), abs=1e-6)


def test_far_proposals_have_no_density_and_raise_nothing(make_study: MakeStudy) -> None:
    """Coordinates of any size map to parameters or to nothing, never to NaN densities."""
    density, chosen, _ = settled(make_study, {"noise": ESTIMATED, "priors": OTHER_LAWS}, 1)
    target = sampler.Target(density, chosen)
    rng = np.random.default_rng(1)
    u = rng.standard_normal((20_000, len(density.names))) * 10.0 ** rng.uniform(-1, 5, (20_000, 1))
    assert not np.isnan(target.log_density(u)).any()


def test_a_drive_without_any_force_has_coordinates(make_study: MakeStudy, make_table: MakeTable) -> None:
    """Driven by sinkage with only a pull and a moment, the stress is not known and a usual one stands in."""
    table = make_table().drop(columns="load [N]")
    _, chosen, x = settled(make_study, {"data": table, "drive": "sinkage"}, 100)
    np.testing.assert_allclose(chosen.to_physical(chosen.from_physical(x))[0], x, rtol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("free", [("n0", "c", "phi"), ("phi", "c1", "c2")], ids=str)
def test_the_posterior_is_the_same_without_them(
    free: tuple[str, ...], make_study: MakeStudy, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Sampled in coordinates and in the parameters themselves, means and spreads agree within 4 errors."""
    density = posterior(make_study(free=free))
    options = SamplingOptions(target_ess=4000, walkers=64, max_steps=2000)
    plan = AdaptationOptions(particles=512, components=6)
    moments = []
    for choice in (coordinates, lambda posterior: plain_coordinates(posterior.names)):
        monkeypatch.setattr(sampler, "coordinates", choice)
        samples = sampler.sample(density, options, np.random.SeedSequence(1), adaptation=plan)
        assert samples.diagnosis.converged
        moments.append([_moments(samples.chains[..., i]) for i in range(len(free))])
    ours, plain = np.array(moments)
    assert np.abs((ours[..., 0] - plain[..., 0]) / np.hypot(ours[..., 1], plain[..., 1])).max() < 4.0


def _moments(chains: FloatArray) -> list[tuple[float, float]]:
    """Mean and variance with their Monte Carlo errors."""
    squares = (chains - chains.mean()) ** 2
    return [(q.mean(), q.std() / np.sqrt(effective_size(q))) for q in (chains, squares)]


def test_a_law_with_a_pole_is_sampled_by_its_score(make_study: MakeStudy) -> None:
    """Numbers do not resolve φ near its upper end, so it leaves the block of c and K; no prior is lost."""
    width = float(np.radians(50.0))
    law = Law("beta", {"a": 0.05, "b": 0.05, "scale": width})
    density = posterior(make_study(free=("c", "phi", "K"), priors={"phi": law}))
    blocks = dict(coordinates(density).blocks)
    assert blocks[(1,)] == NormalScore(law)
    assert all(isinstance(block, NormalScore | Logarithm) for block in blocks.values())
    x = density.prior.sample(4000, np.random.default_rng(1))
    assert np.isfinite(density.prior.log_density(x)).all()
    assert np.mean(x[:, 1] > 0.999999 * width) == pytest.approx(law.survival(np.array(0.999999 * width)), abs=0.03)
