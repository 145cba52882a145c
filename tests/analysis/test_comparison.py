"""Several results side by side."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import bayesterra as bt
from bayesterra.analysis import comparison_page
from bayesterra.analysis.comparison import Comparison, Evidence, load_results, log_evidence, outcomes_of
from bayesterra.errors import ResultError
from bayesterra.prediction.prediction import PREDICTED
from bayesterra.sampling.evidence import SPREAD
from bayesterra.study.result import Result
from tests.support.pages import undrawn
from tests.support.soil_tests import plates

pytestmark = pytest.mark.usefixtures("little_adaptation")

ODD = "<b>narrow</b>"


@pytest.fixture(scope="module")
def both(wide: Result, narrow: Result) -> Comparison:
    """The two results, one under a name that must be escaped."""
    return bt.compare({"wide": wide, ODD: narrow})


def test_evidence_is_that_of_the_cut_prior(wide: Result) -> None:
    """The share of the stated prior outside the physics is no guess that failed: it is divided out."""
    known = {"log_z": 2.0, "error": 0.03, "log_share": np.log(0.25), "log_share_error": 0.04}
    found = log_evidence(replace(wide, record={**wide.record, "evidence": known}))
    assert found.value == pytest.approx(2.0 + np.log(4))
    assert found.error == pytest.approx(0.05)
    assert found.reliable  # as older results, which do not say
    doubted = replace(wide, record={**wide.record, "evidence": {**known, "reliable": False}})
    assert not log_evidence(doubted).reliable
    assert 0 < wide.record["evidence"]["spread"] < SPREAD  # what its ensembles found alone has joined it


def test_unknown_evidence_is_no_number(wide: Result) -> None:
    """Without estimates there is nothing to say, and nothing fails."""
    broken = replace(wide, record={key: value for key, value in wide.record.items() if key != "evidence"})
    assert np.isnan(log_evidence(broken).value)
    assert bt.compare({"a": wide, "b": broken}).word("a", "b") == "not known"


def test_evidence_compares_for_the_same_readings_only(wide: Result, narrow: Result) -> None:
    """Other readings are another outcome: their densities are not set against each other."""
    assert outcomes_of(wide) == outcomes_of(narrow)
    shifted = wide.study.with_data({"sinkage": wide.study.observations.values["sinkage"] + 1e-3})
    other = replace(wide, study=shifted)
    found = bt.compare({"a": wide, "b": other})
    assert found.word("a", "b") == "not comparable"
    assert np.isnan(found.difference("a", "b")[0])
    with undrawn():
        page = found.page().html()
    assert "not the same" in page
    assert "No two results have comparable evidence" in page
    alike = bt.compare({"a": other, "b": wide, "c": narrow})
    with undrawn():
        assert re.search("Log evidence b .* and c ", alike.page().html())


def test_soil_tests_and_limits_are_readings_too(wide: Result) -> None:
    """A result that also holds plate tests, other plate tests, or limits in place of numbers has other readings."""
    rows = wide.study.observations
    ends = np.column_stack([np.full(len(rows), -np.inf), rows.values["sinkage"]])
    limited = wide.study.with_rows(replace(rows, limits={"sinkage": ends}))
    tested, other = (wide.study.having(soil_tests=plates(scatter=s).soil_tests) for s in (0.05, 0.04))
    found = [outcomes_of(replace(wide, study=study)) for study in (wide.study, limited, tested, other)]
    assert len({*found}) == 4


def test_folders_of_one_name_all_have_another_name(wide: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the folders are called, none takes the place of another."""
    monkeypatch.setattr("bayesterra.analysis.comparison.read_result", lambda folder: folder)
    monkeypatch.setattr("bayesterra.analysis.comparison.is_pooled", lambda folder: False)
    folders = [Path(name) for name in ("/x/a (2)", "/y/a", "/z/a", "/z/a-result")]
    found = load_results(folders)
    assert [str(result) for result in found.values()] == [str(folder) for folder in folders]
    assert list(found) == ["a (2)", "a", "a (3)", "a (4)"]


@pytest.mark.parametrize(
    ("value", "error", "word"),
    [
        (0.9, 0.01, "not distinguishable"),
        (4.0, 3.0, "not distinguishable"),
        (2.0, 0.1, "positive evidence for b"),
        (-4.0, 0.1, "strong evidence for a"),
        (9.0, 0.1, "very strong evidence for b"),
    ],
)
def test_words_of_kass_and_raftery(both: Comparison, value: float, error: float, word: str) -> None:
    """The word follows the difference, and needs it to be beyond two standard errors."""
    result = next(iter(both.results.values()))
    evidence = {"a": Evidence(0.0, 0.0, "x"), "b": Evidence(value, error, "x")}
    curve = next(iter(both.curves.values()))
    results: dict[str, Result] = {"a": result, "b": result}
    found = replace(both, results=results, curves={"a": curve, "b": curve}, evidence=evidence)
    assert found.word("a", "b") == word


def test_an_evidence_that_its_own_run_doubts_decides_nothing(both: Comparison) -> None:
    """However large the difference, the word is that it is not known, and whose evidence that is."""
    result, curve = next(iter(both.results.values())), next(iter(both.curves.values()))
    evidence = {"a": Evidence(0.0, 0.1, "x"), "b": Evidence(9.0, 0.1, "x", reliable=False)}
    results: dict[str, Result] = {"a": result, "b": result}
    found = replace(both, results=results, curves={"a": curve, "b": curve}, evidence=evidence)
    assert found.word("a", "b") == "not known: the evidence of b cannot be relied on"
    assert found.evidences["reliable"].tolist() == [True, False]


def test_rows_left_out_compare_by_difference(both: Comparison, wide: Result) -> None:
    """The difference is taken row by row, and its sign says which result predicts better."""
    found = both.left_out("wide", ODD)
    assert found is not None
    by_row = both.loo[ODD].by_row - both.loo["wide"].by_row
    assert found.elpd == pytest.approx(by_row.sum())
    assert both.left_out_word("wide", ODD) == "not distinguishable"
    worse = [{**row, "elpd": row["elpd"] - 3.0} for row in wide.record["loo"]["rows"]]
    record = {**wide.record, "loo": {**wide.record["loo"], "rows": worse}}
    clear = bt.compare({"a": wide, "b": replace(wide, record=record)})
    assert clear.left_out_word("a", "b") == "a predicts better"
    without = {name: value for name, value in wide.record.items() if name != "loo"}
    assert bt.compare({"a": wide, "b": replace(wide, record=without)}).left_out_word("a", "b") == "not known"


def test_shift_and_width_are_in_units_of_the_first(both: Comparison) -> None:
    """A parameter's shift and width follow from both summaries; the first result has none."""
    rows = both.parameters.set_index(["result", "quantity"])
    first, other = (dict(rows.loc[[(name, "phi")]].iloc[0]) for name in ("wide", ODD))
    assert first["shift"] == 0
    assert other["shift"] == pytest.approx((other["mean"] - first["mean"]) / first["sd"])
    assert other["width"] == pytest.approx(other["sd"] / first["sd"])
    assert other["width"] < 0.5
    assert (ODD, "Ks") not in rows.index


def test_all_predict_the_same_conditions(both: Comparison) -> None:
    """Load and slips of the predictions are common, whatever the results were driven at."""
    assert {curve.load for curve in both.curves.values()} == {80.0}
    grids = [curve.slip for curve in both.curves.values()]
    np.testing.assert_array_equal(grids[0], grids[1])
    np.testing.assert_allclose(both.points["wide"].slip, [0.1, 0.2, 0.3, 0.4, 0.6])
    assert set(both.predictions["result"]) == {"wide", ODD}


def test_one_wheel_and_load_for_all(wide: Result, narrow: Result, tmp_path: Path) -> None:
    """A wheel by name or from a file is driven by all, under the load asked for; its readings are shown."""
    (tmp_path / "small.toml").write_text('radius = "100 mm"\nwidth = "165 mm"\n', encoding="utf-8")
    results = {"a": wide, "b": narrow}
    found = bt.compare(results, load="60 N", wheel=tmp_path / "small.toml")
    assert {(curve.name, curve.wheel.radius, curve.load) for curve in found.curves.values()} == {("small", 0.1, 60.0)}
    for load, dots in ((80, 5), (60, 0)):
        ax = comparison_page.contrast_prediction(bt.compare(results, load=load, wheel="Wh32"), "sinkage")
        assert [len(np.asarray(line.get_xdata())) for line in ax.get_lines()[2:]] == [dots]
    with pytest.raises(bt.StudyError, match="'Wh3' is neither a wheel of the study nor a file"):
        bt.compare(results, wheel="Wh3")


def test_the_page_is_whole_and_escaped(both: Comparison) -> None:
    """One file without network or scripts, the same each time, names from outside escaped."""
    page = both.page().html()
    assert page == both.page().html()
    assert len(page.encode()) < 5e6
    assert not any(forbidden in page for forbidden in ("http://", "https://", "<script", ODD))
    assert "&lt;b&gt;narrow&lt;/b&gt;" in page
    assert "fixed at 2500" in page


def test_the_folder_and_the_names_of_folders(saved: Path, tmp_path: Path) -> None:
    """Folders go by their names; the comparison's own folder holds the page and three tables."""
    folders = [saved / "wide-result", saved / "narrow-result"]
    assert list(load_results([*folders, folders[0]])) == ["wide", "narrow", "wide (2)"]
    with undrawn():
        page = bt.compare([str(folder) for folder in folders]).save(tmp_path / "comparison")
    assert page.is_file()
    names = {path.name for path in page.parent.iterdir()}
    assert names == {"comparison.html", "comparison.csv", "predictions.csv", "evidence.csv", "SHA256SUMS"}


def test_too_few_and_too_many(wide: Result) -> None:
    """One result has nothing to stand beside; seven do not fit."""
    for count in (1, 7):
        with pytest.raises(ResultError, match=rf"two to 6 results can be compared \(got {count}\)"):
            bt.compare({str(i): wide for i in range(count)})


def test_figures_return_their_axes(both: Comparison) -> None:
    """Parameters, derived quantities and predictions are each drawn into the axes that are given."""
    ax = comparison_page.contrast(both, "Ks")
    assert comparison_page.contrast_derived(both, "peak_pull", ax) is ax
    for quantity in PREDICTED:
        assert comparison_page.contrast_prediction(both, quantity).get_xlabel().startswith("slip")


def test_results_show_themselves_in_notebooks(both: Comparison, wide: Result) -> None:
    """Result and comparison are tables with symbols, and escape what comes from outside."""
    shown = wide._repr_html_()
    assert "converged" in shown
    assert "<i>K</i><sub>s</sub>" in shown
    assert "max η" in shown
    assert ODD not in both._repr_html_()
    assert "log evidence" in both._repr_html_()


def test_a_row_of_the_evidence_is_of_its_own_result(both: Comparison) -> None:
    """Evidence, elpd and both errors are those of the result that the row names."""
    table = both.evidences.set_index("result")
    assert table.index.tolist() == list(both.names)
    for name, result in both.results.items():
        row, loo = table.loc[name], result.record["loo"]
        elpd = np.array([left_out["elpd"] for left_out in loo["rows"]])
        spread = np.sqrt(len(elpd)) * elpd.std(ddof=1)
        np.testing.assert_allclose(row[["elpd", "elpd_se"]].to_numpy(float), [elpd.sum(), spread])
        own = result.record["evidence"]
        assert row["log_evidence"] == pytest.approx(own["log_z"] - own["log_share"])
        assert row["error"] == pytest.approx(np.hypot(own["error"], own["log_share_error"]))
        assert row["model"] == result.study.model.name
