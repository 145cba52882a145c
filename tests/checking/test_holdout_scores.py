"""Scores of predictive laws against integration, simulation and published closed forms."""

from typing import Any

import numpy as np
import pytest
from numpy.random import default_rng
from scipy.integrate import quad
from scipy.special import beta
from scipy.stats import norm, t

from bayesterra.checking.folds import folds_of
from bayesterra.checking.holdout_scores import Mixture
from bayesterra.stats.tails import GAUSSIAN, StudentT

CENTRE, SCALE = np.array([-1.0, 0.5, 4.0]), np.array([0.3, 2.0, 0.7])


@pytest.mark.parametrize("y", [-6.0, 0.4, 4.1, 30.0])
@pytest.mark.parametrize("dof", [np.inf, 3.0])
def test_crps_is_the_integral_that_defines_it(y: float, dof: float) -> None:
    """Closed form (normal) and own quadrature (Student-t) agree with adaptive quadrature of scipy's laws."""
    law = norm(CENTRE, SCALE) if np.isinf(dof) else t(dof, CENTRE, SCALE)

    def square(x: float, step: float) -> float:
        return float((law.cdf(x).mean() - step) ** 2)

    marks = sorted({-60.0, -6.0, -1.0, 0.4, 4.1, 12.0, 60.0, y})
    expected = sum(
        quad(square, low, high, args=(float(low >= y),), epsabs=1e-10, limit=200)[0]
        for low, high in zip([-np.inf, *marks], [*marks, np.inf], strict=True)
    )
    assert Mixture(CENTRE, SCALE, GAUSSIAN if np.isinf(dof) else StudentT(dof)).crps(y) == pytest.approx(
        expected, rel=2e-5
    )


def test_crps_of_one_student_law_has_its_closed_form() -> None:
    """Jordan, Krüger and Lerch 2019: the standardised Student-t law."""
    for dof, z in ((2.0, 0.3), (5.0, -2.5), (9.0, 7.0)):
        tail = 2 * np.sqrt(dof) / (dof - 1) * beta(0.5, dof - 0.5) / beta(0.5, 0.5 * dof) ** 2
        middle = z * (2 * t.cdf(z, dof) - 1) + 2 * t.pdf(z, dof) * (dof + z**2) / (dof - 1)
        law = Mixture(np.array([10.0]), np.array([2.0]), StudentT(dof))
        assert law.crps(10 + 2 * z) == pytest.approx(2 * (middle - tail), rel=2e-5)


def test_crps_of_a_heavy_law_is_still_finite() -> None:
    """One degree of freedom: no mean, but a score."""
    known = quad(lambda x: (t.cdf(x, 1) - (x >= 1)) ** 2, -np.inf, 1)[0]
    known += quad(lambda x: (t.cdf(x, 1) - 1) ** 2, 1, np.inf)[0]
    assert Mixture(np.zeros(1), np.ones(1), StudentT(1.0)).crps(1.0) == pytest.approx(known, rel=1e-4)


def test_a_law_without_width_scores_its_absolute_error() -> None:
    """The limit that gives the score its unit."""
    assert Mixture(np.array([3.0]), np.array([1e-9])).crps(5.5) == pytest.approx(2.5)


@pytest.mark.parametrize("dof", [np.inf, 4.0])
def test_density_probability_and_quantiles_belong_together(dof: float) -> None:
    """The density integrates to the probability, whose inverse the quantiles are."""
    law = Mixture(CENTRE, SCALE, GAUSSIAN if np.isinf(dof) else StudentT(dof))
    levels = np.array([0.05, 0.25, 0.5, 0.75, 0.95])
    assert law.cdf(law.quantiles(levels)) == pytest.approx(levels, abs=1e-8)
    share = quad(lambda x: np.exp(law.log_density(x)), -2.0, 3.0, points=[-1.0])[0]
    assert share == pytest.approx(float(np.diff(law.cdf(np.array([-2.0, 3.0])))[0]), rel=1e-6)


def test_the_right_law_scores_best() -> None:
    """Among laws of all widths and places the one that makes the readings has the smallest mean score."""
    readings = default_rng(1).normal(2.0, 1.0, 4000)
    scores = {
        (centre, scale): np.mean([Mixture(np.array([centre]), np.array([scale])).crps(y) for y in readings])
        for centre in (1.5, 2.0, 2.5)
        for scale in (0.5, 1.0, 2.0)
    }
    assert min(scores, key=lambda each: scores[each]) == (2.0, 1.0)


def test_levels_that_lie_close_have_names_of_their_own(make_study: Any, make_table: Any) -> None:
    """As many digits as tell them apart: scores are gathered by name."""
    study = make_study(data=make_table(slips=(0.1001, 0.1004, 0.2, 0.3)), free=("phi",))
    names = [fold.name for fold in folds_of(study, "slip", tolerance=1e-4)]
    assert names == ["slip 0.1001", "slip 0.1004", "slip 0.2000", "slip 0.3000"]
    assert [fold.name for fold in folds_of(study, "slip")] == ["slip 0.100", "slip 0.200", "slip 0.300"]
