"""Log evidence from pooled proposals: against closed forms, the prior, more draws and missed modes."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.random import SeedSequence, default_rng
from scipy.special import logsumexp, ndtr
from scipy.stats import beta, multivariate_normal, norm

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.posterior import PriorDraws, draw_cut_prior, posterior
from bayesterra.sampling.adaptation import AdaptationOptions, Densities, adapt
from bayesterra.sampling.evidence import Evidence, PosteriorProposal, evidence, of_evidence, redrawn
from bayesterra.sampling.sampler import sample
from bayesterra.stats.laws import Law
from bayesterra.stats.mixture import StudentMixture
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study
from tests.support.choice import some

MakeStudy = Callable[..., Study]


def ball(centre: FloatArray, sd: float) -> StudentMixture:
    """One Student-t law about a centre."""
    return StudentMixture(np.ones(1), centre[None], sd * np.eye(len(centre))[None], 4.0)


def normal(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Standard normal prior in five dimensions and a normal likelihood of sd 0.1 about 1."""
    prior = multivariate_normal(np.zeros(5), np.eye(5)).logpdf(u)
    return np.atleast_1d(prior), np.atleast_1d(multivariate_normal(np.ones(5), 0.01 * np.eye(5)).logpdf(u))


CENTRE = np.full(5, 1 / 1.01)
LOOSE = {"sinkage": 5e-3, "drawbar_pull": 8.0, "resistance_moment": 1.5, "normal_force": 10.0}
KNOWN = float(multivariate_normal(np.zeros(5), 1.01 * np.eye(5)).logpdf(np.ones(5)))


def test_evidence_of_a_normal_problem_and_its_error() -> None:
    """Over repetitions the estimates scatter about the closed form as the stated error says."""
    proposals = [ball(CENTRE + shift, 0.12) for shift in (-0.02, 0.02)]
    found = [evidence(normal, proposals, default_rng(k), draws=2000) for k in range(60)]
    z = np.array([(one.log_z - KNOWN) / one.error for one in found])
    assert abs(z.mean()) < 4 / np.sqrt(len(z))
    assert 0.75 < z.std() < 1.3
    assert all(one.reliable and one.efficiency > 0.3 for one in found)


def test_ten_times_the_draws_agree() -> None:
    """More draws give the same value with an error smaller by √10."""
    few, many = (evidence(normal, [ball(CENTRE, 0.12)], default_rng(1), draws=n) for n in (4000, 40_000))
    assert abs(few.log_z - many.log_z) < 4 * np.hypot(few.error, many.error)
    assert many.error == pytest.approx(few.error / np.sqrt(10), rel=0.2)


def test_a_mode_that_one_proposal_misses_is_counted_by_the_others() -> None:
    """Two modes, one proposal on each: neither alone finds the evidence, together they do."""
    left, right = np.full(2, -5.0), np.full(2, 5.0)

    def two(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        parts = [multivariate_normal(at, 0.25 * np.eye(2)).logpdf(u) for at in (left, right)]
        return np.zeros(len(u)), logsumexp([np.log(0.7) + parts[0], np.log(0.3) + parts[1]], axis=0)

    pooled = evidence(two, [ball(left, 0.5), ball(right, 0.5)], default_rng(2), draws=8000)
    assert abs(pooled.log_z) < 4 * pooled.error
    assert evidence(two, [ball(right, 0.5)], default_rng(2)).log_z == pytest.approx(np.log(0.3), abs=0.05)


def test_weights_that_cannot_be_relied_on_are_named() -> None:
    """A proposal much narrower than its target gives a heavy tail of weights, and the result says so."""
    narrow = StudentMixture(np.ones(1), CENTRE[None], 0.05 * np.eye(5)[None], 200.0)
    assert not evidence(normal, [narrow], default_rng(3)).reliable


def test_points_outside_the_support_weigh_nothing() -> None:
    """Half of the prior cut away halves the evidence."""

    def half(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        prior, likelihood = normal(u)
        return np.where(u[:, 0] > CENTRE[0], prior, -np.inf), likelihood

    found = evidence(half, [ball(CENTRE, 0.12)], default_rng(4))
    assert abs(found.log_z - KNOWN - np.log(0.5)) < 4 * found.error


LOW, WIDTH = np.array([-10.0, *[-50.0] * 9]), np.array([20.0, *[100.0] * 9])
FLAT = -float(np.log(WIDTH).sum())
"""Log density of the flat prior of the next two, and their log evidence but for what the prior cuts off."""
PLAN = AdaptationOptions(particles=512, components=12, refinements=(4, 4), more=(8,), climbs=0)
"""Steps uphill lead into the end of a funnel, where the weights are the greatest: without them these show nothing."""


def boxed(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points of a flat prior, and its log density in normal scores."""
    return LOW + WIDTH * ndtr(u), norm.logpdf(u).sum(axis=1)


def funnel(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Neal's funnel in ten dimensions: the spread of nine of them is the exponential of the first."""
    x, prior = boxed(u)
    spread = np.exp(0.5 * x[:, :1])
    return prior, norm.logpdf(x[:, 0], 0.0, 3.0) + norm.logpdf(x[:, 1:], 0.0, spread).sum(axis=1)


def plain(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ten independent normal laws."""
    x, prior = boxed(u)
    return prior, norm.logpdf(x, 0.0, np.array([1.0, *[5.0] * 9])).sum(axis=1)


def adapted(densities: Densities, seed: int, plan: AdaptationOptions = PLAN) -> tuple[Evidence, list[float]]:
    """Evidence from four adaptations, and what each of them found alone."""
    streams = SeedSequence(seed).spawn(5)
    starts = [default_rng(stream) for stream in streams]
    found = [adapt(densities, rng.standard_normal((512, 10)), plan, rng) for rng in starts[:4]]
    own = [one.log_evidence for one in found]
    return evidence(densities, [one.proposal for one in found], starts[4]).beside(own), own


@pytest.mark.slow
@pytest.mark.parametrize("seed", some([1, 2], 1))
def test_a_funnel_that_all_proposals_miss_a_part_of_is_not_called_reliable(seed: int) -> None:
    """The weights show nothing; what each ensemble found alone does, and the error covers the truth."""
    found, own = adapted(funnel, seed)
    assert found.k_hat < found.limit
    assert not found.reliable
    assert found.spread == pytest.approx(np.sqrt(np.mean((np.array(own) - found.log_z) ** 2)))
    assert abs(found.log_z - FLAT) < 3 * found.error


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_steps_uphill_make_no_funnel_reliable(seed: int) -> None:
    """The value is as far off as without them, by about one; whether the weights show it or not, it is said."""
    found, _ = adapted(funnel, seed, replace(PLAN, climbs=AdaptationOptions().climbs))
    assert not found.reliable
    assert abs(found.log_z - FLAT) < 2


@pytest.mark.slow
def test_ensembles_that_agree_leave_value_and_error_as_they_are() -> None:
    """Independent normal laws: still reliable, the closed form within errors of a hundredth."""
    found, _ = adapted(plain, 1)
    assert found.reliable
    assert found.error < 0.03
    assert abs(found.log_z - FLAT) < 4 * found.error


def test_own_values_move_no_evidence() -> None:
    """Beside its own values an evidence keeps its value; values that are not known change nothing."""
    found = evidence(normal, [ball(CENTRE, 0.12)], default_rng(1), draws=4000)
    assert found.beside([]) == found.beside([-np.inf]) == found
    apart = found.beside([found.log_z - 1.0, found.log_z + 1.0])
    assert (apart.log_z, apart.reliable) == (found.log_z, False)
    assert apart.spread == pytest.approx(1.0)
    assert apart.error == pytest.approx(np.hypot(found.error, np.sqrt(0.5)))


def from_the_prior(study: Study, n: int) -> tuple[float, float]:
    """Log evidence under the stated prior by plain averaging over prior draws, and its error."""
    density = posterior(study)
    drawn = draw_cut_prior(density, n, default_rng(8))
    level = density.log_terms(drawn.x).sum(axis=(1, 2))
    weights = np.exp(level - level.max())
    error = np.hypot(weights.std() / weights.mean() / np.sqrt(n), 1 / np.sqrt(drawn.tried))
    return float(level.max() + np.log(weights.mean() * drawn.shares["inside the support"])), float(error)


@pytest.mark.slow
@pytest.mark.parametrize("free", [("c", "phi", "K"), ("n0", "c", "phi", "K")], ids=len)
@pytest.mark.parametrize("drive", ["load", "sinkage"])
def test_evidence_of_small_studies_is_that_of_the_prior(
    free: tuple[str, ...], drive: str, make_study: MakeStudy
) -> None:
    """Three and four parameters through M2: plain averages over the prior agree within 4 errors."""
    study = make_study(free=free, drive=drive, noise=LOOSE)
    plan = AdaptationOptions(particles=512, components=8)
    samples = sample(posterior(study), SamplingOptions(walkers=32, target_ess=200), SeedSequence(3), adaptation=plan)
    target = samples.target
    found = evidence(target.densities, [one.proposal for one in samples.adaptations], default_rng(5))
    expected, error = from_the_prior(study, 50_000)
    assert isinstance(found, Evidence)
    assert error < 0.2
    assert abs(found.log_z - expected) < 4 * np.hypot(found.error, error)


@pytest.mark.slow
@pytest.mark.parametrize("shape", [0.02, 0.2])
def test_evidence_of_a_law_with_poles_is_that_of_quadrature(shape: float, make_study: MakeStudy) -> None:
    """A whole run: with 0.02 nearly all of the law stands at its two ends."""
    law = Law("beta", {"a": shape, "b": shape, "scale": 500.0})
    density = posterior(make_study(free=("c",), priors={"c": law}, noise=LOOSE))
    plan = AdaptationOptions(particles=256, components=4, shores=0)
    options = SamplingOptions(walkers=32, target_ess=200)
    samples = sample(density, options, SeedSequence(3), adaptation=plan)
    target = samples.target
    found = evidence(target.densities, [one.proposal for one in samples.adaptations], default_rng(5))
    shares = (np.arange(20_000) + 0.5) / 20_000  # the mean over the quantiles of the law is its integral
    x = 500.0 * beta.ppf(shares, shape, shape)
    expected = float(logsumexp(density.log_terms(x[:, None]).sum(axis=(1, 2))) - np.log(len(x)))
    assert found.reliable
    assert abs(found.log_z - expected) < max(4 * found.error, 1e-3)


def test_error_of_the_share_inside_the_support_is_that_of_counting() -> None:
    """A quarter of 4000 draws inside: the log of the share scatters as logs of binomial shares do."""
    prior = PriorDraws(np.zeros((1, 1)), {"inside the support": 0.25}, 4000)
    record = of_evidence(evidence(normal, [ball(CENTRE, 0.12)], default_rng(1), draws=2000), prior)
    counted = default_rng(2).binomial(4000, 0.25, size=20_000) / 4000
    assert record["log_share"] == pytest.approx(np.log(0.25))
    assert record["log_share_error"] == pytest.approx(np.log(counted).std(), rel=0.03)


@pytest.mark.parametrize(("factor", "refitted"), [(0.8, False), (0.2, False), (4.0, True)])
def test_draws_with_other_noise_are_those_of_its_own_posterior(
    make_study: MakeStudy, factor: float, refitted: bool
) -> None:
    """One parameter, by quadrature: weights do near by, a fit of its own far off."""
    study = make_study(free=("phi",))
    grid = np.linspace(0.2, 0.8, 4001)[:, None]

    def law(of: Study) -> FloatArray:
        density = posterior(of).log_density(grid)
        weights = np.exp(density - density.max())
        return np.asarray(np.cumsum(weights) / weights.sum())

    draws = np.interp(default_rng(1).random(4000), law(study), grid[:, 0])[:, None]
    near, other = PosteriorProposal.of(posterior(study), draws), study.with_noise(factor)
    found = redrawn(near, posterior(other), default_rng(2))
    assert (found.refitted, found.reliable) == (refitted, True)
    exact = np.interp([0.05, 0.5, 0.95], law(other), grid[:, 0])
    width = exact[2] - exact[0]
    assert (np.abs(np.quantile(found.x[:, 0], [0.05, 0.5, 0.95]) - exact) < 0.06 * width).all()
