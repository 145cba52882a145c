"""Levels, what a left-out row keeps, scores and their errors, folders and the command."""

import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence, default_rng

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.checking.calibration import replicated
from bayesterra.checking.folds import REFITS, LeaveOneOut, levels, predictives
from bayesterra.checking.holdout import Holdout
from bayesterra.checking.holdout_scores import clustered, skills, summarise
from bayesterra.checking.short_runs import Fitted
from bayesterra.errors import ResultError, StudyError
from bayesterra.likelihood.posterior import posterior
from bayesterra.study.canonical import write_study
from bayesterra.study.study import Study
from tests.support.pages import undrawn, unpainted

from .left_out import MakeStudy, make, on_grid

Captured = pytest.CaptureFixture[str]
FILES = {
    "report.html", "scores.csv", "summary.csv", "skills.csv", "refits.csv", "holdout.png", "bands.png",
    "holdout.json", "study.toml", "measurements.csv", "SHA256SUMS",
}  # fmt: skip


@pytest.fixture(scope="module")
def make_study() -> MakeStudy:
    """See :func:`make`."""
    return make


@pytest.fixture(scope="module")
def found(make_study: MakeStudy) -> Holdout:
    """Every slip level of the simulated study left out once."""
    return bt.leave_out(make_study(), fit=on_grid)


def test_near_slips_are_one_level(make_study: MakeStudy) -> None:
    """Slips nearer than the tolerance stay together; rows that are not in the fit are in no level."""
    study = make_study()
    parts = levels(study)
    assert [level.left.nonzero()[0].tolist() for level in parts] == [[0, 1], [2], [3, 4], [5]]
    assert len(levels(study, tolerance=0.001)) == 6
    assert [level.left.sum() for level in levels(study, "row")] == [1] * 6


def test_groups_may_be_given(make_study: MakeStudy) -> None:
    """As lists of row numbers, of which only these are left out, or as a label for every row."""
    study = make_study()
    parts = levels(study, [[1, 3], [6]])
    assert [level.name for level in parts] == ["row 1, 3", "row 6"]
    assert [level.left.nonzero()[0].tolist() for level in parts] == [[0, 2], [5]]
    assert [level.name for level in levels(study, list("aabbccc"))] == ["a", "b", "c"]
    assert levels(study, list("aabbccc"))[2].left.nonzero()[0].tolist() == [4, 5]


@pytest.mark.parametrize(
    ("by", "tolerance", "message"),
    [
        ("slips", 0.03, r"'by' must be slip, wheel, load, row or groups of rows \(got 'slips'\) \(did"),
        ("wheel", 0.03, r"there must be two or more levels of 'wheel' \(got 1\)"),
        ("slip", 0.5, r"two or more levels of 'slip' \(got 1 at tolerance 0.5\)"),
        ("slip", -1.0, r"'tolerance' must not be negative \(got -1\)"),
        ([[7]], 0.03, r"'by' must hold numbers of rows in use \(got 7\)"),
        ([[1], [1, 2]], 0.03, r"'by' must name a row once \(row 1 is named twice\)"),
        (["a", "b"], 0.03, r"'by' must have one label for each of 7 rows \(got 2\)"),
        ([[1, 2, 3, 4, 5, 6]], 0.03, r"two or more groups of rows \(got 1\)"),
    ],
)
def test_bad_groups_are_refused(make_study: MakeStudy, by: Any, tolerance: float, message: str) -> None:
    """One line that says what must hold and what was got."""
    with pytest.raises(StudyError, match=message):
        levels(make_study(), by, tolerance)


def test_readings_of_a_left_out_row_are_not_seen(make_study: MakeStudy, found: Holdout) -> None:
    """Other readings in one level change nothing in what is predicted for it, model and baselines alike."""
    study = make_study()
    values = {name: study.observations.values[name].copy() for name in ("sinkage", "drawbar_pull")}
    values["sinkage"][2] += 0.02
    values["drawbar_pull"][2] = -40.0
    other = bt.leave_out(study.with_data(values), fit=on_grid).table
    keys, law = ["predictor", "row", "channel"], ["q05", "q25", "q50", "q75", "q95"]
    before, after = (t.set_index(keys).sort_index()[law] for t in (found.table, other))
    seen = before.index.get_level_values("row") == 3
    pd.testing.assert_frame_equal(before[seen], after[seen])
    assert not np.allclose(before[~seen], after[~seen])


def test_a_load_that_is_read_stays_known(make_study: MakeStudy) -> None:
    """With the drive ``both`` predictions follow the row's normal force, and no other reading of it."""
    study = make_study("both", load_range=["20 N", "160 N"])
    target, left = posterior(study), np.arange(7) == 2
    draws = np.radians(np.full((400, 1), 30.0))

    def predicted(**readings: float) -> np.ndarray:
        values = {name: study.observations.values[name].copy() for name in readings}
        for name, value in readings.items():
            values[name][2] = value
        law = predictives(study.with_data(values), target, draws, left, default_rng(1))
        assert law.channels == ("sinkage", "drawbar_pull")
        return law.centre[:, 0]

    as_read = predicted(normal_force=80.0)
    np.testing.assert_array_equal(as_read, predicted(normal_force=80.0, sinkage=0.03, drawbar_pull=90.0))
    heavier = predicted(normal_force=120.0)
    assert heavier[:, 0].min() > as_read[:, 0].max()
    # the spread is that of a load known to 1 N, through the model's slope at the two loads
    slope = (heavier[:, 0].mean() - as_read[:, 0].mean()) / 40.0
    assert as_read[:, 0].std() == pytest.approx(slope, rel=0.2)


def test_draws_without_an_answer_are_set_aside_and_counted(make_study: MakeStudy) -> None:
    """A sinkage offset aside, a draw that carries no wheel says nothing; too few answers are no law."""

    def some_fail(share: float) -> Any:
        def fit(study: Study, seed: SeedSequence) -> Fitted:
            draws = np.full((200, 1), 0.85)
            draws[: round(200 * share)] = -2.0  # N < 0: no answer at any slip
            return Fitted(draws, 200.0, 1.0, True)

        return fit

    held = {name: value for name, value in make_study().prior.fixed.items() if name != "n0"}
    free = {"dist": "uniform", "lower": -3.0, "upper": 2.0}
    study = make_study(priors={**held, "phi": 0.52, "n0": free})
    table = bt.leave_out(study, fit=some_fail(0.25)).table
    own = table[table["predictor"] == "M2"]
    assert (own["no_answer"] == 0.25).all()
    whole = bt.leave_out(study, fit=some_fail(0.0)).table
    np.testing.assert_allclose(own["crps"], whole[whole["predictor"] == "M2"]["crps"], rtol=1e-12)
    lost = bt.leave_out(study, fit=some_fail(0.95))
    own = lost.table[lost.table["predictor"] == "M2"]
    assert own["crps"].isna().all()
    assert not own["covered90"].any()
    summary = lost.summary.set_index(["predictor", "channel", "part"])
    assert summary.loc[("M2", "sinkage", "all"), "unscored"] == 6
    assert summary.loc[("M2", "sinkage", "all"), "covered90"] == 0


def test_only_slips_beyond_the_training_rows_are_extrapolated(found: Holdout) -> None:
    """The lowest and the highest level."""
    rows = found.table.drop_duplicates("row").set_index("row")["extrapolated"]
    assert rows.to_dict() == {1: True, 2: True, 3: False, 4: False, 5: False, 6: True}


def test_the_model_that_made_the_data_wins(found: Holdout) -> None:
    """Its scores are of the size of the noise, below every baseline's."""
    assert found.converged
    summary = found.summary[found.summary["part"] == "all"].set_index(["predictor", "channel"])
    expected = {"sinkage": 0.5 / np.sqrt(np.pi), "drawbar_pull": 1.0 / np.sqrt(np.pi)}  # E CRPS of N(0, σ²)
    for channel, size in expected.items():
        assert 0.3 * size < summary.loc[("M2", channel), "crps"] < 2.5 * size
    whole = found.skills[found.skills["part"] == "all"]
    for baseline, least in (("mean", 0.5), ("polynomial", 0.0)):
        assert (whole.loc[whole["baseline"] == baseline, "skill"] > least).all()


def test_errors_know_the_levels() -> None:
    """Rows that repeat each other count once; alone they give the plain standard error."""
    values = default_rng(3).normal(size=12)
    mean, alone = clustered(values, np.arange(12))
    assert (mean, alone) == pytest.approx((values.mean(), values.std(ddof=1) / np.sqrt(12)))
    assert clustered(np.repeat(values, 5), np.repeat(np.arange(12), 5)) == pytest.approx((mean, alone))
    assert np.isnan(clustered(values, np.zeros(12, dtype=np.int64))[1])


def test_skill_is_the_share_of_the_score_that_is_saved() -> None:
    """Half the score everywhere is a skill of one half, without spread; coverage is a mean."""
    rows = pd.DataFrame({"level": list("aabbc"), "row": range(5), "extrapolated": [False] * 4 + [True]})
    rows = rows.assign(channel="sinkage", unit="mm", log_score=0.0, covered50=False)
    model = rows.assign(predictor="M1", crps=[1.0, 2.0, 3.0, 4.0, 5.0], covered90=[True, True, True, True, False])
    table = pd.concat([model, model.assign(predictor="mean", crps=2 * model["crps"])])
    one = {row["part"]: row for row in skills(table, "M1").to_dict("records")}
    assert [one["all"][name] for name in ("skill", "skill_lo", "skill_hi")] == pytest.approx([0.5] * 3)
    assert [one["all"][name] for name in ("levels", "levels_won", "difference")] == [3, 3, -3.0]
    assert np.isnan(one["end"]["skill_lo"])
    assert summarise(table).set_index(["predictor", "part"]).loc[("M1", "all"), "covered90"] == 0.8


def test_a_failed_fit_is_named_and_costs_nothing_else(make_study: MakeStudy) -> None:
    """The level has no model rows, its baselines stay, and the page says so."""

    def fails_once(study: Study, seed: SeedSequence) -> Fitted:
        if not study.observations.use[2]:
            raise FloatingPointError("no such luck")
        return on_grid(study, seed)

    one = bt.leave_out(make_study(), fit=fails_once)
    assert not one.converged
    refit = one.refits.set_index("level").loc["slip 0.200"]
    assert (refit["status"], refit["note"]) == ("failed", "FloatingPointError: no such luck")
    counts = one.table.groupby("predictor")["row"].nunique()
    assert (counts["M2"], counts["polynomial"]) == (5, 6)
    with undrawn():
        page = one.page().html()
    assert "has <b>not converged</b> without slip 0.200" in page


def test_a_folder_holds_tables_plots_and_the_page(found: Holdout, tmp_path: Path) -> None:
    """All files, a page without foreign markup, numbers as in Python; not twice."""
    page = found.save(tmp_path / "out").read_text("utf-8")
    assert {path.name for path in (tmp_path / "out").iterdir()} == FILES
    assert "&lt;b&gt;made&lt;/b&gt;" in page
    assert "simulated data" in page
    stored = pd.read_csv(tmp_path / "out" / "scores.csv")
    np.testing.assert_allclose(stored["crps"], found.table["crps"], rtol=1e-5)
    record = json.loads((tmp_path / "out" / "holdout.json").read_text("utf-8"))
    assert Holdout.RECORD.read(tmp_path / "out" / Holdout.MARK) == record
    assert (record["by"], record["tolerance"], record["converged"]) == ("slip", 0.03, True)
    with pytest.raises(ResultError, match="exists already: add --overwrite"):
        found.save(tmp_path / "out")
    assert bt.load_study(tmp_path / "out").observations.use.sum() == 6


def test_the_command(make_study: MakeStudy, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    """It prints the scores, writes the folder and refuses mistakes in one line."""
    (tmp_path / "made").mkdir()
    write_study(make_study(), tmp_path / "made")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("bayesterra.checking.holdout.refits", lambda study: on_grid)
    with unpainted():
        assert main(["holdout", "made", "--by", "row", "--workers", "1", "--quiet"]) == 0
    printed = capsys.readouterr().out
    assert "6 levels left out, one at a time" in printed
    assert "polynomial" in printed
    assert {path.name for path in (tmp_path / "made-holdout").iterdir()} == FILES
    assert main(["holdout", "made"]) == 2
    assert "'made-holdout' exists already: add --overwrite" in capsys.readouterr().err
    assert main(["holdout", "made", "--by", "loads", "--out", "other"]) == 2
    error = capsys.readouterr().err
    assert error.startswith("error: 'by' must be slip, wheel, load, row")
    assert error.count("\n") == 1
    assert not (tmp_path / "other").exists()


def test_a_level_does_not_depend_on_the_others(make_study: MakeStudy, found: Holdout) -> None:
    """The task is picklable, and run alone it gives what it gave among all: any number of workers will do."""
    task = LeaveOneOut(found.study, found.levels, 1, on_grid)
    alone = pd.DataFrame(task(2).rows)
    among = found.table[found.table["level"] == found.levels[2].name].reset_index(drop=True)
    pd.testing.assert_frame_equal(alone, among)
    again = pickle.loads(pickle.dumps(LeaveOneOut(found.study, found.levels, 1, REFITS)))  # noqa: S301 (our own)
    assert again.fit == REFITS


@pytest.mark.parametrize(("drive", "tables"), [("load", 120), ("both", 60)])
def test_intervals_hold_what_they_state(make_study: MakeStudy, drive: str, tables: int) -> None:
    """Soils from the prior, readings from them, a level left out: coverage of exact posteriors is right.

    With ``both`` every table has loads of its own, which the left-out row tells by its normal force only.
    """
    given = {"load_range": ["40 N", "120 N"]} if drive == "both" else {}
    study = make_study(drive, **given)
    parts, pits = levels(study), list[float]()
    for number in range(tables):
        rng = default_rng([7, number])
        made, left = replicated(study, rng)[1], parts[number % len(parts)].left
        training = made.with_use(made.observations.use & ~left)
        draws = on_grid(training, SeedSequence(number), points=300).draws[::4]
        law = predictives(made, posterior(training), draws, left, rng)
        for row, place in enumerate(np.flatnonzero(left)):
            for column, channel in enumerate(law.channels):
                one = law.law(row, column)
                assert one is not None
                pits.append(float(one.cdf(made.observations.values[channel][[place]])[0]))
    found = np.array(pits)
    for level in (0.5, 0.9):
        inside = (np.abs(found - 0.5) <= 0.5 * level).mean()
        assert abs(inside - level) < 3 * np.sqrt(level * (1 - level) / len(found))


def test_rows_of_a_refit_are_those_that_it_was_scored_on(found: Holdout) -> None:
    """Numbers of the rows in the table of the refits and in that of the scores are the same."""
    scored = found.table.groupby("level")["row"].unique()
    for refit in found.refits.to_dict("records"):
        assert [int(row) for row in str(refit["rows"]).split()] == sorted(scored[refit["level"]])
