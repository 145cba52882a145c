"""Where point estimates stand in the posterior."""

from collections.abc import Callable, Mapping

import numpy as np
import pytest

from bayesterra.arrays import FloatArray
from bayesterra.least_squares.results import PointEstimate, locate
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.stats.laws import Law
from bayesterra.study.noise import Noise
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]


@pytest.fixture(scope="module")
def density(make_study: MakeStudy) -> Posterior:
    """Two soil parameters and a noise."""
    noise = {"drawbar_pull": Noise("drawbar_pull", law=Law("halfnorm", {"scale": 2.0}, lower=0.2))}
    return posterior(make_study(free=("c", "phi", "c1"), noise=noise))


@pytest.fixture(scope="module")
def draws(density: Posterior) -> FloatArray:
    """Draws of the prior serve: any cloud has shares."""
    return draw_cut_prior(density, 500, np.random.default_rng(1)).x


def standing(density: Posterior, draws: FloatArray, values: Mapping[str, float]) -> PointEstimate:
    """The standing of one estimate."""
    return locate(density, draws, density.log_density(draws), {"it": values})["it"]


def test_credible_level_is_the_share_of_denser_draws(
    density: Posterior, draws: FloatArray, truth: Mapping[str, float]
) -> None:
    """Counting draws with a higher density gives the level, with the noise at its median."""
    values = {"c": 400.0, "phi": 0.45, "c1": 0.3}
    found = standing(density, draws, values)
    noise = float(np.median(draws[:, 3]))
    level = density.log_density(np.array([[400.0, 0.45, 0.3, noise]]))[0]
    assert found.log_density == pytest.approx(level)
    assert found.credible_level == sum(density.log_density(x)[0] > level for x in draws) / 500
    assert found.word == f"{100 * found.credible_level:.1f} % of the draws are denser"
    assert found.at_bound == ()


def test_the_densest_draw_has_level_zero(density: Posterior, draws: FloatArray) -> None:
    """Nothing is denser than the densest."""
    held = np.where([True, True, True, False], draws, np.median(draws, axis=0))
    levels = density.log_density(held)
    best = dict(zip(density.names[:3], held[levels.argmax(), :3], strict=True))
    found = locate(density, held, levels, {"best": best})["best"]
    assert found.credible_level == 0.0


@pytest.mark.parametrize(
    ("change", "word"), [({"c": 6000.0}, "outside the prior"), ({"c1": 0.0}, "outside the prior: θm outside (θ2, θ1)")]
)
def test_outside_the_prior_is_said_in_words(
    change: Mapping[str, float], word: str, density: Posterior, draws: FloatArray
) -> None:
    """An impossible estimate has level 1, density −inf and the reason in words."""
    found = standing(density, draws, {"c": 300.0, "phi": 0.5, "c1": 0.3, **change})
    assert found.word == word
    assert found.credible_level == 1.0
    assert np.isneginf(found.log_density)


def test_what_an_estimate_leaves_out_stands_at_the_median(density: Posterior, draws: FloatArray) -> None:
    """A missing free parameter takes the posterior median; values of fixed parameters are not used."""
    full = {"c": 300.0, "phi": 0.5, "c1": float(np.median(draws[:, 2]))}
    partial = {"c": 300.0, "phi": 0.5, "Ks": 1.0}
    assert standing(density, draws, partial).log_density == standing(density, draws, full).log_density


@pytest.mark.parametrize(
    ("law", "value", "at_bound"),
    [
        (Law("uniform", lower=0.0, upper=2000.0), 1999.9, True),
        (Law("uniform", lower=0.0, upper=2000.0), 5.0, False),
        (Law("halfnorm", {"scale": 500.0}), 0.0, True),
        (Law("halfnorm", {"scale": 500.0}), 1e-6, True),
        (Law("halfnorm", {"scale": 500.0}), 50.0, False),
        (Law("norm", {"loc": 300.0, "scale": 100.0}), 300.0, False),
    ],
)
def test_bounds_are_noticed(law: Law, value: float, at_bound: bool, make_study: MakeStudy) -> None:
    """An estimate on an end of the prior's range is at a bound, also where the range is open on one side."""
    density = posterior(make_study(free=("c", "phi"), priors={"c": law}))
    draws = draw_cut_prior(density, 100, np.random.default_rng(1)).x
    found = standing(density, draws, {"c": value, "phi": 0.5})
    assert found.at_bound == (("c",) if at_bound else ())
