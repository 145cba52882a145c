"""Section 4 of the paper: its tables and statements remade now, the stored study checked."""

import importlib
import re
from collections.abc import Callable
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from readme import filled
from scripts import STUDIES, loaded
from sensitivity.groups import GROUPS
from sensitivity.responses import OUTCOMES

from bayesterra.models import SOIL_FIELDS

STUDY = STUDIES / "paper" / "sensitivity"
DIFFERS = [
    "Table 4: F_Nτ/F_N of G1 at slip 0.6 for six wheels, 35 to 150 N",
    "Fig. 5(b, c): F_DPσ is lower than F_DPτ",
    "Fig. 5(c): F_DPτ is influenced by P_II only",
    "Table 5: K of G1 is 25 mm (Table 7: 12 mm)",
    "Table 6: 24 errors (16) of z, F_DP, M_DR",
    "Table 8: 18 errors (16) of z, F_DP, M_DR",
    "Table 8, Fig. 10: P_III influences F_DP more than z and M_DR",
    "Fig. 10: with an increase in c3 z decreases and F_DP increases",
]


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("paper/sensitivity")


def stored(name: str) -> pd.DataFrame:
    """A result file of the study."""
    return pd.read_csv(STUDY / f"{name}.csv", keep_default_na=name == "sobol")


def numbers(texts: "pd.Series[str]") -> np.ndarray:
    """Every number that some texts hold."""
    return np.array([float(each) for each in re.findall(r"\d+\.?\d*", " ".join(texts))])


def test_the_tables_are_remade(script: ModuleType) -> None:
    """Every table and statement comes out as stored, to the digits that are stored."""
    for name, table in script.quick().items():
        found, kept = table.reset_index(drop=True), stored(name)
        assert list(found.columns) == list(kept.columns)
        for column in kept.select_dtypes("number"):
            np.testing.assert_allclose(found[column], kept[column], rtol=6e-4, atol=1e-6, err_msg=name)
        words = [column for column in kept.select_dtypes(exclude="number") if column != "ours"]
        pd.testing.assert_frame_equal(found[words], kept[words], check_dtype=False)
        if "ours" in kept and name == "index":
            np.testing.assert_allclose(numbers(found["ours"]), numbers(kept["ours"]), atol=0.11)


def test_short_sobol_runs_agree_with_the_stored_indices(script: ModuleType) -> None:
    """A run of 1024 draws over each law of the soil gives the stored indices within 4.5 standard errors."""
    kept = stored("sobol").set_index("box")
    for box in script.tables.BOXES:
        short, long = script.tables.sobol_table(box, 1024, seed=7), kept.loc[box]
        for name in ("first", "total"):
            error = np.hypot(short[f"{name}_error"].to_numpy(), long[f"{name}_error"].to_numpy())
            away = np.abs(short[name].to_numpy() - long[name].to_numpy())
            assert (away < 4.5 * error + 1e-4).all()


def test_the_readme_says_what_is_stored(script: ModuleType) -> None:
    """The tables of the README are those made from the stored files."""
    text = (STUDY / "README.md").read_text(encoding="utf-8")
    names = ("index", "table-4", "tables-6-8", "table-9", "sobol")
    assert filled(text, script.page.blocks({name: stored(name) for name in names})) == text


def test_the_headline_holds(script: ModuleType) -> None:
    """32 of 40 statements, 1 of 8, 57 of 63 and 9 of 9 values are reproduced; what differs is named."""
    index = stored("index")
    off = index[index["verdict"] == "differs"]
    assert sorted(off["place"] + ": " + off["statement"]) == sorted(DIFFERS)
    counts = {name: (stored(name)["verdict"] == "reproduced").sum() for name in ("table-4", "tables-6-8")}
    assert [len(index), *counts.values()] == [40, 1, 57]
    assert (stored("table-9")["verdict"] == "reproduced").all()
    assert script.tables.inside_with_k_of_25_mm() == 46


def test_explanations_of_what_differs() -> None:
    """Errors of z imply 28.8 to 29.3 mm measured, G17's 30.6 mm; its errors suit c1 of 0.29 to 0.335."""
    implied = stored("implied-sinkage").set_index("group")["implied_mm"]
    assert implied["G17"] == pytest.approx(30.62, abs=0.01)
    others = implied.drop("G17")
    assert len(others) == 11
    assert others.between(28.8, 29.3).all()
    deep = ["G3", "G5", "G7", "G18", "G19", "G20", "G21"]
    assert others[deep].max() < 29.05 < others.drop(deep).min()
    c1 = stored("c1-of-g17").query("inside")["c1"]
    assert [c1.min(), c1.max()] == pytest.approx([0.29, 0.335])


def test_moment_and_pull_answer_otherwise_over_the_box() -> None:
    """About G1 indices are in Table 9's order; over the box P_I leads in M_DR and P_III is last in F_DP."""
    table = stored("sobol")
    whole = table[table["slip"].isna()].set_index(["outcome", "parameter_group"])
    near, wide = (whole.loc[whole["box"] == box, "total"].to_dict() for box in ("near G1", "paper-box"))
    error = whole[["first_error", "total_error"]].to_numpy().max()
    assert near["resistance_moment", "P_II"] > 0.9 > 0.1 > near["resistance_moment", "P_I"]
    assert near["drawbar_pull", "P_III"] > 2 * near["drawbar_pull", "P_I"]
    assert wide["resistance_moment", "P_I"] > wide["resistance_moment", "P_II"] + 5 * error
    assert wide["drawbar_pull", "P_I"] > 5 * wide["drawbar_pull", "P_III"]
    assert error < 0.007
    assert table["unmatched"].max() == 0


def test_printed_tables_are_those_of_the_groups() -> None:
    """Soils and errors quoted from Tables 5 to 8 are the ones that the package holds."""
    printed = pd.read_csv(STUDY / "printed-tables-5-8.csv").set_index("group")
    assert list(printed.index) == list(GROUPS)
    for name, group in GROUPS.items():
        np.testing.assert_allclose(printed.loc[name].iloc[: len(SOIL_FIELDS)], group.values)
        np.testing.assert_allclose(printed.loc[name].iloc[-len(OUTCOMES) :] / 100, group.printed_errors)


def test_wrong_statements_are_not_confirmed(script: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the sinkage of a softer soil in place of a stiffer one, the statement on K_s no longer holds."""
    curves = importlib.import_module("section4_curves")
    monkeypatch.setitem(curve := curves.curve(0), "G6", curve["G7"])
    monkeypatch.setattr(script.soils, "curve", lambda i: curve if i == 0 else curves.curve(i))
    found = {each.statement: each.holds for each in script.soils.bearing_directions()}
    assert found["σ falls with n0 and n1"]
    assert not found["z increases with n0 and n1 and decreases with K_s"]


def test_every_study_can_be_remade() -> None:
    """Each folder of studies has its command and its line in the index."""
    remake = loaded(STUDIES / "remake.py")
    folders = {file.parent.relative_to(STUDIES).as_posix() for file in STUDIES.glob("*/**/README.md")}
    assert folders == {*remake.COMMANDS, *remake.NOTHING_TO_RUN}
    text = (STUDIES / "README.md").read_text(encoding="utf-8")
    assert all(f"[{name}]({name})" in text for name in folders)
    assert remake.commands("recovery/drives") == [[str(STUDIES / "recovery" / "drives" / "run.py")]]
    assert remake.main(["nothing"]) == 2
