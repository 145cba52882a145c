"""The check of the fit answers to the readings, and estimates are taken as they were given."""

from dataclasses import replace

import numpy as np
import pytest

from bayesterra.checking import validation
from bayesterra.checking.loo import CrossValidation, LeftOut
from bayesterra.study.result import Result


def _moved(result: Result, channel: str, by: float) -> Result:
    values = result.study.observations.values[channel] + by
    return replace(result, study=result.study.with_data({channel: values}))


def test_readings_that_the_model_explains_are_adequate(small_result: Result) -> None:
    """The HIT readings agree with M1 within their stated noise."""
    checks = {check.channel: check for check in validation.fit_checks(small_result)}
    assert list(checks) == ["sinkage", "drawbar_pull", "resistance_moment"]
    assert all(check.p >= 0.05 and check.readings == 5 for check in checks.values())


def test_readings_far_from_the_model_are_not(small_result: Result) -> None:
    """Ten newtons more pull than the draws explain is found out, in that channel only."""
    checks = {c.channel: c for c in validation.fit_checks(_moved(small_result, "drawbar_pull", 10.0))}
    assert checks["drawbar_pull"].p < 0.001
    assert checks["sinkage"].p >= 0.05


def test_p_value_is_that_of_replicated_readings(small_result: Result) -> None:
    """The χ² law of T gives the same p as drawing readings from the model."""
    z = validation.residuals(small_result)
    replicated = np.random.default_rng(3).standard_normal(z.shape)
    share = np.mean((replicated**2).sum(axis=1) >= (z**2).sum(axis=1), axis=0)
    assert [check.p for check in validation.fit_checks(small_result)] == pytest.approx(share, abs=0.03)


def test_a_scatter_far_below_the_noise_is_called_overstated() -> None:
    """P above 0.99 says that the noise was stated too large, lesser ones do not."""
    assert validation.FitCheck("sinkage", 5, 0.995).overstated
    assert not validation.FitCheck("sinkage", 5, 0.98).overstated


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
    rows = tuple(
        LeftOut(row, elpd, 0.01, 0.2, refitted=False) for row, elpd in ((1, -2.0), (2, -3.0), (4, -7.0))
    )
    record = validation.Validation(None, None, CrossValidation(rows, (-1.5, -2.0, -5.0), {})).record()["loo"]
    assert record["elpd"] == -12.0
    assert record["effective_parameters"] == 3.5
    assert record["se"] == pytest.approx(np.sqrt(3 * 7.0))
    assert [(row["row"], row["elpd"]) for row in record["rows"]] == [(1, -2.0), (2, -3.0), (4, -7.0)]
