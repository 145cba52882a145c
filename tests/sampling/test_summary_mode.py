"""The posterior mode against every draw, against least squares, and at a bound."""

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd
import pytest

from bayesterra.least_squares.fit import fit
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.likelihood.target import edges
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.sampler import sample
from bayesterra.sampling.summary import find_mode
from bayesterra.stats.laws import Law
from bayesterra.study.noise import Noise
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]
FREE = ("n0", "c", "phi", "K")


@pytest.fixture(scope="module")
def noisy(make_table: MakeTable) -> pd.DataFrame:
    """Readings with noise, so that the mode is not the truth."""
    table, rng = make_table("M2"), np.random.default_rng(4)
    table["sinkage [m]"] += 5e-4 * rng.standard_normal(6)
    table["drawbar_pull [N]"] += 1.0 * rng.standard_normal(6)
    table["resistance_moment [N m]"] += 0.1 * rng.standard_normal(6)
    return table


def drawn(study: Study) -> np.ndarray[tuple[int, int], np.dtype[np.float64]]:
    """Posterior draws of a quick run."""
    options = SamplingOptions(target_ess=500, walkers=32, max_steps=200)
    plan = AdaptationOptions(particles=256, components=4, refinements=(2, 4), more=(), shores=4, climbs=10)
    chains = sample(posterior(study), options, np.random.SeedSequence(1), adaptation=plan).chains
    return chains.reshape(-1, chains.shape[-1])


@pytest.mark.parametrize("drive", ["load", "sinkage"])
def test_mode_is_denser_than_every_draw_and_is_the_joint_fit(
    drive: str, make_study: MakeStudy, noisy: pd.DataFrame
) -> None:
    """Under a flat prior and given noise no draw is denser than the mode, which weighted least squares is."""
    study = make_study(data=noisy, free=FREE, drive=drive)
    density, draws = posterior(study), drawn(study)
    mode = find_mode(density, draws)
    assert mode.log_density == pytest.approx(density.log_density(mode.x)[0])
    assert mode.log_density >= density.log_density(draws).max()
    assert mode.agreeing > mode.starts / 2
    values = fit(study, ("joint",))["joint"].values()
    joint = np.array([values[name] for name in density.names])
    assert mode.log_density == pytest.approx(density.log_density(joint)[0], abs=1e-3)
    assert (np.abs(mode.x - joint) < 0.02 * draws.std(axis=0)).all()


def test_a_prior_pulls_the_mode(make_study: MakeStudy, noisy: pd.DataFrame, truth: Mapping[str, float]) -> None:
    """A sharp prior away from the data draws the mode to itself: density, not likelihood, is maximised."""
    far = truth["phi"] + 0.1
    sharp = Law("norm", {"loc": far, "scale": 1e-4})
    study = make_study(data=noisy, free=("n0", "phi"), priors={"phi": sharp})
    density = posterior(study)
    draws = draw_cut_prior(density, 2000, np.random.default_rng(1)).x
    mode = find_mode(density, draws)
    assert mode.x[1] == pytest.approx(far, abs=1e-3)
    assert mode.log_density >= density.log_density(draws).max()


def test_the_mode_may_stand_far_out_in_the_tail_of_a_prior(
    make_study: MakeStudy, noisy: pd.DataFrame, truth: Mapping[str, float]
) -> None:
    """Data that contradict a prior by ten standard deviations are climbed as any others."""
    far = Law("norm", {"loc": truth["phi"] + 0.3, "scale": 0.03})
    density = posterior(make_study(data=noisy, free=("n0", "phi"), priors={"phi": far}))
    centre = np.array([truth["n0"], truth["phi"]])
    draws = centre + np.random.default_rng(1).normal(size=(500, 2)) * 0.01
    mode = find_mode(density, draws)
    assert mode.log_density > density.log_density(draws).max()
    assert mode.agreeing == mode.starts
    assert (far.cdf(mode.x[1:]) < 1e-8).all()


def test_the_mode_may_stand_at_a_bound(make_study: MakeStudy, noisy: pd.DataFrame) -> None:
    """Where the data push a parameter out of its range, the mode stands on the very edge."""
    phi = Law("uniform", lower=0.55, upper=0.9)  # the truth is 0.511
    study = make_study(data=noisy, free=("n0", "phi"), priors={"phi": phi})
    density = posterior(study)
    mode = find_mode(density, draw_cut_prior(density, 2000, np.random.default_rng(1)).x)
    assert mode.x[1] == pytest.approx(0.55, abs=1e-6)
    assert np.isfinite(mode.log_density)


def test_estimated_noise_stands_at_its_median(make_study: MakeStudy, noisy: pd.DataFrame) -> None:
    """Noise is not optimised along: it keeps the median of its draws."""
    noise = {"drawbar_pull": Noise("drawbar_pull", law=Law("halfnorm", {"scale": 2.0}, lower=0.2))}
    study = make_study(data=noisy, free=("n0", "phi"), noise=noise)
    draws = drawn(study)
    mode = find_mode(posterior(study), draws)
    assert mode.x[2] == pytest.approx(np.median(draws[:, 2]))


def test_guesses_are_starting_points(make_study: MakeStudy, noisy: pd.DataFrame) -> None:
    """A good guess among poor draws leads to the mode; one outside the support is passed over."""
    study = make_study(data=noisy, free=FREE)
    density = posterior(study)
    draws = draw_cut_prior(density, 300, np.random.default_rng(1)).x
    joint = fit(study, ("joint",))["joint"].values()
    mode = find_mode(density, draws, [joint, {**joint, "n0": -3.0}])
    best = density.log_density(np.array([joint[name] for name in density.names]))[0]
    assert mode.log_density >= best - 1e-9


def test_a_mode_with_a_parameter_held_is_the_best_there(make_study: MakeStudy, noisy: pd.DataFrame) -> None:
    """No draw moved to the held value is denser, the free mode is; where nothing is possible there is none."""
    density = posterior(make_study(data=noisy, free=FREE))
    draws = draw_cut_prior(density, 2000, np.random.default_rng(1)).x
    free = find_mode(density, draws)
    at = {"phi": float(free.x[2]) + 0.1}
    mode = find_mode(density, draws, held=at)
    moved = free.x + np.random.default_rng(2).normal(size=(4000, 4)) * [0.01, 50.0, 0.0, 1e-3]
    moved[:, 2] = at["phi"]
    assert mode.x[2] == at["phi"]
    assert free.log_density > mode.log_density > density.log_density(moved).max() - 1e-3
    assert find_mode(density, draws, held={"phi": -1.0}).log_density == -np.inf


def test_edges_are_named(make_study: MakeStudy, noisy: pd.DataFrame) -> None:
    """Bounds of the prior, and sums that physics bounds; a point inside has none."""
    density = posterior(make_study(data=noisy, free=("n0", "c1", "c2")))
    low, high = density.prior.laws["n0"].range
    slips = density.likelihood.observations.slip
    assert edges(density, np.array([0.5 * (low + high), 0.3, 0.1])) == {}
    assert edges(density, np.array([high, 0.3, 0.1])) == {"n0": "upper bound"}
    assert set(edges(density, np.array([0.9, -slips.min() * 0.7, 0.7])).values()) == {f"c1 + {slips.min():.3g} c2 = 0"}
    assert set(edges(density, np.array([0.9, 1 - slips.max() * 0.7, 0.7])).values()) == {
        f"c1 + {slips.max():.3g} c2 = 1"
    }


def test_one_free_parameter_has_a_mode(make_study: MakeStudy, noisy: pd.DataFrame) -> None:
    """A posterior of one dimension is climbed as well."""
    density = posterior(make_study(data=noisy, free=("phi",)))
    mode = find_mode(density, draw_cut_prior(density, 500, np.random.default_rng(1)).x)
    grid = np.linspace(0.3, 0.8, 5001)[:, None]
    assert mode.log_density >= density.log_density(grid).max() - 1e-6
