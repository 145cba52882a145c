"""Expected information and expected standard deviations, beside closed forms and brute force."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from nested import Sizes, nested_gain

from bayesterra.arrays import FloatArray
from bayesterra.design.candidates import Reading, Situation, candidates, readings_of
from bayesterra.design.choosing import choose
from bayesterra.design.gain import Estimate, Interest, estimate, normal_estimate, pairs
from bayesterra.design.recommendation import situation_of
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.study.noise import Noise
from bayesterra.study.study import Study

Make = Callable[..., Study]
NOISE = {"sinkage": 0.002, "drawbar_pull": 3.0, "resistance_moment": 0.8}
SLOPES = np.array([[0.6, 0.3, 0.0, 0.2], [0.0, 0.5, 0.4, 0.0], [0.3, -0.2, 0.0, 0.5]])
COVARIANCE = np.array([[1.0, 0.6, 0.0, 0.2], [0.6, 1.5, 0.3, 0.0], [0.0, 0.3, 0.8, 0.1], [0.2, 0.0, 0.1, 1.0]])
ABOUT = (0, 1)


def linear(n: int, seed: int, rows: int = 1) -> tuple[Interest, tuple[Reading, ...]]:
    """Four normal parameters, three channels that are linear in them, unit noise."""
    x = np.random.default_rng(seed).multivariate_normal(np.zeros(4), COVARIANCE, n)
    noise = tuple(Noise(name, sd=1.0) for name in NOISE)
    one = Reading(x @ SLOPES.T, np.tile(np.eye(3), (n, 1, 1)), noise)
    return Interest(x, ABOUT), (one,) * rows


def closed_form(rows: int = 1) -> FloatArray:
    """Gain about the first two, about all, and the two standard deviations after a reading."""
    after = np.linalg.inv(np.linalg.inv(COVARIANCE) + rows * SLOPES.T @ SLOPES)
    first = np.ix_(ABOUT, ABOUT)
    about = np.linalg.slogdet(COVARIANCE[first])[1] - np.linalg.slogdet(after[first])[1]
    whole = np.linalg.slogdet(COVARIANCE)[1] - np.linalg.slogdet(after)[1]
    return np.array([about / 2, whole / 2, *np.sqrt(np.diagonal(after))[:2]])


def estimated(n: int, seed: int, rows: int = 1) -> tuple[Estimate, Estimate]:
    """Estimates by mixtures and by regression."""
    interest, readings = linear(n, seed, rows)
    found = pairs(readings, interest, np.random.default_rng(seed + 99))
    return estimate(found, interest), normal_estimate(found, interest)


@pytest.mark.parametrize("rows", [1, 3])
def test_linear_problems_have_their_closed_form(rows: int) -> None:
    """Both estimators find gains and standard deviations of a linear normal problem, one row or three."""
    for found in estimated(2000, 1, rows):
        assert np.all(np.abs(found.values - closed_form(rows)) < 3 * found.errors + 0.02)


def test_errors_are_those_of_repetitions() -> None:
    """Over fresh draws the estimates scatter by about their Monte Carlo errors."""
    found = [estimated(500, 10 * seed)[0] for seed in range(1, 13)]
    scatter = np.std([one.values for one in found], axis=0, ddof=1)
    stated = np.mean([one.errors for one in found], axis=0)
    assert np.all((scatter / stated > 0.4) & (scatter / stated < 1.6))


def test_few_draws_give_no_bias() -> None:
    """Where some 15 of 300 draws remain effective, the mean gain about all is still right."""
    slopes, found = 2.5 * SLOPES, []
    for seed in range(30):
        interest, (one,) = linear(300, seed)
        sharp = Reading(2.5 * one.mean, one.whitening, one.noise)
        found.append(estimate(pairs((sharp,), interest, np.random.default_rng(99 + seed)), interest).values[1])
    exact = 0.5 * np.linalg.slogdet(np.eye(3) + slopes @ COVARIANCE @ slopes.T)[1]
    assert np.mean(found) == pytest.approx(exact, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("about", [("phi",), ("phi", "K")])
def test_brute_force_agrees(two_free: Study, about: tuple[str, ...]) -> None:
    """Nested Monte Carlo through M2 finds the same gain, about one parameter and about all."""
    density = posterior(two_free)
    (candidate,) = candidates(two_free, slips=[0.5])
    brute, error = nested_gain(two_free, density, candidate, about, np.random.default_rng(1), Sizes(800, 300))
    situation = situation_of(two_free, seed=2)
    found = choose(situation, [candidate], about).ranking.estimates[0]
    assert brute > 0.3
    assert found.values[0] == pytest.approx(brute, abs=3 * np.hypot(error, found.errors[0]) + 0.02)


def test_draws_without_an_answer_have_no_part() -> None:
    """Draws whose prediction is missing change the share of answers and nothing else."""
    interest, (reading,) = linear(1000, 3)
    lost = Reading(np.where(np.arange(1000)[:, None] % 4 == 0, np.nan, reading.mean), reading.whitening, reading.noise)
    found = estimate(pairs((lost,), interest, np.random.default_rng(1)), interest)
    assert found.answered == 0.75
    assert np.all(np.abs(found.values - closed_form()) < 3 * found.errors + 0.02)


def test_too_few_answers_give_nothing() -> None:
    """With fewer than 50 answers there is no estimate."""
    interest, (reading,) = linear(500, 3)
    lost = Reading(np.where(np.arange(500)[:, None] > 40, np.nan, reading.mean), reading.whitening, reading.noise)
    assert np.isnan(estimate(pairs((lost,), interest, np.random.default_rng(1)), interest).values).all()


@pytest.mark.slow
def test_the_chosen_pair_is_the_best_pair(two_free: Study) -> None:
    """Two rows chosen one after the other and exchanged have the greatest joint gain of all pairs."""
    situation = situation_of(two_free, seed=4)
    grid = candidates(two_free, slips=[0.02, 0.2, 0.7])
    chosen = choose(situation, grid, ("phi", "K"), number=2, seed=1)
    interest = Interest(situation.draws, (0, 1))
    gains = {}
    for first in range(3):
        for second in range(first, 3):
            parts = [
                pairs(readings_of(situation, grid[index]), interest, np.random.default_rng((1, place)))
                for place, index in enumerate((first, second))
            ]
            gains[first, second] = estimate(parts[0] + parts[1], interest).values[0]
    first, second = sorted(chosen.picks)
    assert gains[first, second] > max(gains.values()) - 0.03


def test_a_drive_repeated_is_a_drive_with_less_noise(two_free: Study, unmeasured: Make) -> None:
    """Two readings of one drive, each with its own noise, tell what one does with noise less by √2."""
    grid = candidates(two_free, slips=[0.4])
    twice = choose(situation_of(two_free), grid, ("phi", "K"), number=2).together[1]
    finer = unmeasured(noise={name: sd / np.sqrt(2) for name, sd in NOISE.items()})
    once = choose(situation_of(finer), candidates(finer, slips=[0.4]), ("phi", "K")).together[0]
    assert twice.values[0] == pytest.approx(once.values[0], abs=3 * np.hypot(twice.errors[0], once.errors[0]))


def test_few_effective_draws_are_told(two_free: Study, unmeasured: Make) -> None:
    """With noise so small that hardly a draw remains, gains are lower bounds by regression and say so."""
    fine = unmeasured(noise={name: sd / 200 for name, sd in NOISE.items()})
    found = choose(situation_of(fine), candidates(fine, slips=[0.3, 0.5]), ("phi",))
    coarse = choose(situation_of(two_free), candidates(two_free, slips=[0.3, 0.5]), ("phi",))
    assert found.ranking.method == "regression"
    assert coarse.ranking.method == "mixture"
    assert 0.2 < found.ranking.estimates[0].values[0] < 0.54  # brute force: 0.54 at slip 0.3


def test_a_latent_load_tells_less_the_worse_it_is_known(unmeasured: Make) -> None:
    """With the drive both an exact normal force gives the gain of a given load, and a poor one less."""
    gains = []
    latent = {"drive": "both", "load_range": ["20 N", "200 N"]}
    both = [unmeasured(**latent, noise={**NOISE, "normal_force": sd}) for sd in (0.01, 20.0)]
    for study in (unmeasured(), *both):
        (candidate,) = candidates(study, slips=[0.5], loads=["80 N"])
        draws = draw_cut_prior(posterior(unmeasured()), 1500, np.random.default_rng(1)).x
        situation = Situation(study, posterior(study), draws, "prior")
        gains.append(choose(situation, [candidate], ("phi", "K")).ranking.estimates[0].values[0])
    assert gains[1] == pytest.approx(gains[0], abs=0.01)
    assert gains[2] < gains[0] - 0.05


def test_the_sinkage_drive_reads_at_the_sinkage_that_the_load_makes(unmeasured: Make) -> None:
    """With the drive sinkage the normal force is read, around the load that was commanded."""
    table = pd.DataFrame({"slip": [0.1, 0.3], "sinkage [mm]": [5.0, 8.0]})
    noise = {"normal_force": 5.0, "drawbar_pull": 3.0}
    study = unmeasured(data=table, drive="sinkage", noise=noise)
    (candidate,) = candidates(study, slips=[0.3], loads=["80 N"])
    (reading,) = readings_of(situation_of(study), candidate)
    assert tuple(one.channel for one in reading.noise) == ("normal_force", "drawbar_pull")
    assert np.median(reading.mean[:, 0]) == pytest.approx(80.0, rel=0.01)
