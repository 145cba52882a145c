"""The stored study of logs: what its README says follows from its tables, and its scripts make the tables."""

from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scripts import STUDIES, loaded

from bayesterra.reduce.reduction import reduce_logs

STORED = STUDIES / "logs"


@pytest.fixture(scope="module")
def run() -> ModuleType:
    """The script of the study."""
    return loaded(STORED / "run.py")


def stored(name: str) -> pd.DataFrame:
    """A table of the study."""
    return pd.read_csv(STORED / f"{name}.csv")


def test_a_fixed_window_meets_the_authors_averages(run: ModuleType) -> None:
    """Speeds to 0.02 mm/s and sinkages to 0.002 mm, made again from the records; the locked wheel's rim aside."""
    trials = pd.read_csv(STORED / "measured" / "drive_trials.csv")
    assert len(trials) == 10
    for trial in trials.to_dict("records"):
        log = pd.read_parquet(STORED / "measured" / trial["file"])
        mean = log[log["time [s]"].between(*run.FIXED)].mean()
        assert 1e3 * mean["travel_speed [m/s]"] == pytest.approx(trial["travel_speed [mm/s]"], abs=0.002)
        assert mean["sinkage [mm]"] == pytest.approx(trial["sinkage [mm]"], abs=0.0002)
        if trial["slip_ratio"] > -1:
            assert 1e3 * mean["rim_speed [m/s]"] == pytest.approx(trial["rim_speed [mm/s]"], abs=0.02)


def test_windows_of_its_own_meet_them_too() -> None:
    """Sinkages to three stated errors and 0.25 mm; windows overlap; every row says what was rejected."""
    table = stored("drives")
    off = (table["sinkage_reduce"] - table["sinkage_authors"]).abs()
    assert (off < 0.25).all()
    assert (off < 3 * table["sinkage_sd"]).all()
    assert ((table["slip_reduce"] - table["slip_authors"]).abs() < 0.003).all()
    assert (table["from"] < table["authors_from"]).all()
    assert (table["to"] > table["authors_to"]).all()
    assert table["rejected"].str.contains("settling").all()


@pytest.mark.parametrize("index", [0, 7])
def test_rows_of_drives_are_what_reduce_makes(index: int, run: ModuleType) -> None:
    """Of two records, today."""
    row = stored("drives").iloc[index]
    (window,) = reduce_logs([STORED / "measured" / f"drive_{row['log']}.parquet"], **run.CMU).kept
    made = [1e3 * window.mean["sinkage"], 1e3 * window.sd["sinkage"], window.mean["slip"], window.start, window.end]
    assert_allclose(made, row[["sinkage_reduce", "sinkage_sd", "slip_reduce", "from", "to"]].astype(float), rtol=1e-5)


def test_stated_errors_hold_the_means_of_simulated_logs(run: ModuleType) -> None:
    """At least 95 % inside two; deviations are as large as errors say, where sd/√n is five times too small and more."""
    table = stored("simulated")
    assert table["log"].nunique() == run.LOGS
    assert len(table) > 0.97 * run.LOGS * 8
    assert run.inside(table, "sd") > 0.95
    assert run.inside(table, "naive") < 0.25
    for _, group in table.groupby("channel"):
        figures = run.figures(group)
        assert figures["inside two stated errors"] > 0.94
        assert 0.65 < figures["off / stated error"] < 1.05
        assert figures["off / (sd/√n)"] > 5


def test_simulated_logs_are_made_again(run: ModuleType) -> None:
    """The first two of them, to the digits of the table."""
    first = stored("simulated").query("log < 2")
    again = run.simulated(run.LOGS, only=2)
    assert_allclose(again[["mean", "sd", "naive"]], first[["mean", "sd", "naive"]], rtol=1e-5)


def test_insertions_meet_the_authors_loads(run: ModuleType) -> None:
    """With contact and window found instead of chosen by hand: within 5 % and 1 N."""
    table = run.loads_at_depth()
    assert len(table) == 12
    assert (np.abs(table["reduce"] - table["authors"]) < 0.05 * table["authors"] + 1).all()


def test_plates_of_one_area_tell_the_exponent_only() -> None:
    """All parameters converged; the moduli are structurally not determined."""
    table = stored("plates")
    assert (table["r_hat"] < 1.01).all()
    for test, group in table.groupby("test"):
        verdicts = group.set_index("parameter")["verdict"]
        assert verdicts[["kc", "kphi"]].tolist() == ["structurally not determined"] * 2, test
        assert verdicts["n"] == "determined"
    assert len(pd.read_csv(STORED / "cullinan.csv")["test"].unique()) == 13


def test_the_readme_holds_these_tables(run: ModuleType) -> None:
    """As the script fills them in."""
    text = Path(STORED / "README.md").read_text(encoding="utf-8")
    assert run.filled(text, run.tables()) == text


@pytest.mark.slow
def test_drives_are_made_again(run: ModuleType) -> None:
    """All of them."""
    numbers = run.drives().select_dtypes("number")
    assert_allclose(numbers, stored("drives")[numbers.columns], rtol=1e-5, atol=1e-9)
