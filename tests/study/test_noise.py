"""Noise of one channel in its three kinds."""

from collections.abc import Callable

import numpy as np
import pytest

from bayesterra.errors import StudyError
from bayesterra.stats.laws import Law
from bayesterra.study.noise import Noise

LAW = Law("halfnorm", {"scale": 2.0}, lower=0.2)
PREDICTED = np.array([[10.0, -40.0, 0.5], [20.0, 0.0, -3.0]])
NONE = np.full(3, np.nan)


def test_given_noise_is_the_same_everywhere() -> None:
    """An absolute standard deviation does not depend on the modelled value."""
    scale = Noise("sinkage", sd=1.5).scale(PREDICTED, None, NONE)
    np.testing.assert_array_equal(np.broadcast_to(scale, PREDICTED.shape), 1.5)


def test_relative_noise_is_of_the_modelled_value_with_a_floor() -> None:
    """The fraction is taken of the size of the modelled value, never below the floor."""
    scale = Noise("drawbar_pull", fraction=0.1, floor=0.2).scale(PREDICTED, None, NONE)
    np.testing.assert_allclose(scale, [[1.0, 4.0, 0.2], [2.0, 0.2, 0.3]])


def test_estimated_noise_is_the_value_of_its_parameter() -> None:
    """Every parameter set brings its own standard deviation."""
    noise = Noise("sinkage", law=LAW)
    assert noise.parameter == "noise_sinkage"
    scale = noise.scale(PREDICTED, np.array([1.0, 2.0]), NONE)
    np.testing.assert_array_equal(scale, [[1.0] * 3, [2.0] * 3])


@pytest.mark.parametrize("noise", [Noise("z", sd=1.0), Noise("z", fraction=0.1, floor=1.0), Noise("z", law=LAW)])
def test_standard_deviations_of_the_table_override(noise: Noise) -> None:
    """A row with its own standard deviation has that one, whatever the kind of noise."""
    scale = noise.scale(PREDICTED, np.array([1.0, 1.0]), np.array([np.nan, 7.0, np.nan]))
    scale = np.broadcast_to(scale, PREDICTED.shape)
    assert (scale[:, 1] == 7.0).all()
    assert (scale[:, [0, 2]] < 5.0).all()


def test_estimated_noise_needs_its_value() -> None:
    """Without a value of the parameter there is no standard deviation."""
    with pytest.raises(ValueError, match="noise of 'sinkage' is estimated: its value must be given"):
        Noise("sinkage", law=LAW).scale(PREDICTED, None, NONE)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Noise("z"), "must be one of: a value, a fraction, an estimate"),
        (lambda: Noise("z", sd=1.0, law=LAW), "must be one of: a value, a fraction, an estimate"),
        (lambda: Noise("z", sd=0.0), r"noise of 'z' must be above 0 \(got 0\)"),
        (lambda: Noise("z", sd=float("inf")), "must be above 0"),
        (lambda: Noise("z", fraction=0.1), r"a floor above 0 \(got 0.1 and 0\)"),
        (lambda: Noise("z", fraction=-0.1, floor=1.0), "needs a fraction above 0"),
        (lambda: Noise("z", law=Law("halfnorm", {"scale": 1.0})), "estimated noise of 'z' needs a 'lower' above 0"),
    ],
)
def test_impossible_noise_says_why(make: Callable[[], Noise], message: str) -> None:
    """Noise of no kind, of two kinds, or without a positive size is refused."""
    with pytest.raises(StudyError, match=message):
        make()
