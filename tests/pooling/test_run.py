"""A run with groups: tables, folder, report and command line."""

from __future__ import annotations

import json
from collections.abc import Callable
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from markupsafe import escape

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.analysis import run as analysis_run
from bayesterra.analysis.export import _as_json, methods_text
from bayesterra.analysis.inference import run_prior
from bayesterra.analysis.result import read_result
from bayesterra.analysis.run import load_result
from bayesterra.errors import ResultError
from bayesterra.likelihood.joint import draw_joint_prior, joint_posterior
from bayesterra.parameters import field_values
from bayesterra.pooling import run as pooling_run
from bayesterra.pooling.degrees import Level, Sharing
from bayesterra.pooling.page import group_strip
from bayesterra.pooling.run import PooledResult, _sharing_table, row_likelihoods, run_pooled
from bayesterra.report.blocks import Table
from bayesterra.report.terminal import show
from bayesterra.report.verdicts import PARTS
from bayesterra.sampling.joint import PoolingOptions
from bayesterra.sampling.sampler import ThinnedDraws
from bayesterra.study.canonical import write_study
from bayesterra.study.groups import law_sd
from bayesterra.study.model_errors import ModelErrors, Size, SlipError
from bayesterra.study.study import Study
from tests.support.adaptation import rows_left_out_by_few
from tests.support.pages import unpainted
from tests.support.thinned import thinned
from tests.support.two_wheels import TABLE, few_walkers

MakeStudy = Callable[..., Study]


@pytest.fixture(scope="module")
def result(make: MakeStudy, small: PoolingOptions) -> PooledResult:
    """A small run."""
    with few_walkers(sweeps=10, draws=512, inner=16):
        return run_pooled(make(), seed=1, plan=small)


@pytest.fixture(scope="module")
def few(result: PooledResult) -> PooledResult:
    """It with few of its draws, for commands that predict from each."""
    return replace(result, draws=thinned(result.draws))


@pytest.fixture(scope="module")
def saved(few: PooledResult, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Its folder, whose page has empty pictures."""
    folder = tmp_path_factory.mktemp("pooled") / "both"
    with unpainted():
        few.save(folder)
    return folder


def test_tables_name_everything(result: PooledResult) -> None:
    """Parameters, degrees of pooling, verdicts."""
    assert list(result.summary["parameter"]) == ["phi", "K.mean", "K.spread", "K[Wh11]", "K[Wh32]"]
    assert list(result.pooling["pooling"]) == ["complete", "as stated", "none"]
    assert list(result.sharing["parameter"]) == ["phi", "K"]
    assert result.draws["posterior"]["K"].dims == ("chain", "draw", "group")
    assert result.draws["posterior"]["phi"].dims == ("chain", "draw")
    assert set(result.left_out["what"]) == {"row", "group"}
    assert result.converged
    for group in ("log_likelihood", "observed_data", "constant_data"):
        rows = result.draws[group]["row"].to_numpy().tolist()
        assert rows == list(result.study.observations.used().rows)
    assert result.draws.attrs["inference_library"] == "bayesterra"


def test_rows_of_mixed_groups_stand_as_in_the_table(make: MakeStudy) -> None:
    """Groups whose rows alternate: the likelihood of each row is under its own number."""
    mixed = TABLE.sample(frac=1.0, random_state=1)
    joint = joint_posterior(make(data=mixed))
    x = draw_joint_prior(joint, 8, np.random.default_rng(1))
    rows = list(range(1, len(mixed) + 1))
    found = row_likelihoods(joint, x.reshape(2, 4, -1), rows)["readings"]
    assert found.dims == ("chain", "draw", "row")
    assert found["row"].to_numpy().tolist() == rows
    assert mixed["wheel"].iloc[:4].nunique() == 2
    for g, (name, density) in enumerate(joint.groups.items()):
        own = joint.of_group(*(part if i == 0 else part[g] for i, part in enumerate(joint.split(x))))
        mine = [row for row, wheel in zip(rows, mixed["wheel"], strict=True) if wheel == name]
        expected = density.log_rows(own)[1].reshape(2, 4, -1)
        np.testing.assert_allclose(found.sel(row=mine), expected)


def test_what_each_group_has_is_judged_as_the_study_states(result: PooledResult) -> None:
    """K of a population too: against values of its own, and against the population; φ is shared."""
    table = result.sharing.set_index("parameter")
    assert table["verdict_as_stated"]["phi"] == ""
    assert table["verdict_as_stated"]["K"] in ("soil constant", "wheel-dependent", "cannot tell")
    level = result.pooling.set_index("pooling")["log_evidence"].astype(float)
    against_population = level["complete"] - level["as stated"]  # with K shared nothing is a group's own
    assert table["log_bayes_factor_as_stated"]["K"] <= against_population + 1e-9
    assert table["reliable_as_stated"].all()
    assert (table["error_as_stated"]["K"], table["error"]["phi"]) == pytest.approx((0.0, 0.0), abs=0.3)


def test_report_has_both_verdicts(result: PooledResult) -> None:
    """One in the joint study beside the one from the groups alone; older results have only the latter."""
    table = result.sharing.assign(verdict_as_stated=["", "wheel-dependent"], log_bayes_factor_as_stated=-9.87)
    html = replace(result, sharing=table.assign(error_as_stated=0.1)).page().html()
    assert "With the other parameters shared or not as this study has them: Each group has its own value" in html
    assert "−9.9 ± 0.10" in html
    older = [name for name in map(str, result.sharing) if name.endswith("as_stated")]
    assert len(older) == 4
    before = replace(result, sharing=result.sharing.drop(columns=older))
    assert "as this study has them:" not in before.page().html()


def test_evidences_are_those_of_rows_left_out_one_after_another(result: PooledResult) -> None:
    """Without pooling the elpd of groups is the evidence itself; with it, what others add is positive."""
    elpd = dict(zip(result.pooling["pooling"], result.pooling["elpd_groups"].astype(float), strict=True))
    log_z = dict(zip(result.pooling["pooling"], result.pooling["log_evidence"].astype(float), strict=True))
    assert elpd["none"] == pytest.approx(log_z["none"], abs=1e-9)
    assert elpd["as stated"] > elpd["none"]


def test_folder_is_read_back(result: PooledResult, tmp_path: Path) -> None:
    """And is not taken for a result without groups."""
    report = result.save(tmp_path / "out")
    assert report.read_text(encoding="utf-8") == result.page().html()
    found = load_result(tmp_path / "out")
    assert isinstance(found, PooledResult)
    frame = found.to_dataframe()
    np.testing.assert_allclose(frame["K[Wh32]"], result.to_dataframe()["K[Wh32]"])
    assert found.groups == ("Wh11", "Wh32")
    with pytest.raises(ResultError, match=r"holds a joint posterior of several groups \(\[pooling\]\)"):
        read_result(tmp_path / "out")


def test_the_next_drive_is_that_of_a_group(
    few: PooledResult, saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of one that was driven by name, else of one that was not: judged by its draws, and said so."""
    found = bt.recommend(few, slips=[0.2, 0.4], group="Wh32")
    alone = bt.recommend(few.of_group("Wh32"), slips=[0.2, 0.4])
    pd.testing.assert_frame_equal(found.table, alone.table)
    assert set(found.table["wheel"]) == {"Wh32"}
    asked = ["design", str(saved), "--slip", "0.2,0.4", "--quiet"]
    untested = tmp_path / "new.toml"
    untested.write_text('radius = "140 mm"\nwidth = "160 mm"\nlug_height = "5 mm"\nlug_count = 24\n', encoding="utf-8")
    for options, said in (
        (["--group", "Wh32"], "parameters are those of Wh32 in the joint posterior of Wh11, Wh32"),
        (["--wheel", "Wh32"], "parameters are those of Wh32 in the joint posterior of Wh11, Wh32"),
        (["--wheel", str(untested)], "this wheel was not tested: K drawn from the population of Wh11, Wh32"),
    ):
        with unpainted():
            assert main([*asked, *options, "--out", str(tmp_path / "next"), "--overwrite"]) == 0
        assert f"Note: {said}." in " ".join(capsys.readouterr().out.split())
        assert said in (tmp_path / "next" / "report.html").read_text(encoding="utf-8")
        assert said in (tmp_path / "next" / "design.json").read_text(encoding="utf-8")
    assert main([*asked, "--group", "Wh23", "--out", str(tmp_path / "none")]) == 2
    assert "unknown group 'Wh23'" in capsys.readouterr().err
    assert main([*asked, "--out", str(tmp_path / "none")]) == 2
    assert "say whose drives: 'group' must be one of Wh11, Wh32, or 'wheel' one" in capsys.readouterr().err


def test_groups_are_compared_as_results(
    few: PooledResult, saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each with its parameters, shared and own, and its predictions; also from one folder."""
    found = bt.compare({"both": few})
    assert found.names == ("both: Wh11", "both: Wh32")
    rows = found.parameters.set_index(["result", "quantity"])
    stated = few.summary.set_index("parameter")
    for wheel in ("Wh11", "Wh32"):
        for name, whole in (("phi", "phi"), ("K", f"K[{wheel}]")):
            for column in ("mode", "median", "sd", "hdi90_hi", "prior_mean"):
                got, wanted = rows[column][f"both: {wheel}", name], stated[column][whole]
                assert got == pytest.approx(wanted, rel=1e-12)
    assert set(found.predictions["wheel"]) == {"Wh11", "Wh32"}
    assert found.evidences["log_evidence"].isna().all()
    out = tmp_path / "out"
    with unpainted():
        assert main(["compare", str(saved), "--out", str(out)]) == 0
    assert "both: Wh32" in capsys.readouterr().out
    page = (out / "comparison.html").read_text(encoding="utf-8")
    assert "both: Wh32" in page
    assert "simulated data" in page


def test_following_goes_on_from_a_joint_posterior(result: PooledResult) -> None:
    """Its draws are the posterior of its rows; a row more of one group, and one of a wheel of the study."""
    stream = bt.Stream(result, particles=400)
    assert stream.names == result.names
    assert len(stream) == len(TABLE)
    held = {tuple(x) for x in result.values()}
    assert all(tuple(x) in held for x in stream.cloud.x)
    joint = joint_posterior(result.study)
    level = joint.log_prior_and_likelihood(stream.cloud.x)[1]
    np.testing.assert_allclose(stream.cloud.log_likelihood, level, atol=1e-7)
    update = stream.add(TABLE.iloc[1])
    assert update.names == result.names
    assert np.isfinite(update.log_predictive)
    before, after = (np.std(x[:, result.names.index("K[Wh11]")]) for x in (result.values(), stream.cloud.x))
    assert after < 1.1 * before


def test_a_joint_posterior_is_identified_by_its_draws(
    result: PooledResult, saved: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """From its folder, by the names of its summary; draws and means are those of its tables."""
    assert result.names == tuple(result.summary["parameter"])
    means = result.summary.set_index("parameter")["mean"]
    for name, values in zip(result.names, result.values().T, strict=True):
        assert field_values(name, values).mean() == pytest.approx(means[name], rel=1e-9)
    out = tmp_path / "out"
    with unpainted():
        assert main(["identify", str(saved), "--workers", "1", "--quiet", "--out", str(out)]) == 0
    assert "K[Wh32]" in capsys.readouterr().out
    verdicts = pd.read_csv(out / "verdicts.csv").set_index("parameter")
    assert verdicts["contraction"]["K[Wh11]"] > 0.9


def test_a_joint_posterior_shows_itself(result: PooledResult) -> None:
    """Its overview is the same on a terminal and in a notebook."""
    shown = result._repr_html_()
    assert "elpd of groups" in shown
    assert "Evidence prefers" in shown
    assert result.tables().keys() == {"summary", "pooling", "sharing", "left_out"}


def test_words_and_draws_for_a_manuscript_know_the_groups(result: PooledResult) -> None:
    """Who shares what, and a unit for every parameter."""
    text = methods_text(result)
    assert "Groups by wheel share φ; K of each come from one population." in text
    assert "independent of each other: " in text
    units = json.loads(_as_json(result))["units"]
    assert units == {**dict.fromkeys(result.names, "m"), "phi": "rad"}


def test_page_says_what_is_shared(result: PooledResult) -> None:
    """One picture per parameter, every group named."""
    page = result.page().html()
    assert "What belongs to the soil" in page
    assert "simulated" in page
    assert page.count("<img") == 2
    for group in result.groups:
        assert group in page


@pytest.mark.slow
def test_a_run_stands_without_degrees_and_verdicts(
    make: MakeStudy, small: PoolingOptions, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """Record, page and terminal say what is missing, and the folder is read back."""
    broken = {"degrees": "degrees_of", "sharing": "shared_or_not", "sharing_as_stated": "as_stated"}
    for name in broken.values():
        monkeypatch.setattr(pooling_run, name, lambda *_: dict[str, str]()["no such weights"])
    found = run_pooled(make(sampling={"target_ess": 200, "walkers": 32}), seed=1, plan=small)
    assert list(found.record["failures"]) == list(broken)
    report = found.save(tmp_path / "out")
    again = load_result(tmp_path / "out")
    np.testing.assert_allclose(again.to_dataframe(), found.to_dataframe())
    page = report.read_text(encoding="utf-8")
    show(again.overview())
    printed = capsys.readouterr().out
    for part in broken:
        said = f"{PARTS[part]} could not be computed (KeyError: 'no such weights')"
        assert str(escape(said)) in page
        assert said in printed
    assert page.count("degrees of pooling could not") == 3  # above all, in the verdict and in the section


def test_pages_name_rows_where_the_first_order_of_slip_errors_is_doubtful(few: PooledResult, make: MakeStudy) -> None:
    """Each group its rows, those near a transition slip; before any reading too."""
    note = "Note: errors of slip (sd 0.02) are taken to first order, which is doubtful in row"
    study = copy(few.study)
    object.__setattr__(study, "errors", ModelErrors(slip=SlipError(Size(sd=0.02))))
    with unpainted():
        shown, plain = replace(few, study=study).page().html(), few.page().html()
        before = run_prior(make(pooling=None, slip={"sd": 0.02})).page().html()
        plain_before = run_prior(make(pooling=None)).page().html()
    assert f"{note} 3 within 2 sd of the transition slips" in shown
    assert f"{note} 6 within 2 sd of the transition slips" in shown
    assert note not in plain
    assert f"{note}s 3, 6 within 2 sd of the transition slips" in before
    assert note not in plain_before


def test_a_crosscheck_is_said_on_page_and_terminal(result: PooledResult) -> None:
    """With its verdict; in place of one that failed stands why."""
    found = {"verdict": "agree", "worst": "mean of K: 1.2 errors between a and b", "threshold": 4.0}
    checked = replace(result, record={**result.record, "crosscheck": found})
    assert "Cross-check by nested sampling at two settings: <b>agree</b>" in checked.page().html()
    line = "Cross-check by nested sampling: agree (mean of K: 1.2 errors between a and b)."
    assert line in str(checked.overview())
    assert "Cross-check" not in result.page().html()
    assert "Cross-check" not in str(result.overview())


def test_command_writes_the_folder_and_says_what_it_found(
    few: PooledResult,
    make: MakeStudy,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """As ``bayesterra run`` does it, from the study's file on; the sampling itself stands above."""
    write_study(make(), tmp_path)
    monkeypatch.setattr(analysis_run, "run_pooled", lambda study, **how: few)
    with unpainted(), rows_left_out_by_few():
        assert main(["run", str(tmp_path), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    printed = capsys.readouterr().out
    assert "Sampling: converged" in printed
    assert "A second solution that no ensemble found would not show." in printed
    assert few.record["pooling"]["sentence"].split(":")[0] in printed
    names = {path.name for path in (tmp_path / "out").iterdir()}
    assert {"report.html", "draws.nc", "summary.csv", "sharing.csv", "pooling.csv", "left_out.csv"} <= names
    assert "status.json" not in names
    (tmp_path / "new.toml").write_text('radius = "140 mm"\nwidth = "160 mm"\n', encoding="utf-8")
    wheels = ["--wheel", "Wh32", "--wheel", str(tmp_path / "new.toml")]
    out = tmp_path / "forecast"
    with unpainted():
        assert main(["predict", str(tmp_path / "out"), *wheels, "--slip", "0.3", "--out", str(out)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "parameters are those of Wh32 in the joint posterior of Wh11, Wh32" in printed
    assert "this wheel was not tested: K drawn from the population of Wh11, Wh32" in printed
    assert main(["predict", str(tmp_path / "out"), "--group", "Wh1", "--out", str(out), "--overwrite"]) == 2
    assert "unknown group 'Wh1'" in capsys.readouterr().err


def test_each_groups_own_posterior_is_under_its_name(result: PooledResult) -> None:
    """Draws of a wheel alone have a higher density given its readings than draws of the other alone."""
    joint, alone = joint_posterior(result.study), result.draws["alone"]
    names = joint.first.names
    x = {g: np.column_stack([alone[n].sel(group=g).to_numpy() for n in names]) for g in result.groups}
    for own, density in joint.groups.items():
        typical = {g: np.median(density.log_density(draws)) for g, draws in x.items()}
        assert max(typical, key=lambda g: typical[g]) == own


def test_true_values_of_groups_are_marked_where_they_are(result: PooledResult, make: MakeStudy) -> None:
    """Each group's own in its row, the mean of the population in the last; or one value of all."""
    own = {"K[Wh11]": 0.008, "K[Wh32]": 0.014, "K.mean": 0.012}
    for values, at in ((own, [8.0, 14.0, 12.0]), ({"K": 0.011}, [11.0] * 3)):
        axes = group_strip(replace(result, study=make(truth=values)), "K")
        assert axes.lines[-1].get_xdata() == pytest.approx(at)


def test_a_terminal_shows_the_degrees_of_the_table(result: PooledResult) -> None:
    """Evidence, elpd of rows and elpd of groups, each under its own header; the record has the same."""
    table = result.overview()[0]
    assert isinstance(table, Table)
    columns = {"log evidence": "log_evidence", "elpd of rows": "elpd_rows", "elpd of groups": "elpd_groups"}
    for cells, row in zip(table.rows, result.pooling.to_dict("records"), strict=True):
        shown = dict(zip(table.header, cells, strict=True))
        assert shown["pooling"] == row["pooling"]
        assert {name: shown[name] for name in columns} == {n: f"{row[c]:.1f}" for n, c in columns.items()}
    records = pd.DataFrame(result.record["pooling"]["degrees"])
    pd.testing.assert_frame_equal(records, result.pooling)


def test_a_row_of_sharing_has_both_judgements_apart(make: MakeStudy) -> None:
    """From the groups alone and as stated: factor, error and reliability of each in its own columns."""
    joint = joint_posterior(make())
    alone = Sharing(("K",), Level(-3.0, 0.3, True), Level(-1.0, 0.4, True), Level(-2.0, 0.1, True), "wheel")
    stated = Sharing(("K",), Level(-4.0, 0.6, True), Level(-9.0, 0.1, True), Level(-5.0, 0.8, False), "wheel")
    kept = ThinnedDraws(draw_joint_prior(joint, 40, np.random.default_rng(1)).reshape(4, 10, -1), {}, 1)
    row = _sharing_table(joint, [alone], {"K": stated}, kept).iloc[0]
    figures = ("log_bayes_factor", "against_own_values", "against_a_population", "error")
    assert [row[name] for name in figures] == pytest.approx([-2.0, -2.0, -1.0, 0.5])
    assert (row["log_bayes_factor_as_stated"], row["error_as_stated"]) == pytest.approx((1.0, 1.0))
    assert (row["reliable"], row["reliable_as_stated"]) == (True, False)
    spread = kept.flat[:, joint.names.index("K.spread")] / law_sd(joint.laws["K"])
    assert row["spread_median"] == pytest.approx(np.median(spread))


@pytest.mark.parametrize("converged", [True, False])
def test_what_did_not_converge_beside_it_hides_no_worse(result: PooledResult, *, converged: bool) -> None:
    """The claim of the joint sampling comes first; alone, the others make it doubtful."""
    beside = dict.fromkeys(result.record["verdict"]["compared_with"], True) | {"complete": False}
    verdict = {**result.record["verdict"], "converged": converged, "compared_with": beside}
    told = replace(result, record={**result.record, "verdict": verdict})
    said = "complete pooling did not converge"
    assert told.verdicts[0].grade == ("doubtful" if converged else "bad")
    assert told.verdicts[0].claim == (said if converged else f"the sampling has not converged; {said}")


def test_what_was_not_tested_stands_in_the_sentence_and_a_spoilt_record_is_refused(
    result: PooledResult, tmp_path: Path
) -> None:
    """As for one wheel; verdicts that another program wrote are not taken for ours."""
    said = replace(result, record={**result.record, "untested": ["other loads were not tested"]})
    assert said.sentence == "These intervals hold for 2 groups, Wh11, Wh32; other loads were not tested."
    said.save(tmp_path / "out")
    record = json.loads((tmp_path / "out" / "run.json").read_text(encoding="utf-8"))
    read = PooledResult.RECORD
    read.check(record, "run.json")
    for name, spoilt in (
        ("untested", 5),
        ("verdicts", [{"name": "Fit", "word": "fits", "grade": "green", "sentence": ""}] * 2),
        ("verdicts", [{"name": "Fit", "word": "fits", "grade": "good", "sentence": "", "more": 1}] * 2),
    ):
        with pytest.raises(ValueError, match=f"run.json: {name}"):
            read.check({**record, name: spoilt}, "run.json")
