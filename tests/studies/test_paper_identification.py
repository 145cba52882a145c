"""IM1, IM2 and IM3 beside the paper: rows of the stored study remade now, its page checked."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import paper_statements
import pytest
from readme import filled

STUDY = Path(__file__).parents[2] / "studies" / "paper" / "identification"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("paper/identification")


def stored(name: str) -> pd.DataFrame:
    """A result file of the study."""
    return pd.read_csv(STUDY / f"{name}.csv")


def agree(found: pd.DataFrame, kept: pd.DataFrame, keys: list[str], columns: list[str]) -> None:
    """Rows with the same keys have the same numbers, to the digits that are stored."""
    left, right = found.set_index(keys)[columns], kept.set_index(keys)[columns]
    np.testing.assert_allclose(left, right.loc[left.index], rtol=2e-4, atol=2e-4)


def test_fits_are_remade(script: ModuleType) -> None:
    """With K_s held every method gives the stored values and errors, on both kinds of readings."""
    found = script.fits.fits(("Wh22", "HIT"), holds=(True,))
    values = [*script.fits.NAMES, *(f"error_{name}" for name in script.fits.FORCES), "passes"]
    agree(found, stored("fits"), ["data", "Ks_held", "method"], values)
    agree(script.fits.paths(("Wh22",)), stored("paths"), ["data", "pass"], list(script.fits.NAMES))
    for name in ("predictions", "angles-held", "without-shear"):
        made = script.FITS[name]()
        agree(made, stored(name), ["data"], list(made.select_dtypes(float)))


@pytest.mark.slow
def test_the_papers_stiffness_is_remade(script: ModuleType) -> None:
    """By the paper's solver K_s of two wheels is the stored one, and all twelve are within 0.15 kPa of the print."""
    found = script.solver.fits(("Wh22",))
    agree(found, stored("solver-fits"), ["data", "method", "solver"], ["Ks", "n0", "n1", "passes"])
    kept = {"solver-fits": stored("solver-fits"), "fits": stored("fits")}
    for method, number in (("IM1", 10), ("IM3", 14)):
        assert script.statements.stiffness(kept, method, number).holds


def test_a_noise_seed_lies_in_the_stored_range(script: ModuleType) -> None:
    """The first seed gives values between the stored lowest and highest of ten, and most not at an end."""
    found = script.fits.scatter(("Wh22",), seeds=1)
    keys = ["noise", "data", "method", "quantity"]
    kept = stored("scatter").set_index(keys).loc[pd.MultiIndex.from_frame(found[keys])]
    away = 1e-3 * (1e-3 + kept[["least", "most"]].abs().to_numpy().max(axis=1))
    value = found["median"].to_numpy()
    assert (value > kept["least"] - away).all()
    assert (value < kept["most"] + away).all()
    assert (kept["seeds"] == 10).all()


def test_stops_follow_from_the_path(script: ModuleType) -> None:
    """Passes and cohesion for δ = 0.002 are those that IM1 itself gives."""
    stops = script.fits.stops(stored("paths")).set_index(["data", "delta"])
    fits = stored("fits").query("method == 'IM1' and Ks_held").set_index("data")
    early = stops.xs(0.002, level="delta")
    assert early["passes"].to_dict() == fits["passes"].to_dict()
    np.testing.assert_allclose(early["c"], fits.loc[early.index, "c"], rtol=1e-3)


@pytest.mark.slow
def test_a_posterior_agrees_with_the_stored_one(script: ModuleType) -> None:
    """M3 on HIT, K_s held, load drive: medians and evidence come out again."""
    case = script.posteriors.Case("HIT", False, "M3", "load", True)
    found = script.posteriors.infer(case.study, loo=False)
    keys = {"data": "HIT", "model": "M3", "drive": "load", "Ks_held": True}
    table = stored("posteriors")
    kept = table[np.all([table[name] == value for name, value in keys.items()], axis=0)]
    made = found.summary()
    away = (made["median"].to_numpy() - kept["median"].to_numpy()) / kept["sd"].to_numpy()
    assert list(made["parameter"]) == list(kept["parameter"])
    assert np.abs(away).max() < 0.1
    table = stored("comparison")
    log_z = table[np.all([table[name] == value for name, value in keys.items()], axis=0)]["log_z"].iloc[0]
    assert found.evidence.log_z == pytest.approx(log_z, abs=0.05)


def test_differences_are_those_of_leave_one_out(script: ModuleType) -> None:
    """A model that predicts each of five rows better by 1 to 2 is told apart, one that does by 0.1 is not."""
    rows = [
        {"data": "HIT", "Ks_held": True, "model": model, "log_z": 7.0, "by_row": by_row}
        for model, by_row in (("M1", (0.0,) * 5), ("M2", (1.0, 2.0, 1.5, 1.0, 2.0)), ("M3", (0.1,) * 5))
    ]
    table = script.posteriors.less_first(pd.DataFrame(rows)).set_index("model")
    assert table["elpd_less_M1"].tolist() == pytest.approx([0.0, 7.5, 0.5])
    assert table["distinguishable"].tolist() == [False, True, False]
    assert table.loc["M2", "difference_se"] == pytest.approx(np.sqrt(5) * np.std([1, 2, 1.5, 1, 2], ddof=1))


def test_all_posteriors_converged() -> None:
    """Every sampling passed its checks, every evidence its own."""
    assert stored("posteriors")["converged"].all()
    assert stored("comparison")[["converged", "reliable"]].all(axis=None)


def test_statements_and_readme_follow_from_the_tables(script: ModuleType) -> None:
    """Statements and the README's tables are those that the stored tables give."""
    kept = script.stored()
    found = paper_statements.table_of(script.statements.statements(kept))
    pd.testing.assert_frame_equal(found, paper_statements.read(STUDY), check_dtype=False)
    text = (STUDY / "README.md").read_text(encoding="utf-8")
    assert filled(text, script.page.blocks(kept, found)) == text


def test_a_table_that_differs_turns_a_verdict(script: ModuleType) -> None:
    """With fit errors of 6 % the statement that all are below 5 % no longer holds."""
    kept = script.stored()
    worse = kept["solver-fits"].assign(error_drawbar_pull=6.0)
    verdicts = [
        {each.statement: each.holds for each in script.statements.fig_18(tables)}
        for tables in (kept, {**kept, "solver-fits": worse})
    ]
    turned = [name for name in verdicts[0] if verdicts[0][name] and not verdicts[1][name]]
    assert turned == ["all methods fit well: every error of IM2 below 5 % (noise-free readings)"]
