"""Student-t noise: its density, its draws, its study keys."""

from collections.abc import Callable

import numpy as np
import pytest
from scipy import stats

from bayesterra.errors import StudyError
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.study.entries import noise_entry
from bayesterra.study.noise import Noise
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]


def test_the_law_is_that_of_scipy() -> None:
    """Log density and normal score agree with scipy's t law, whatever the degrees of freedom."""
    x = np.array([-40.0, -3.0, -0.1, 0.0, 0.7, 5.0])
    for dof in (1.0, 4.0, 30.0):
        tails = Noise("sinkage", sd=1.0, dof=dof).tails
        np.testing.assert_allclose(tails.log_density(x), stats.t(dof).logpdf(x), rtol=1e-12)
        np.testing.assert_allclose(stats.norm.cdf(tails.normal_score(x)), stats.t(dof).cdf(x), rtol=1e-9)


def test_many_degrees_of_freedom_are_gaussian() -> None:
    """As the degrees of freedom grow, the density becomes the Gaussian one."""
    x = np.linspace(-4.0, 4.0, 9)
    heavy, plain = Noise("sinkage", sd=1.0, dof=1e9).tails, Noise("sinkage", sd=1.0).tails
    np.testing.assert_allclose(heavy.log_density(x), plain.log_density(x), atol=1e-6)
    np.testing.assert_allclose(plain.log_density(x), stats.norm.logpdf(x), rtol=1e-12)


@pytest.mark.parametrize("drive", ["load", "sinkage"])
def test_likelihood_is_the_sum_of_t_log_densities(drive: str, make_study: MakeStudy) -> None:
    """A channel with dof has t densities of its scale, the others stay Gaussian."""
    study = make_study(noise={"drawbar_pull": Noise("drawbar_pull", sd=1.5, dof=4.0)}, drive=drive)
    density = posterior(study)
    x = draw_cut_prior(density, 5, np.random.default_rng(1)).x
    outcomes = density.outcomes(x)
    pointwise = density.likelihood.pointwise(outcomes, density.noise_values(x))
    predicted = density.likelihood.predicted(outcomes)[:, :, 1]
    expected = stats.t(4.0).logpdf((density.likelihood.measured[:, 1] - predicted) / 1.5) - np.log(1.5)
    np.testing.assert_allclose(pointwise[:, :, 1], expected, rtol=1e-9)


def test_drawn_readings_have_the_tails_of_the_law(make_study: MakeStudy) -> None:
    """Simulated residuals of a channel with dof follow its t law, those of another the normal one."""
    density = posterior(make_study(noise={"drawbar_pull": Noise("drawbar_pull", sd=1.5, dof=3.0)}))
    x = np.repeat(draw_cut_prior(density, 1, np.random.default_rng(1)).x, 2000, axis=0)
    outcomes = density.outcomes(x)
    drawn = density.likelihood.draw(outcomes, density.noise_values(x), np.random.default_rng(2))
    standard = (drawn - density.likelihood.predicted(outcomes)) / np.array([1e-3, 1.5, 0.3])
    assert stats.kstest(standard[:, :, 1].ravel(), stats.t(3.0).cdf).pvalue > 1e-3
    assert stats.kstest(standard[:, :, 0].ravel(), "norm").pvalue > 1e-3


@pytest.mark.parametrize(
    ("entry", "expected"),
    [
        ({"sd": "1 mm", "dof": 4}, Noise("sinkage", sd=1e-3, dof=4.0)),
        ({"fraction": 0.1, "floor": "1 mm", "dof": 5}, Noise("sinkage", fraction=0.1, floor=1e-3, dof=5.0)),
        ("1 mm", Noise("sinkage", sd=1e-3)),
    ],
)
def test_study_entries_with_dof(entry: object, expected: Noise) -> None:
    """``dof`` may stand beside any kind of noise."""
    assert noise_entry("sinkage", entry, bare=False) == expected


def test_impossible_dof_is_refused() -> None:
    """Less than one degree of freedom is no noise law."""
    with pytest.raises(StudyError, match=r"'dof' of the noise of 'sinkage' must be at least 1 \(got 0.5\)"):
        noise_entry("sinkage", {"sd": "1 mm", "dof": 0.5}, bare=False)
    with pytest.raises(StudyError, match="'sinkage' must be"):
        noise_entry("sinkage", {"dof": 4}, bare=False)
