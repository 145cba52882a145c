"""Constant exponent, R_j = r and R_j = R: rows of the stored study remade now, its page checked."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import paper_statements
import pytest
from readme import filled

from bayesterra.models import M2

STUDY = Path(__file__).parents[2] / "studies" / "paper" / "variants"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("paper/variants")


def stored(name: str) -> pd.DataFrame:
    """A result file of the study."""
    return pd.read_csv(STUDY / f"{name}.csv")


def agree(found: pd.DataFrame, kept: pd.DataFrame, keys: list[str], columns: list[str]) -> None:
    """Rows with the same keys have the same numbers, to the digits that are stored."""
    left, right = found.set_index(keys)[columns], kept.set_index(keys)[columns]
    np.testing.assert_allclose(left, right.loc[left.index], rtol=1e-3, atol=1e-3)


@pytest.mark.slow
def test_fits_are_remade(script: ModuleType) -> None:
    """IM2 gives the stored values of Tables 11 to 13 again, the joint fit the stored misfits."""
    columns = ["printed_Ks", "printed_n", "Ks", "n", "error", "Ks_bounded", "n_bounded", "error_bounded"]
    agree(script.fits.table_11(("HIT",), seeds=1), stored("table-11"), ["data"], columns)
    made = script.fits.tables_12_13(("HIT",), seeds=1)
    agree(made, stored("tables-12-13"), ["table", "data", "quantity"], ["printed", "ours", "error_of_printed"])
    found = script.fits.load_fits(("HIT",), models=("M2",))
    agree(found, stored("load-fits"), ["data", "variant", "model"], ["chi2", "error_sinkage"])


def test_printed_values_are_those_of_the_errata(script: ModuleType) -> None:
    """Refitting Wh11 gives 13.8 kPa with n ≥ 0, and 1.51 kPa with −0.517 with n free."""
    first = script.fits.table_11(("Wh11",), seeds=1).iloc[0]
    assert first["Ks_bounded"] == pytest.approx(13.8, abs=0.05)
    assert first["n_bounded"] == pytest.approx(0.0, abs=1e-6)
    assert [first["Ks"], first["n"]] == pytest.approx([1.51, -0.517], abs=0.005)


def test_the_grid_solves_what_the_model_solves(script: ModuleType) -> None:
    """Sinkage, pull and moment from the grid of sinkages are M2's own where N is positive."""
    wheel = script.loads.RIGS["Wh32"]
    slip, soil = (
        np.array([0.1, 0.3, 0.6]),
        script.loads.im2(script.fits.study_of("Wh32", script.fits.REFERENCE), Ks=1e5).soil,
    )
    model = M2(transition_slips=(0.1, 0.5))
    depth = model.sinkage(soil, wheel, slip, 80.0)
    forces = model.forces(soil, wheel, slip, depth)
    expected = np.column_stack([depth, forces.drawbar_pull, forces.resistance_moment])
    grid = script.loads.Grid.of(wheel, slip)
    found = grid.response(soil.as_array(), np.full(3, 80.0))
    np.testing.assert_allclose(found, expected, rtol=2e-3)
    sinking = np.array([1.0e3, -0.6, 0.0, *soil.as_array()[3:]])
    assert np.isnan(grid.response(sinking, np.full(3, 30.0))).all()


def test_below_zero_meets_the_package(script: ModuleType) -> None:
    """With n ≥ 0 the grid's best fit is the package's; letting n fall below 0 does not better it."""
    grid = stored("below-zero").set_index(["data", "lowest_n"])["chi2"]
    joint = stored("load-fits").query("model == 'M2' and variant == 'constant n'").set_index("data")["chi2"]
    for data in joint.index:
        assert grid[data, 0.0] == pytest.approx(joint[data], rel=1e-3)
        assert grid[data, -0.999] == pytest.approx(joint[data], rel=1e-3)


@pytest.mark.slow
def test_evidence_agrees_with_the_stored_one(script: ModuleType) -> None:
    """The constant exponent on HIT, M2: the evidence comes out again; all samplings converged."""
    table = stored("comparison")
    assert table[["converged", "reliable"]].all(axis=None)
    kept = table.query("data == 'HIT' and model == 'M2' and variant == 'constant n'").iloc[0]
    given = script.fits.study_of("HIT", "constant n", model="M2", priors=script.fits.PRIORS)
    found = script.posteriors.infer(given, seed=2, loo=False)
    assert found.evidence.log_z == pytest.approx(kept["log_z"], abs=0.1)


def test_statements_and_readme_follow_from_the_tables(script: ModuleType) -> None:
    """Statements and the README's tables are those that the stored tables give."""
    kept = script.stored()
    found = paper_statements.table_of(script.statements.statements(kept))
    pd.testing.assert_frame_equal(found, paper_statements.read(STUDY), check_dtype=False)
    text = (STUDY / "README.md").read_text(encoding="utf-8")
    assert filled(text, script.page.blocks(kept, found)) == text
