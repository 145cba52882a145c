"""The stored study: part of it made again, and the README's tables and words held against its files."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

import bayesterra as bt
from bayesterra.checking.folds import LeaveOneOut, levels
from bayesterra.checking.holdout_scores import BASELINES, clustered
from bayesterra.checking.short_runs import ShortRuns
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study

STUDIES = Path(__file__).parents[2] / "studies"
STUDY = STUDIES / "misfit" / "leave-slip-out"
KEYS = ["predictor", "row", "channel"]


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script."""
    return study_script("misfit/leave-slip-out")


def stored(name: str) -> pd.DataFrame:
    """Scores of one of the measured studies."""
    table = pd.read_csv(STUDY / "scores.csv")
    return table[table["study"] == name].set_index(KEYS)


def test_baselines_come_out_again() -> None:
    """Every baseline at every left-out row of the CMU set, to the digits of the file."""

    def no_fit(study: Study, seed: np.random.SeedSequence) -> None:
        raise FloatingPointError("baselines only")

    study = bt.load_study(STUDIES / "cmu-grouser")
    parts = levels(study)
    task = LeaveOneOut(study, parts, 1, no_fit)  # type: ignore[arg-type]
    made = pd.DataFrame([row for i in range(len(parts)) for row in task(i).rows]).set_index(KEYS)
    assert set(made.index.get_level_values("predictor")) == set(BASELINES)
    for column in ("q05", "q50", "q95", "crps", "pit"):
        before = stored("cmu-grouser").loc[made.index, column]
        np.testing.assert_allclose(made[column], before, rtol=2e-3, atol=2e-4)


@pytest.mark.slow
def test_one_level_of_the_hit_wheel_comes_out_again() -> None:
    """M1 without slip 0.3, by a short run: stored medians and intervals within Monte Carlo error."""
    study = bt.load_study(STUDIES / "hit-wh32")
    parts = levels(study)
    quick = ShortRuns(short=SamplingOptions(target_ess=400, walkers=64, max_steps=200))
    made = pd.DataFrame(LeaveOneOut(study, parts, 5, quick)(2).rows).set_index(KEYS)
    made = made[made.index.get_level_values("predictor") == "M1"]
    before = stored("hit-wh32").loc[made.index]
    width = before["q95"] - before["q05"]
    for column in ("q05", "q50", "q95"):
        assert (np.abs(made[column] - before[column]) < 0.08 * width).all()


def test_every_refit_converged() -> None:
    """No score rests on a sampling that failed."""
    assert (pd.read_csv(STUDY / "refits.csv")["status"] == "converged").all()
    assert (pd.read_csv(STUDY / "simulated.csv")["status"] == "converged").all()


def test_coverage_is_right_where_the_model_is(script: ModuleType) -> None:
    """On tables that M1 made its intervals hold what they state, within three standard errors."""
    table = pd.read_csv(STUDY / "exact.csv")
    assert (table["data"] == "simulated").all()
    for level in (0.5, 0.9):
        inside = (np.abs(table["pit"].to_numpy(np.float64) - 0.5) <= 0.5 * level).astype(np.float64)
        share, error = clustered(inside, table["table"].to_numpy())
        assert abs(share - level) < 3 * error < 0.05
    found = script.simulated_coverage().set_index(["predictor", "channel"]).loc[("M1", "all")]
    assert (pd.read_csv(STUDY / "simulated.csv")["data"] == "simulated").all()
    assert abs(found["covered90"] - 0.9) < 3 * found["covered90_se"]


def test_the_files_hold_what_the_readme_says(script: ModuleType) -> None:
    """Every table of the README follows from scores.csv and simulated.csv, and so do summary and skills."""
    text = (STUDY / "README.md").read_text(encoding="utf-8")
    for lines in script.readme_tables().values():
        assert "\n".join(lines) in text
    for name, made in (("summary", script.summary()), ("skills", script.skill())):
        before = pd.read_csv(STUDY / f"{name}.csv")
        pd.testing.assert_frame_equal(before, made, rtol=2e-3, atol=1e-6, check_dtype=False)


def test_the_quick_way_of_a_run_agrees_with_full_fits(script: ModuleType) -> None:
    """Coverage of five cases, reading by reading; the README's table is counted from both files."""
    table = script.beside_refits()
    assert list(table["readings"]) == [26, 15, 26, 15, 15]
    assert (table["differ"] == 0).all()
    assert (table["apart"] < 0.03).all()
    text = (STUDY / "README.md").read_text(encoding="utf-8")
    for row in table.to_dict("records"):
        cells = (row["readings"], row["quick"], row["full"], f"{100 * float(row['apart']):.1f} %")
        assert " | ".join(["| " + f"{row['study']}, {row['model']}", *map(str, cells)]) in text


@pytest.mark.slow
def test_the_quick_way_is_made_again(script: ModuleType) -> None:
    """One case: the same readings inside, the same quantiles, as far as other draws can tell.

    Over six seeds the ends of bands differ from the stored ones by up to 0.17 of their width, medians by 0.05.
    """
    found = pd.DataFrame(bt.run(script.study("hit-wh32", "M2")).record["levels"])
    found = found[(found["by"] == "slip") & (found["predictor"] == "M2")].reset_index(drop=True)
    before = pd.read_csv(STUDY / "quick.csv").query("study == 'hit-wh32' and model == 'M2'").reset_index(drop=True)
    width = before["q95"] - before["q05"]
    for column, most in (("q05", 0.25), ("q50", 0.1), ("q95", 0.25)):
        assert (np.abs(found[column] - before[column]) < most * width).all()
    edge = np.minimum(np.abs(before["observed"] - before["q05"]), np.abs(before["observed"] - before["q95"]))
    clear = edge > 0.25 * width
    assert clear.mean() > 0.5
    assert list(found["covered90"][clear]) == list(before["covered90"][clear])
