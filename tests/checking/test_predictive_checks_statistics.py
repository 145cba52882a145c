"""Statistics of residuals: what each of them sees, and that band and shares are those of uniform values."""

import numpy as np
import pytest

from bayesterra.checking.predictive_checks import TEST_STATISTICS, applicable, exceedance
from bayesterra.stats.diagnostics import PLACES, calibrated, ecdf_band

SLIP = np.array([0.0, 0.1, 0.1, 0.3, 0.4, 0.6])


@pytest.mark.parametrize(
    ("name", "pattern"),
    [("level", np.ones(6)), ("slope", SLIP - SLIP.mean()), ("curvature", (SLIP - SLIP.mean()) ** 2)],
)
def test_contrasts_see_their_own_pattern_only(name: str, pattern: np.ndarray) -> None:
    """A contrast grows with its own pattern, by one per unit of length, and ignores all lower ones."""
    value = TEST_STATISTICS[name].value
    z = np.random.default_rng(1).standard_normal((4, 6))
    lower = {"level": [], "slope": [np.ones(6)], "curvature": [np.ones(6), SLIP]}[name]
    for other in lower:
        np.testing.assert_allclose(value(z + 7 * other, SLIP), value(z, SLIP), atol=1e-12)
    assert value(pattern, SLIP) > 0
    np.testing.assert_allclose(value(-pattern, SLIP), -value(pattern, SLIP))
    many = np.random.default_rng(2).standard_normal((20_000, 6))
    assert value(many, SLIP).std() == pytest.approx(1.0, abs=0.03)


def test_runs_of_one_sign_and_large_residuals_are_seen() -> None:
    """Neighbours of one sign correlate, alternating ones do so negatively; the sum of squares is χ²."""
    neighbours, misfit = TEST_STATISTICS["neighbours"].value, TEST_STATISTICS["misfit"].value
    runs, turns = np.array([1.0, 1, 1, -1, -1, -1]), np.array([1.0, -1, 1, -1, 1, -1])
    assert neighbours(runs, SLIP) > 0 > neighbours(turns, SLIP)
    assert misfit(3 * runs, SLIP) == 54


def test_few_slips_have_few_statistics() -> None:
    """A slope needs two slips, a curvature three, neighbours four; repeats at one slip do not count."""
    names = [[one.name for one in applicable(slip)] for slip in (np.full(9, 0.3), np.array([0.1, 0.1, 0.3]))]
    assert names == [["misfit", "level"], ["misfit", "level", "slope"]]
    assert len(applicable(SLIP)) == 5


def test_exceedance_is_the_share_above() -> None:
    """Ties count half, so that the share of a value among its own kind averages to one half."""
    reference = np.sort(np.random.default_rng(1).integers(0, 5, 1000).astype(float))
    assert exceedance(reference, reference).mean() == pytest.approx(0.5)
    assert exceedance(np.array([-1.0, 9.0]), reference).tolist() == [1.0, 0.0]


def test_the_band_holds_uniform_values_nineteen_times_in_twenty() -> None:
    """Of curves of 25 uniform values 95 % keep inside; of values with an offset or too narrow few do."""
    rng = np.random.default_rng(1)
    low, high = ecdf_band(25)
    assert (low <= high).all()
    assert np.mean([calibrated(list(rng.random(25))) for _ in range(400)]) == pytest.approx(0.95, abs=0.04)
    assert np.mean([calibrated(list(rng.random(25) ** 2.5)) for _ in range(100)]) < 0.3
    assert np.mean([calibrated(list(rng.beta(6, 6, 25))) for _ in range(100)]) < 0.3


def test_values_that_were_not_measured_do_not_count() -> None:
    """NaN among the values changes nothing."""
    pit = [0.1, 0.3, 0.5, 0.7, 0.9]
    assert calibrated([*pit, float("nan")]) == calibrated(pit)


def test_the_band_of_many_values_is_told_at_some_places() -> None:
    """No wider there than every value of its own would make it, and uniform values leave it one time in twenty."""
    rng = np.random.default_rng(5)
    low, high = ecdf_band(3000)
    assert len(low) == len(high) == PLACES
    points = np.arange(1, PLACES) / PLACES
    assert ((low[:-1] < points) & (points < high[:-1])).all()
    assert np.mean([calibrated(list(rng.random(3000))) for _ in range(400)]) == pytest.approx(0.95, abs=0.03)
    assert np.mean([calibrated(list(rng.random(3000) ** 1.1)) for _ in range(100)]) < 0.3
