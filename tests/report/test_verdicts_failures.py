"""No check may cost the posterior: what cannot be computed is a line, and all else stands."""

import json
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

from bayesterra.analysis import inference
from bayesterra.analysis.run import load_result, run_prior_study, run_study
from bayesterra.checking import predictive_checks, validation
from bayesterra.errors import ResultError
from bayesterra.report.terminal import show
from bayesterra.report.verdicts import PARTS, Failures, failed, failures_of
from bayesterra.sampling import evidence, summary
from bayesterra.stats.mixture import pareto_smoothed
from bayesterra.study.result import Result
from bayesterra.study.study import Study, load_study
from tests.support.pages import plain_pages

pytestmark = pytest.mark.usefixtures("little_adaptation")

pages = import_module("bayesterra.analysis.page")
HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"
BROKEN = {
    "fits": (inference, "fit_all"),
    "mode": (inference, "find_mode"),
    "evidence": (evidence, "ensembles_evidence"),
    "curves": (inference, "predict_curves"),
    "standings": (inference, "locate"),
    "identifiability": (inference, "identifiability"),
    "predictive_checks": (predictive_checks, "predictive_checks"),
    "prior_checks": (predictive_checks, "prior_checks"),
    "loo": (validation, "cross_validate"),
    "derived": (summary, "derive"),
}


@pytest.fixture(scope="module")
def study(tmp_path_factory: pytest.TempPathFactory) -> Study:
    """The HIT study with two free parameters, through M2, and few draws."""
    folder = tmp_path_factory.mktemp("study")
    text = (HIT / "study.toml").read_text(encoding="utf-8").replace('"M1"', '"M2"')
    held = 'Ks = "2500 kPa"\nn0 = 0.85\nn1 = 1.06\nK = "10 mm"\nc1 = 0.339\nc2 = -0.017\n'
    text = text.replace('set = "paper-box"\n', f'set = "paper-box"\n{held}')
    text = text.replace("transition_slips = [0.1, 0.5]", "").replace('hold = { Ks = "2500 kPa" }', "")
    (folder / "study.toml").write_text(f"{text}\n[sampling]\ntarget_ess = 100\nwalkers = 32\n", encoding="utf-8")
    (folder / "measurements.csv").write_bytes((HIT / "measurements.csv").read_bytes())
    return load_study(folder)


def refuse(*_: object, **__: object) -> float:
    """A part that fails."""
    raise ValueError("All tail values are the same")


@pytest.fixture(scope="module")
def broken(study: Study, tmp_path_factory: pytest.TempPathFactory) -> tuple[Result, Path]:
    """A run of which everything after the sampling fails, as far as it can, and its folder."""
    folder = tmp_path_factory.mktemp("broken") / "out"
    with pytest.MonkeyPatch.context() as patch:
        for module, name in BROKEN.values():
            patch.setattr(module, name, refuse)
        patch.setattr(pages, "driving", refuse)
        return run_study(study, out=folder, quiet=True), folder


def test_draws_summary_and_report_stand_when_all_checks_fail(
    broken: tuple[Result, Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """Everything that failed is named with type, message and place, in record, report and on the terminal."""
    result, folder = broken
    found = {one.part: one for one in failures_of(result.record)}
    assert set(found) == {*BROKEN, "report: driving"}
    assert {one.error for one in found.values()} == {"ValueError"}
    assert all(one.trace[-1].endswith(" refuse") for one in found.values())
    assert str(Path.home()) not in json.dumps(result.record)
    again = load_result(folder)
    np.testing.assert_array_equal(again.values(), result.values())
    assert again.summary["parameter"].tolist() == ["c", "phi"]
    assert np.isfinite(again.summary[["mode", "median", "mean", "hdi90_lo", "r_hat"]]).all(axis=None)
    assert set(again.identifiability["verdict"]) == {"not known"}
    page = (folder / "report.html").read_text(encoding="utf-8")
    for part in found:
        assert f"{PARTS.get(part, part)} could not be computed (ValueError: All tail" in page
    show(again.overview())
    assert "leave-one-out cross-validation could not be computed (ValueError: All tail values are the same)" in (
        capsys.readouterr().out
    )


def test_a_damaged_record_is_still_noticed(broken: tuple[Result, Path], tmp_path: Path) -> None:
    """An entry may be missing only where its own failure says why."""
    result, _ = broken
    kept = {part: one for part, one in result.record["failures"].items() if part != "loo"}
    with plain_pages():
        replace(result, record={**result.record, "failures": kept}).save(tmp_path / "out")
    with pytest.raises(ResultError, match=r"run\.json lacks 'loo'"):
        load_result(tmp_path / "out")


@pytest.mark.slow
def test_the_draws_are_those_of_a_run_in_which_nothing_fails(broken: tuple[Result, Path], study: Study) -> None:
    """A failure changes no draw; a run in which nothing fails has no entry of failures."""
    sound = inference.run(study, seed=1)
    np.testing.assert_array_equal(sound.values(), broken[0].values())
    assert "failures" not in sound.record
    assert pages.run_page(sound).failures.record() == {}
    assert set(sound.identifiability.columns) == set(broken[0].identifiability.columns)


def test_a_prior_stands_without_its_curves(study: Study, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Curves and derived quantities that fail leave draws, summary and page of a prior."""
    for name in ("predict_curves", "derive"):
        monkeypatch.setattr(inference, name, refuse)
    result = run_prior_study(study, out=tmp_path / "prior")
    assert [one.part for one in failures_of(result.record)] == ["curves", "derived"]
    assert result.summary["parameter"].tolist() == ["c", "phi"]
    assert "curves over slip could not be computed" in (tmp_path / "prior" / "report.html").read_text("utf-8")


def test_what_ends_a_run_is_no_failure_of_a_part() -> None:
    """A full disk, a lack of memory and saved work that cannot be used end the run, to be resumed."""
    failures = Failures()
    for error in (OSError("No space left"), MemoryError(), ResultError("damaged")):

        def end(error: Exception = error) -> float:
            raise error

        with pytest.raises(type(error)):
            failures.attempt("loo", end, float)
    assert failures.record() == {}


def test_a_result_without_failures_says_nothing(small_result: Result) -> None:
    """Records of before this entry are read as ones in which nothing failed."""
    assert "failures" not in small_result.record
    assert failed(small_result.record, *PARTS) == ""
    assert pages.run_page(small_result).failures.record() == {}


@pytest.mark.parametrize("copies", [190, 300, 600])
def test_a_tail_of_one_draw_over_and_over_cannot_be_relied_on(copies: int) -> None:
    """A walker that stood leaves equal weights in the whole tail, of which no Pareto law can be fitted."""
    weights = np.concatenate([np.random.default_rng(1).standard_normal(4000 - copies), np.full(copies, 9.0)])
    log_weights, k = pareto_smoothed(weights)
    assert k == np.inf
    assert np.isclose(np.exp(log_weights).sum(), 1.0)


def test_few_weights_have_no_tail() -> None:
    """Of fewer than 25 weights no tail can be fitted, and they say so."""
    assert pareto_smoothed(np.arange(12.0))[1] == np.inf
