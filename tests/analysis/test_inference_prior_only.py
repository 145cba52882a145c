"""A prior before any reading: what is needed, what comes out, and that readings are not looked at."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayesterra.__main__ import main
from bayesterra.analysis import prior_page
from bayesterra.analysis.inference import run_prior
from bayesterra.analysis.result import PriorResult
from bayesterra.analysis.run import load_result
from bayesterra.errors import ResultError, StudyError
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.study.study import Study, load_study
from tests.support.folder import Write
from tests.support.pages import undrawn

EMPTY = "slip,load [N],sinkage [mm],drawbar_pull [N]\n0.1,80,,\n0.2,80,,\n0.4,80,,\n"
PLANNED = "slip,load [N]\n0.1,80\n0.2,80\n0.4,80\n"


def result_of(file: Path) -> PriorResult:
    """The prior's result of a study file."""
    return run_prior(load_study(file, prior_only=True), seed=3)


@pytest.mark.parametrize("table", [EMPTY, PLANNED], ids=["empty cells", "no columns"])
def test_cells_may_be_empty_and_columns_missing(table: str, write: Write) -> None:
    """Every outcome that has noise is predicted in every row, with a share of readings in any interval."""
    found = result_of(write(table=table))
    assert list(found.study.noise) == ["sinkage", "drawbar_pull"]
    assert found.predictive["observed"].isna().all()
    assert (found.predictive[["q05", "q50", "q95"]].diff(axis=1).iloc[:, 1:] > 0).all(axis=None)
    assert found.draws["prior_predictive"]["sinkage"].shape == (1, 2000, 3)


def test_readings_are_not_used(write: Write) -> None:
    """A table with readings gives the same draws, predictions and summary as one without."""
    before, after = result_of(write(table=EMPTY)), result_of(write())
    xr.testing.assert_identical(before.draws["prior"].to_dataset(), after.draws["prior"].to_dataset())
    first, second = (one.draws["prior_predictive"]["drawbar_pull"].to_numpy() for one in (before, after))
    np.testing.assert_array_equal(first, second)
    pd.testing.assert_frame_equal(before.summary, after.summary)
    columns = ["q05", "q50", "q95"]
    pd.testing.assert_frame_equal(before.predictive[columns], after.predictive[columns])


def test_the_prior_is_the_cut_one(write: Write) -> None:
    """Shares and moments are those of the prior that a run with readings would start from."""
    found, study = result_of(write(table=EMPTY)), load_study(write())
    cut = draw_cut_prior(posterior(study), 4000, np.random.default_rng(1))
    inside = "inside the support"
    assert found.record["prior_support"]["shares"][inside] == pytest.approx(cut.shares[inside], abs=0.03)
    rows = found.summary.set_index("parameter")
    sd = cut.x.std(axis=0)
    scales = np.array([1e3, 1, 1, 1e3, np.pi / 180, 1e-3, 1, 1])
    means = rows.loc[list(study.prior.names), "prior_mean"].to_numpy() * scales
    assert (np.abs(means - cut.x.mean(axis=0)) < 5 * sd * np.sqrt(2 / 4000)).all()


@pytest.mark.parametrize("drive", ["sinkage", "both"])
def test_other_drives_predict_under_what_is_given(drive: str, write: Write) -> None:
    """With sinkage given forces are predicted, with a latent load what its flat prior leads to."""
    table = "slip,load [N],sinkage [mm]\n0.1,80,5.0\n0.2,80,7.5\n0.4,80,14.0\n"
    file = write(("[data]", f'drive = "{drive}"\n[data]'), ("[priors]", 'normal_force = "2 N"\n[priors]'), table=table)
    found = result_of(file)
    assert set(found.study.noise) == {"normal_force", "drawbar_pull", *(["sinkage"] * (drive == "both"))}
    force = found.predictive[found.predictive["channel"] == "normal_force"]
    width = force["q95"] - force["q05"]
    assert (width > 20).all()
    if drive == "both":  # flat over six sd of 2 N to either side of the load of the table
        np.testing.assert_allclose(force[["q05", "q50", "q95"]], [[69, 80, 91]] * 3, atol=1.2)
    with undrawn():
        assert "normal force" in found.page().html() or drive == "both"


def test_what_is_missing_is_said(write: Write) -> None:
    """Without noise nothing is to be measured; without --prior-only readings are needed, and it is named."""
    quiet = write(('sinkage = "1 mm"\n', ""), ('drawbar_pull = "1.5 N"', ""), table=PLANNED)
    with pytest.raises(StudyError, match=r"\[noise\] needs an entry for at least one of sinkage"):
        load_study(quiet, prior_only=True)
    with pytest.raises(StudyError, match=r"at least one reading of sinkage.*\(before that: run --prior-only\)"):
        load_study(write(table=EMPTY))


def test_the_command_writes_a_folder(
    write: Write, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """It ends with 0, names the report, and the folder has all files; other commands know what it is."""
    file = write(table=PLANNED)
    monkeypatch.chdir(tmp_path)
    assert main(["run", str(file), "--prior-only", "--out", "before"]) == 0
    assert "Report: before/report.html" in capsys.readouterr().out.replace("\n", " ")
    folder = tmp_path / "before"
    names = {path.name for path in folder.iterdir()}
    tables = {"summary.csv", "predictive.csv", "measurements.csv"}
    assert names == {"report.html", "draws.nc", "run.json", "study.toml", "SHA256SUMS", *tables}
    assert json.loads((folder / "run.json").read_text())["prior_only"] is True
    assert main(["run", str(file), "--prior-only", "--out", "before"]) == 2
    assert "--overwrite" in capsys.readouterr().err
    with undrawn():
        assert main(["run", str(folder), "--prior-only", "--out", "again"]) == 0
    again = pd.read_csv(tmp_path / "again" / "summary.csv")
    pd.testing.assert_frame_equal(again, pd.read_csv(folder / "summary.csv"))
    with pytest.raises(ResultError, match="holds a prior without readings"):
        load_result(folder)


def test_the_report_says_what_it_is(write: Write) -> None:
    """The page is self-contained, escapes what users wrote, and speaks of the prior only."""
    file = write(('title = "Small study"', 'title = "Sand <b>&"'), table=PLANNED)
    page = result_of(file).page().html()
    assert "Sand &lt;b&gt;&amp;" in page
    assert "No readings were used" in page
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert "nan" not in page.split("<body>")[1].replace("finance", "").lower().split("base64")[0]


def test_figures_return_axes(write: Write) -> None:
    """A notebook can draw any of them alone."""
    found = result_of(write(table=PLANNED))
    assert prior_page.prior_density(found, "phi").get_xlabel() == r"$\varphi$ [deg]"
    assert prior_page.prior_bands(found, "drawbar_pull").get_ylabel() == r"$F_\mathrm{DP}$ [N]"


def test_python_needs_no_readings_either(write: Write) -> None:
    """A study made in Python takes a table of slips and loads."""
    wheels = load_study(write()).wheels
    table = pd.DataFrame({"slip": [0.1, 0.3], "load [N]": [80.0, 80.0]})
    study = Study(table, wheels, slip_reference="shearing", noise={"sinkage": 1e-3}, prior_only=True)
    assert np.isnan(study.observations.values["sinkage"]).all()
    assert run_prior(study).names == study.prior.names


def test_latent_loads_need_no_reading_before_the_test(write: Write) -> None:
    """With a stated range of the loads, slips alone are a plan; without one it is asked for."""
    both = ("[data]", 'drive = "both"\nload_range = ["60 N", "100 N"]\n[data]')
    noise = ("[priors]", 'normal_force = "2 N"\n[priors]')
    found = result_of(write(both, noise, table="slip\n0.1\n0.3\n"))
    pull = found.summary.set_index("parameter").loc["peak_pull"]
    assert np.isfinite(pull["prior_median"])
    force = found.predictive[found.predictive["channel"] == "normal_force"]
    np.testing.assert_allclose(force["q50"], 80.0, atol=2.0)
    unknown = write((both[0], 'drive = "both"\n[data]'), noise, table="slip\n0.1\n0.3\n")
    with pytest.raises(StudyError, match="the drive 'both' needs 'load_range' or readings of 'normal_force'"):
        load_study(unknown, prior_only=True)


def test_a_prior_tells_what_it_is_in_a_few_lines(write: Write) -> None:
    """Without a verdict on a sampling that there was not."""
    lines = repr(result_of(write(table=EMPTY))).splitlines()
    assert lines[0].startswith("PriorResult: ")
    assert len(lines) == 3
    assert "1 chains × 4000 draws of " in lines[1]
