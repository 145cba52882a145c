"""The check of the fit answers to the readings, and estimates are taken as they were given."""

from dataclasses import replace

import numpy as np
import pytest

from bayesterra.checking import validation
from bayesterra.checking.loo import CrossValidation, LeftOut
from bayesterra.checking.predictive_checks import Check, PredictiveChecks
from bayesterra.study.result import Result


def misfits(result: Result) -> dict[str, float]:
    """Posterior predictive p of the sum of squared residuals, by channel."""
    checks = result.record["predictive_checks"]["checks"]
    return {check["channel"]: check["p"] for check in checks if check["statistic"] == "misfit"}


def test_readings_that_the_model_explains_fit(small_result: Result) -> None:
    """The HIT readings agree with M1 within their stated noise."""
    assert set(misfits(small_result)) == {"sinkage", "drawbar_pull", "resistance_moment"}
    assert all(p >= 0.05 for p in misfits(small_result).values())
    assert small_result.verdicts[1].word == "fits"


def test_p_value_is_that_of_replicated_readings(small_result: Result) -> None:
    """As drawing readings from the model anew gives it."""
    z = validation.residuals(small_result)
    replicated = np.random.default_rng(3).standard_normal(z.shape)
    share = np.mean((replicated**2).sum(axis=1) >= (z**2).sum(axis=1), axis=0)
    assert [misfits(small_result)[name] for name in small_result.study.noise] == pytest.approx(share, abs=0.04)


@pytest.mark.parametrize(("p", "overstated"), [(0.995, True), (0.98, False)])
def test_a_scatter_far_below_the_noise_is_a_remark_not_a_failure(p: float, overstated: bool) -> None:
    """P above 0.99 says that the noise was stated too large, lesser ones do not; the model fits."""
    checks = PredictiveChecks((Check("resistance_moment", "misfit", p, 0.5),), 0.4, 200, (50.0, 100.0))
    found = validation.fit_verdict(checks, 15, 2)
    assert (found.word, found.grade) == ("fits", "good")
    assert ("Noise of driving resistance moment looks overstated." in str(found.sentence)) == overstated
    assert "lenient" not in str(found.sentence)
    lenient = validation.fit_verdict(checks, 15, 8).sentence
    assert "15 readings for 8 parameters: a lenient test." in str(lenient)


def test_two_strange_statistics_are_doubtful() -> None:
    """Each below 1 %, whatever the overall p; one alone is to be expected."""
    strange = [Check("sinkage", name, 0.01, 0.005) for name in ("slope", "level")]
    for count, word in ((1, "fits"), (2, "doubtful")):
        found = validation.fit_verdict(PredictiveChecks(tuple(strange[:count]), 0.1, 200, (50.0, 100.0)))
        assert found.word == word
    assert str(found.sentence).startswith("Wheel sinkage rises or falls with slip otherwise")
    assert found.claim.startswith("the model may not fit: wheel sinkage rises")


def test_published_values_are_only_those_that_were_published(small_result: Result) -> None:
    """What a record fills in to place an estimate is not shown as published."""
    study = small_result.study
    assert study.published is not None
    assert validation.estimates(small_result)["published"] == dict(study.published.values)
    assert "published" in validation.complete(small_result)


def test_an_estimate_that_leaves_parameters_open_is_not_complete(small_result: Result) -> None:
    """A method without a friction angle is neither judged by density nor run over slip."""
    fits = {**small_result.record["fits"]}
    fits["IM1"] = {**fits["IM1"], "missing": ["phi"]}
    partial = replace(small_result, record={**small_result.record, "fits": fits})
    assert "phi" not in validation.estimates(partial)["IM1"]
    assert "IM1" not in validation.complete(partial)
    assert "IM1" not in validation.complete_soils(partial)


def test_curves_of_the_joint_fit_pass_through_the_readings(small_result: Result) -> None:
    """Joint weights all channels by their noise, so its standardised residuals are small."""
    assert np.abs(validation.method_residuals(small_result)["joint"]).max() < 3
    assert np.isfinite(validation.method_curves(small_result, "Wh32")["joint"].values).all()


def test_a_record_says_of_rows_left_out_what_its_rows_add_up_to() -> None:
    """Sum, spread and effective parameters of three rows, by hand."""
    rows = tuple(LeftOut(row, elpd, 0.01, 0.2, refitted=False) for row, elpd in ((1, -2.0), (2, -3.0), (4, -7.0)))
    record = validation.Validation(None, None, CrossValidation(rows, (-1.5, -2.0, -5.0), {})).record()["loo"]
    assert record["elpd"] == -12.0
    assert record["effective_parameters"] == 3.5
    assert record["se"] == pytest.approx(np.sqrt(3 * 7.0))
    assert [(row["row"], row["elpd"]) for row in record["rows"]] == [(1, -2.0), (2, -3.0), (4, -7.0)]
