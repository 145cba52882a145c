"""Validation in a result: its record, its sections in the report, and the verdict that it decides."""

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from bayesterra.analysis.inference import run
from bayesterra.analysis.run import load_result
from bayesterra.checking import validation_page
from bayesterra.checking.validation import Validation
from bayesterra.report.terminal import show
from bayesterra.stats.diagnostics import ecdf_band
from bayesterra.study.result import Result
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study
from tests.support.adaptation import rows_left_out_by_few
from tests.support.pages import plain_pages, undrawn

pytestmark = pytest.mark.usefixtures("little_adaptation")

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]


@pytest.fixture(scope="module")
def result(make_study: MakeStudy, make_table: MakeTable) -> Result:
    """A short run on twenty rows of the model, c and φ free."""
    table, rng = make_table(slips=tuple(np.linspace(0.05, 0.6, 20))), np.random.default_rng(1)
    for name, sd in (("sinkage [m]", 1e-3), ("drawbar_pull [N]", 1.5), ("resistance_moment [N m]", 0.3)):
        table[name] += sd * rng.standard_normal(len(table))
    options = SamplingOptions(target_ess=200, walkers=32)
    with rows_left_out_by_few():
        return run(make_study(data=table, free=("c", "phi"), sampling=options), seed=1)


def test_a_saved_record_gives_the_validation_back(result: Result, tmp_path: object) -> None:
    """What run.json says after saving and loading is what was found."""
    folder = f"{tmp_path}/out"
    with plain_pages():
        result.save(folder)
    before, after = Validation.from_record(result.record), Validation.from_record(load_result(folder).record)
    assert after.checks == before.checks
    assert after.prior == before.prior
    assert before.loo is not None
    assert after.loo is not None
    assert after.loo.elpd == pytest.approx(before.loo.elpd)
    assert json.loads(json.dumps(before.record()["predictive_checks"]))["alarm"] is False


def test_twenty_rows_are_left_out_by_weights_and_have_pit_values(result: Result) -> None:
    """Every used row and channel has a PIT value, and the report draws them."""
    loo = Validation.from_record(result.record).loo
    assert loo is not None
    assert [row.row for row in loo.rows] == list(range(1, 21))
    assert not all(row.refitted for row in loo.rows)
    assert set(loo.pit) == {"sinkage", "drawbar_pull", "resistance_moment"}
    axes = validation_page.loo_pit(result, "sinkage")
    curve = axes.lines[1].get_ydata()
    low, _ = ecdf_band(20)
    assert len(np.asarray(curve)) == len(low)
    with undrawn():
        page = result.page().html()
    for text in ("Cross-validation", "LOO-PIT", "Prior-predictive check", "curvature over slip", "not distinguish"):
        assert text in page


def test_the_alarm_decides_the_verdict(result: Result) -> None:
    """Without an alarm the fit is adequate; with one it names the channel and what is wrong."""
    quiet = result.verdicts[1]
    assert (quiet.word, quiet.grade) == ("fits", "good")
    checks = result.record["predictive_checks"]
    strangest = {"channel": "drawbar_pull", "statistic": "level", "p": 0.01, "calibrated": 0.005}
    for overall, words in ((0.002, ("does not fit", "bad")), (0.01, ("doubtful", "doubtful"))):
        loud = {**checks, "overall": overall, "checks": [strangest, *checks["checks"][1:]]}
        verdict = replace(result, record={**result.record, "predictive_checks": loud}).verdicts[1]
        assert (verdict.word, verdict.grade) == words
        assert str(verdict.sentence).startswith("Drawbar pull is shifted as a whole")


def test_a_misfit_is_the_first_thing_that_a_page_and_a_terminal_say(
    result: Result, capsys: pytest.CaptureFixture[str]
) -> None:
    """The page opens with it, and one line on standard error warns; nothing of the kind where all fits."""
    checks = result.record["predictive_checks"]
    strangest = {"channel": "drawbar_pull", "statistic": "level", "p": 0.01, "calibrated": 0.005}
    loud = {**checks, "overall": 0.002, "checks": [strangest, *checks["checks"][1:]]}
    alarmed = replace(result, record={**result.record, "predictive_checks": loud})
    with undrawn():
        opening = alarmed.page().html().split("<main>")[1].lstrip()
        quiet = result.page().html()
    assert opening.startswith('<p class="quotable bad">Do not use: the model does not fit: drawbar pull is shifted')
    assert '<p class="warning" role="alert">The model does <b>not fit</b> these readings:' in opening
    show(alarmed.overview())
    said = capsys.readouterr().err
    assert said.startswith("warning: Fit: does not fit. Drawbar pull is shifted as a whole (overall p")
    assert said.count("\n") == 1
    assert "<b>not fit</b>" not in quiet
    show(result.overview())
    assert capsys.readouterr().err == ""
