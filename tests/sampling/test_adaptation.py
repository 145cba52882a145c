"""From prior to proposal: the evidence, two modes, and what happens when one is missed."""

import numpy as np
import pytest
from numpy.random import SeedSequence, default_rng
from scipy.stats import multivariate_normal

from bayesterra.arrays import FloatArray
from bayesterra.sampling.adaptation import Adaptation, AdaptationOptions, Densities, _missed, _next_step, adapt
from bayesterra.sampling.ensemble import Ensemble
from bayesterra.stats.diagnostics import diagnose
from bayesterra.stats.transport import fit_proposal

OPTIONS = AdaptationOptions(particles=512, components=6)
MANY = AdaptationOptions(particles=256, components=12, shores=0)  # enough to fit the mixture to its own draws


def normal_problem(d: int, sd: float, centre: float = 1.0) -> tuple[Densities, float]:
    """Standard normal prior, normal likelihood about ``centre``; and the log evidence."""
    prior = multivariate_normal(np.zeros(d), np.eye(d))
    likelihood = multivariate_normal(np.full(d, centre), sd**2 * np.eye(d))
    evidence = multivariate_normal(np.zeros(d), (1 + sd**2) * np.eye(d)).logpdf(np.full(d, centre))
    return lambda u: (np.atleast_1d(prior.logpdf(u)), np.atleast_1d(likelihood.logpdf(u))), float(evidence)


PARTS = [(0.0, 5.0), (0.0, 0.5), (4.0, 0.5)]  # places on the first axis and standard deviations: prior, main part, tail


@pytest.mark.parametrize("seed", [2, 5])
def test_a_part_of_three_in_ten_thousand_is_not_thin(seed: int) -> None:
    """Walkers do not stand for hundreds of steps in a part of the posterior that only hotter points have seen."""
    wide, main, part = (multivariate_normal(np.eye(8)[0] * at, sd**2 * np.eye(8)) for at, sd in PARTS)

    def densities(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        prior, most, rest = (np.atleast_1d(law.logpdf(u)) for law in (wide, main, part))
        return prior, np.logaddexp(np.log(1 - 3e-4) + most, np.log(3e-4) + rest) - prior

    found = adapted(densities, wide.rvs(1024, default_rng(seed)), seed, AdaptationOptions())
    there = part.rvs(20_000, default_rng(0))
    assert np.mean(np.exp(sum(densities(there)) - found.proposal.log_density(there))) < 10


FAR = 20.0
WIDE = multivariate_normal(np.zeros(3), FAR**2 * np.eye(3))
PEAKS = [multivariate_normal([side * FAR, 0.0, 0.0], 0.25 * np.eye(3)) for side in (-1, 1)]


def two_modes(u: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A wide normal prior and two narrow likelihood peaks, 80 standard deviations apart, 3 to 1."""
    prior, left, right = (np.atleast_1d(law.logpdf(u)) for law in (WIDE, *PEAKS))
    return prior, np.logaddexp(np.log(0.75) + left, np.log(0.25) + right)


def wide_starts() -> list[FloatArray]:
    """Draws of the prior for each of four ensembles."""
    return [FAR * default_rng(k).standard_normal((512, 3)) for k in range(4)]


def adapted(densities: Densities, start: FloatArray, seed: int, options: AdaptationOptions = OPTIONS) -> Adaptation:
    """The adaptation of one ensemble."""
    return adapt(densities, start, options, default_rng(seed))


@pytest.mark.parametrize(("d", "sd"), [(1, 0.01), (2, 1.0), (4, 0.1), (6, 0.3)])
def test_evidence_of_normal_problems(d: int, sd: float) -> None:
    """The evidence is that of the closed form within 4 errors, and the points have its posterior's spread."""
    densities, expected = normal_problem(d, sd)
    found = [adapted(densities, default_rng(k).standard_normal((256, d)), k, MANY) for k in range(4)]
    draws = 256 * MANY.refinements[-1]
    errors = np.array([np.sqrt((1 / a.efficiency - 1) / draws) for a in found])
    deviations = np.array([a.log_evidence for a in found]) - expected
    assert np.abs(deviations / errors).max() < 4
    assert abs(deviations.mean()) < 4 * np.sqrt((errors**2).sum()) / 4
    assert found[0].efficiency > 0.5
    u = np.concatenate([a.u for a in found])
    sharp = 1 / (1 + 1 / sd**2)
    np.testing.assert_allclose(u.mean(axis=0), 1 / (1 + sd**2), atol=5 * np.sqrt(sharp / 250))
    np.testing.assert_allclose(u.var(axis=0), sharp, rtol=0.25)


@pytest.mark.parametrize("missed", [False, True])
def test_a_mode_is_missed_where_a_point_outweighs_the_fit_and_only_there(missed: bool) -> None:
    """A point e⁹ above what the proposal allows for says so, e⁷ does not, whatever constant all levels have."""
    rng = default_rng(1)
    u = rng.standard_normal((500, 2))
    proposal = fit_proposal(u, np.ones(500), np.ones(2), 2, 0.1, rng)
    level = proposal.log_density(u) + 123.0
    far = np.array([[6.0, 6.0]])
    points = [(u, level), (far, proposal.log_density(far) + 123.0 + (9.0 if missed else 7.0))]
    assert _missed(points, proposal) is missed
    assert not _missed(points[:1], proposal)


def test_what_a_missed_mode_costs_is_counted() -> None:
    """Steps uphill and the components added at what they meet are among the evaluations."""
    densities, calls = needle(4, 0.2), list[int]()

    def counted(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        calls.append(len(u))
        return densities(u)

    found = adapted(counted, default_rng(0).uniform(-10.0, 10.0, (1024, 4)), 0, AdaptationOptions(components=8))
    assert (found.proposal.sample(4000, default_rng(1))[:, 0] > 2.0).mean() > 0.2
    assert found.evaluations == sum(calls)


def test_temperatures_rise_to_one() -> None:
    """The way from prior to posterior is strictly upwards and ends at 1; evaluations are counted."""
    densities, _ = normal_problem(3, 0.05)
    calls: list[int] = []

    def counted(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        calls.append(len(u))
        return densities(u)

    found = adapted(counted, default_rng(1).standard_normal((512, 3)), 1)
    assert found.temperatures[0] == 0.0
    assert found.temperatures[-1] == 1.0
    assert (np.diff(found.temperatures) > 0).all()
    assert len(found.temperatures) > 3
    assert found.evaluations == sum(calls)


@pytest.mark.parametrize("height", [1.0, 1e4, 1e16])
def test_steps_keep_the_share_asked_for(height: float) -> None:
    """However high the likelihood towers, a step leaves half of the points effective."""
    log_likelihood = -height * np.linspace(0.0, 5.0, 1000)
    step = _next_step(log_likelihood, 1.0, 0.5)
    weights = np.exp(step * (log_likelihood - log_likelihood.max()))
    share = weights.sum() ** 2 / (weights**2).sum() / len(weights)
    assert share == pytest.approx(0.5, abs=1e-3) or (step == 1.0 and share >= 0.5)


def test_two_modes_are_both_found() -> None:
    """From prior draws both modes are found with their shares, and the evidence counts both."""
    found = adapted(two_modes, wide_starts()[1], 1)
    fresh = found.proposal.sample(4000, default_rng(2))
    assert np.mean(fresh[:, 0] < 0) == pytest.approx(0.75, abs=0.15)
    evidence = multivariate_normal(np.zeros(3), (FAR**2 + 0.25) * np.eye(3)).logpdf([FAR, 0.0, 0.0])
    assert found.log_evidence == pytest.approx(evidence, abs=0.1)


def needle(d: int, sd: float) -> Densities:
    """Flat within ten of the origin; a broad peak of weight 0.7 and sd 1, and one of weight 0.3 and ``sd`` apart."""

    def densities(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        logs = [
            np.log(share / size**d) - 0.5 * ((u - place) ** 2).sum(axis=1) / size**2
            for share, place, size in ((0.7, -4.0, 1.0), (0.3, 4.0, sd))
        ]
        return np.where((np.abs(u) < 10.0).all(axis=1), 0.0, -np.inf), np.logaddexp(*logs)

    return densities


@pytest.mark.parametrize(("d", "sd"), [(4, 0.2), pytest.param(6, 0.35, marks=pytest.mark.slow)])
def test_a_peak_too_narrow_for_tempering_is_climbed(d: int, sd: float) -> None:
    """Hardly a draw lies there, and without steps uphill the proposal misses it; with them its evidence counts it."""
    seen, evidence = dict[int, list[float]](), 0.5 * d * np.log(2.0 * np.pi)
    for climbs in (0, AdaptationOptions().climbs):
        shares, own = [], []
        for seed in range(3):
            rng, options = default_rng(seed), AdaptationOptions(components=8, refinements=(4, 4), climbs=climbs)
            found = adapt(needle(d, sd), rng.uniform(-10.0, 10.0, (1024, d)), options, rng)
            shares.append(float((found.proposal.sample(4000, rng)[:, 0] > 2.0).mean()))
            own.append(found.log_evidence)
        seen[climbs] = [float(np.median(shares)), float(np.median(own)) - evidence]
    assert seen[0] == pytest.approx([0.0, np.log(0.7)], abs=0.05)
    assert seen[AdaptationOptions().climbs] == pytest.approx([0.3, 0.0], abs=0.1)


def produce(densities: Densities, starts: list[FloatArray]) -> tuple[FloatArray, FloatArray]:
    """Chains and acceptance of ensembles that adapt alone, each from its own start."""
    ensembles = []
    for k, start in enumerate(starts):
        found = adapted(densities, start, k)
        walkers = Ensemble(lambda u: np.sum(densities(u), axis=0), found.u[:64], found.proposal, SeedSequence(k))
        walkers.advance(300)
        ensembles.append(walkers)
    return np.array([e.chain for e in ensembles]), np.array([e.acceptance for e in ensembles])


@pytest.mark.slow
@pytest.mark.parametrize("blind", [1, 2, 3])
def test_a_mode_that_some_ensembles_miss_is_no_confident_answer(blind: int) -> None:
    """Ensembles that start, and stay, in one mode only are found out by the others: not converged."""
    starts = wide_starts()
    for k in range(blind):
        starts[k] = np.array([-FAR, 0.0, 0.0]) + 0.3 * default_rng(k).standard_normal((512, 3))
    chains, accepted = produce(two_modes, starts)
    seen = (chains[..., 0] > 0).mean(axis=(1, 2))
    assert (seen[:blind] < 0.01).all()
    assert (seen[blind:] > 0.1).all()
    diagnosis = diagnose(("a", "b", "c"), chains, accepted, 1000)
    assert not diagnosis.converged
    assert "R-hat across ensembles" in [check.name for check in diagnosis.checks if not check.passed]


def test_all_ensembles_that_see_both_modes_agree() -> None:
    """The same target converges where every ensemble starts from the prior: the alarm is no false one."""
    chains, accepted = produce(two_modes, wide_starts())
    diagnosis = diagnose(("a", "b", "c"), chains, accepted, 1000)
    assert diagnosis.converged
    assert (chains[..., 0] < 0).mean() == pytest.approx(0.75, abs=0.02)


def test_hard_edges_are_kept() -> None:
    """Points outside the support are never taken, and the evidence is that of the part inside."""

    def half(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        densities, _ = normal_problem(2, 0.5, centre=0.0)
        prior, likelihood = densities(u)
        outside = u[:, 0] < 0
        return np.where(outside, -np.inf, prior), np.where(outside, -np.inf, likelihood)

    start = np.abs(default_rng(1).standard_normal((512, 2)))
    found = adapted(half, start, 1)
    _, whole = normal_problem(2, 0.5, centre=0.0)
    assert (found.u[:, 0] >= 0).all()
    assert found.log_evidence == pytest.approx(whole + np.log(0.5), abs=0.06)


def test_adaptation_depends_on_its_stream_only() -> None:
    """The same start and stream give the same points and mixture."""
    densities, _ = normal_problem(2, 0.3)
    start = default_rng(1).standard_normal((512, 2))
    first, again = (adapted(densities, start, 5) for _ in range(2))
    np.testing.assert_array_equal(first.u, again.u)
    np.testing.assert_array_equal(first.proposal.mixture.means, again.proposal.mixture.means)


def test_starts_without_a_likelihood_die_out() -> None:
    """Points that the likelihood excludes do not stop the journey and are gone at its end."""

    def half(u: FloatArray) -> tuple[FloatArray, FloatArray]:
        prior = np.atleast_1d(multivariate_normal(np.zeros(2), np.eye(2)).logpdf(u))
        return prior, np.where(u[:, 0] > -1.0, -0.5 * (u[:, 0] / 0.1) ** 2, -np.inf)

    found = adapted(half, default_rng(1).standard_normal((512, 2)), 1)
    assert (found.u[:, 0] > -1.0).all()
    expected = np.log(np.sqrt(2 * np.pi) * 0.1 / np.sqrt(1.01) / np.sqrt(2 * np.pi))
    assert found.log_evidence == pytest.approx(expected, abs=0.1)
