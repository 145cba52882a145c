"""Cells such as ``<1.5``, and readings with a resolution, in tables and study files."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayesterra import fit, load_study, simulate
from bayesterra.errors import StudyError
from bayesterra.follow.rows import Rows
from bayesterra.study.canonical import identity, write_study
from bayesterra.study.noise import Noise
from bayesterra.study.study import Study
from tests.support.one_wheel import MakeStudy, MakeTable

PULL, SINKAGE = "drawbar_pull [N]", "sinkage [mm]"
FREE = ("n0", "K", "phi")


@pytest.fixture(name="table")
def fixture_table(make_table: MakeTable) -> pd.DataFrame:
    """Readings in millimetres and newtons as text, two pulls known by a limit."""
    table = make_table().rename(columns={"sinkage [m]": SINKAGE})
    pulls = [f"{value:.1f}" for value in table[PULL]]
    pulls[0], pulls[5] = "<1.5", "> 20"
    table[SINKAGE], table[PULL] = 1e3 * table[SINKAGE], pulls
    return table


def test_cells_may_hold_a_limit(make_study: MakeStudy, table: pd.DataFrame) -> None:
    """Below and above; the value is the limit, and a note names the rows."""
    study = make_study(data=table, free=FREE)
    rows = study.observations
    assert rows.limited("drawbar_pull").tolist() == [True, False, False, False, False, True]
    assert rows.values["drawbar_pull"][[0, 5]].tolist() == [1.5, 20.0]
    np.testing.assert_array_equal(rows.limits["drawbar_pull"][0], [1.5, np.inf])
    np.testing.assert_array_equal(rows.limits["drawbar_pull"][5], [-np.inf, 20.0])
    assert not rows.limited("sinkage").any()
    assert rows.marks("drawbar_pull") == ("<", "", "", "", "", ">")
    note = "drawbar_pull is known to lie below or above a limit only in rows 1, 6"
    assert note in study.notes
    assert rows.take(np.arange(6) > 2).limited("drawbar_pull").tolist() == [False, False, True]


def test_a_limit_from_the_tip_of_the_lugs_is_moved_to_the_rim(make_study: MakeStudy, table: pd.DataFrame) -> None:
    """As readings are."""
    cells = [f"{value + 10:.6f}" for value in table[SINKAGE]]
    cells[2] = f"<{cells[2]}"
    study = make_study(data=table.assign(**{SINKAGE: cells}), free=FREE, sinkage_reference="tip")
    rows = study.observations
    assert rows.limited("sinkage").tolist() == [False, False, True, False, False, False]
    assert rows.limits["sinkage"][2, 0] == rows.values["sinkage"][2]
    lug = study.wheels["Wh32"].lug_height
    assert rows.values["sinkage"][2] == pytest.approx(1e-3 * (float(table[SINKAGE][2]) + 10) - lug, abs=1e-9)


@pytest.mark.parametrize(
    ("column", "cells", "options", "message"),
    [
        (PULL, ["<"], {}, r"'drawbar_pull' must be a number or empty \(got '<', row 1\)"),
        (PULL, ["<two"], {}, r"'drawbar_pull' must be a number or empty \(got 'two', row 1\)"),
        ("load [N]", ["<80"], {}, r"'load' must be a number or empty \(got '<80', row 1\)"),
        ("slip", ["<0.1"], {}, r"'slip' must be a number or empty \(got '<0.1', row 1\)"),
        (
            SINKAGE, ["<9"], {"drive": "sinkage"},
            r"'sinkage' must be a number where the drive conditions on it \(a limit in row 1\)",
        ),
        (
            "normal_force [N]", [">79"], {"drive": "both"},
            "the drive 'both' needs 'load_range' where a normal force is known by a limit",
        ),
    ],
)  # fmt: skip
def test_a_limit_where_none_can_stand_is_refused(
    column: str, cells: list[str], options: dict[str, object], message: str, make_study: MakeStudy, table: pd.DataFrame
) -> None:
    """With the row and what would do."""
    if options.get("drive") == "both":
        table = table.assign(**{PULL: 5.0, "normal_force [N]": 80.0})
    texts = [*cells, *map(str, table[column][len(cells) :])]
    with pytest.raises(StudyError, match=message):
        make_study(data=table.assign(**{column: texts}), free=FREE, **options)


def test_a_saved_study_keeps_limits_and_resolution(make_study: MakeStudy, table: pd.DataFrame, tmp_path: Path) -> None:
    """Read back it is the same study; another limit or step makes another one, which is named."""
    noise = {"sinkage": Noise("sinkage", sd=1e-3, resolution=5e-4)}
    study = make_study(data=table, free=FREE, noise=noise)
    write_study(study, tmp_path)
    assert 'resolution = "' in (tmp_path / "study.toml").read_text(encoding="utf-8")
    assert "<1.5" in (tmp_path / "measurements.csv").read_text(encoding="utf-8")
    again = load_study(tmp_path)
    assert again.fingerprint == study.fingerprint
    assert again.noise["sinkage"].resolution == 5e-4
    np.testing.assert_array_equal(
        again.observations.limited("drawbar_pull"), study.observations.limited("drawbar_pull")
    )
    number = make_study(data=table.assign(**{PULL: [1.5, *table[PULL][1:]]}), free=FREE, noise=noise)
    finer = make_study(data=table, free=FREE, noise={"sinkage": Noise("sinkage", sd=1e-3, resolution=1e-4)})
    assert number.fingerprint["data"] != study.fingerprint["data"]
    assert finer.fingerprint["study"] != study.fingerprint["study"]
    ours, theirs = (identity(one, 1) for one in (study, number))
    assert ours["lower limit of drawbar_pull {} in row 1"] == "1.5 N"
    assert theirs["lower limit of drawbar_pull {} in row 1"] is None


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"sd": "1 mm", "resolution": "-1 mm"}, "'resolution' of 'sinkage' must be at least 1e-15 in SI units"),
        ({"sd": "1 mm", "resolution": "1 N"}, "'sinkage.resolution': the unit 'N' is not a unit of length"),
        ({"resolution": "1 mm"}, "'sinkage' must be"),
    ],
)
def test_a_resolution_must_be_a_length_beside_a_noise(
    entry: dict[str, object], message: str, make_study: MakeStudy, table: pd.DataFrame
) -> None:
    """In the unit of its channel, positive, and no noise by itself."""
    with pytest.raises(StudyError, match=message):
        make_study(data=table, free=FREE, noise={"sinkage": entry})


def test_simulated_tables_show_what_an_instrument_would(make_study: MakeStudy, table: pd.DataFrame) -> None:
    """Steps of the sinkage, and a limit where the pull is beyond it."""
    study = make_study(data=table, free=FREE, noise={"sinkage": Noise("sinkage", sd=1e-3, resolution=1e-3)})
    made = simulate(study, seed=3, truth={"n0": 0.8, "K": 0.01, "phi": 0.5})
    steps = (made[SINKAGE] - table[SINKAGE].to_numpy()).to_numpy(dtype=float)
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)
    limited = [cell for cell in made[PULL] if isinstance(cell, str)]
    assert set(limited) <= {"<1.5", ">20.0"}
    assert ">20.0" in limited
    assert isinstance(make_study(data=made, free=FREE), Study)


def test_least_squares_has_no_residual_of_a_limit(make_study: MakeStudy, table: pd.DataFrame) -> None:
    """The fit is that without these readings."""
    empty = [None, *table[PULL][1:5], None]
    limited, without = (
        fit(make_study(data=data, free=FREE), ("joint",))["joint"].identified()
        for data in (table, table.assign(**{PULL: empty}))
    )
    assert limited == without


def test_rows_one_by_one_keep_their_limits(make_study: MakeStudy, table: pd.DataFrame) -> None:
    """In the store of a stream, whose digest knows them, and where rows follow others."""
    whole = make_study(data=table, free=FREE).observations
    store, plain = (Rows(("Wh32",), ("sinkage", "drawbar_pull")) for _ in range(2))
    store.append(whole)
    plain.append(replace(whole, limits={}))
    halves = whole.take(np.arange(6) < 3), whole.take(np.arange(6) >= 3)
    numbers = replace(halves[1], limits={})
    for rows in (store.first(), halves[0].followed_by(halves[1])):
        np.testing.assert_array_equal(rows.limited("drawbar_pull"), whole.limited("drawbar_pull"))
        assert rows.marks("drawbar_pull") == whole.marks("drawbar_pull")
    assert halves[0].followed_by(numbers).limited("drawbar_pull").tolist() == [True, *[False] * 5]
    assert store.digest != plain.digest
