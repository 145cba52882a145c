"""Soil tests predicted from all other readings, and what is said of that."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence

from bayesterra.checking.soil_tests import NewTests, new_tests, verdict_on_tests
from bayesterra.likelihood.posterior import posterior
from bayesterra.sampling.adaptation import OF_SOIL_TESTS
from bayesterra.sampling.sampler import sample, thin
from tests.support.adaptation import little_leaving_out
from tests.support.soil_tests import PLATE_PRIORS, SMALL, both, plate_table, plates


def test_alarms_need_a_small_p_value_for_the_number_of_checks() -> None:
    """Bonferroni: one in twenty among all of them."""
    empty = pd.DataFrame()
    assert NewTests(empty, empty, {"a": 0.02, "b": 0.5}).alarm
    assert not NewTests(empty, empty, {"a": 0.03, "b": 0.5}).alarm
    assert not NewTests(empty, empty, {}).alarm


def test_verdicts_name_the_worst_check() -> None:
    """Bad with an alarm, a note where there are too few tests, not known where it failed."""
    table = pd.DataFrame({"level_pit": [0.01, 0.5, 0.6]})
    bad = verdict_on_tests(table, {"checks": {"levels": 0.001, "slopes": 0.4}, "alarm": True}, "")
    assert (bad.word, bad.grade) == ("not as predicted", "bad")
    assert "(levels: p < 0.01)" in bad.claim
    assert "2 of 3" in str(bad.sentence)
    assert verdict_on_tests(table, {"checks": {}, "alarm": False}, "").word == "too few to tell"
    assert verdict_on_tests(table, None, "it broke").word == "not known"


@pytest.mark.slow
def test_a_test_that_is_off_is_outside_its_prediction() -> None:
    """One test twice as stiff as it was: its level leaves the prediction from the others."""
    odd, table = plates(tests=6, scatter=0.02), plate_table(tests=6, scatter=0.02)
    own = table["test"] == "0.06 0"
    stress = odd.soil_tests["plate"].readings.stress.copy()
    stress[
        np.isin(odd.soil_tests["plate"].readings.test, [odd.soil_tests["plate"].readings.tests.index("0.06 0")])
    ] *= 2.0
    assert own.any()
    whole = posterior(odd.with_stresses({"plate": stress}))
    draws = thin(sample(whole, SMALL, SeedSequence(1), adaptation=OF_SOIL_TESTS).chains).flat
    found = new_tests(whole, draws, SeedSequence(2)).table.set_index("test")["level_pit"].to_dict()
    assert found.pop("0.06 0") > 0.97
    assert all(0.02 < level < 0.98 for level in found.values())


def test_bands_hold_the_curve_and_new_tests() -> None:
    """From parameter sets that are all the same: the curve itself, and the scatter about it."""
    priors = {"kc": 0.0, "kphi": PLATE_PRIORS["kphi"], "n": 1.0}
    study = plates(noise={"independent": True, "scatter": 0.1}, priors=priors)
    whole = posterior(study)
    with little_leaving_out():
        found = new_tests(whole, np.full((4000, 1), 4e4), SeedSequence(2))
    bands = found.bands
    np.testing.assert_allclose(bands["curve_q50"], 40.0 * bands["path [mm]"] / 1e3)
    np.testing.assert_allclose(np.log(bands["test_q95"] / bands["curve_q50"]) / 0.1, 1.645, atol=0.12)
    assert set(found.table["series"]) == {"plate"}


def test_several_series_have_checks_of_their_own() -> None:
    """Checks name their series; a wheel beside them changes nothing of that."""
    whole = posterior(both(ring=True))
    rng = np.random.default_rng(1)
    centre = np.array([-1e3, 900e3, 1.1, 800.0, 0.54, 0.009, 0.05, 0.02])
    draws = centre * (1.0 + 0.001 * rng.standard_normal((4000, 8)))
    with little_leaving_out(), pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayesterra.checking.soil_tests.pareto_limit", lambda n: np.inf)
        found = new_tests(whole, draws, SeedSequence(2))
    assert {name.split(":")[0] for name in found.checks} == {"plates", "ring"}
    assert found.table.groupby("series")["unit"].first().to_dict() == {"plates": "mm", "ring": "kPa"}
