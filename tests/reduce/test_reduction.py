"""Reduction of logs: windows of drives with their errors, loading branches of plates, what is written."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from simulated_drives import LUGS, RADIUS, STATES, SimulatedDrive, simulated_drive

from bayesterra.errors import ResultError, StudyError
from bayesterra.models import Wheel
from bayesterra.reduce.reduction import Reduction, reduce_logs
from bayesterra.reduce.windows import slip_of
from bayesterra.study.observations import observations, read_table

WHEEL: dict[str, Any] = {"radius": f"{RADIUS} m", "lugs": LUGS}


@pytest.fixture(scope="module")
def drive() -> SimulatedDrive:
    """A simulated drive of two states."""
    return simulated_drive(np.random.default_rng(5), ((0.1, 50.0), (0.4, 45.0)))


@pytest.fixture
def write(tmp_path: Path) -> Callable[..., Path]:
    """Write a table as a log."""

    def written(table: pd.DataFrame, name: str = "log.csv", **how: Any) -> Path:
        table.to_csv(tmp_path / name, index=False, **how)
        return tmp_path / name

    return written


def plate(loop: bool = True, air: int = 200) -> pd.DataFrame:
    """A plate test: lowered through air, pressed into a soil of 40 kPa/mm^0.8, unloaded once and at the end."""
    rng = np.random.default_rng(2)
    down = np.concatenate([np.linspace(0, 10, 400), np.linspace(10, 20, 400), np.full(60, 20.0)])
    force = 40 * np.maximum(down, 0) ** 0.8
    if loop:
        force[395:430] *= np.concatenate([np.linspace(1, 0.2, 18), np.linspace(0.2, 1, 17)])
    force[800:] *= np.linspace(1, 0, 60)
    depth = np.concatenate([np.linspace(-8, 0, air, endpoint=False), down])
    both = np.concatenate([np.zeros(air), force]) + 0.5 * rng.standard_normal(air + len(down)) - 3.0
    return pd.DataFrame({"sinkage [mm]": depth + 1.5, "force [N]": both})


def test_slip_follows_equation_3() -> None:
    """Driving by the rim, braking by the travel speed; derivatives as differences."""
    assert slip_of(0.8, 1.0)[0] == pytest.approx(0.2)
    assert slip_of(1.0, 0.8)[0] == pytest.approx(-0.2)
    assert slip_of(-0.8, -1.0)[0] == pytest.approx(0.2)
    assert slip_of(-1.0, -0.8)[0] == pytest.approx(-0.2)
    for travel, rim in ((0.8, 1.0), (1.0, 0.8), (-0.8, -1.0)):
        by_travel, by_rim = slip_of(travel, rim)[1]
        assert by_travel == pytest.approx((slip_of(travel + 1e-6, rim)[0] - slip_of(travel, rim)[0]) / 1e-6, rel=1e-4)
        assert by_rim == pytest.approx((slip_of(travel, rim + 1e-6)[0] - slip_of(travel, rim)[0]) / 1e-6, rel=1e-4)


def test_every_state_gives_a_row_with_its_means(drive: SimulatedDrive, write: Callable[..., Path]) -> None:
    """Within three standard errors, which are several times those of independent samples."""
    path = write(drive.table)
    reduction = reduce_logs([path], **WHEEL)
    first, second = reduction.kept
    assert first.period == pytest.approx(2 * np.pi * RADIUS / LUGS / (0.012 / 0.9), rel=0.01)
    table = reduction.tables()["measurements"]
    assert_allclose(table["slip"], [slip for slip, _ in STATES], atol=0.002)
    for name, means in drive.truth.items():
        sd = table[name.replace(" [", "_sd [")]
        assert (np.abs(table[name] - np.array(means)) < 3 * sd).all(), name
        key, scale = name.split(" [")[0], 1e-3 if "[mm]" in name else 1.0
        assert_allclose(sd, [window.sd[key] / scale for window in reduction.kept], rtol=1e-5)
        assert (sd < 0.05 * table[name]).all(), name
    time = drive.table["time [s]"]
    inside = drive.table["drawbar_pull [N]"][(time >= second.start) & (time <= second.end)]
    assert second.sd["drawbar_pull"] > 3 * inside.std() / np.sqrt(len(inside))
    assert [window.rejected.split(":")[0] for window in reduction.windows] == [
        "wheel and carriage stand still",
        "settling",
        "",
        "settling",
        "",
    ]
    assert table["# kind"].tolist() == ["simulated", "simulated"]


def test_what_is_written_is_read_as_measurements(
    drive: SimulatedDrive, write: Callable[..., Path], tmp_path: Path
) -> None:
    """Rows with their errors, remarks left alone; the page beside it; nothing is replaced."""
    reduction = reduce_logs([write(drive.table)], **WHEEL)
    reduction.save(tmp_path / "m.csv")
    rows = observations(read_table(tmp_path / "m.csv"), {"W": Wheel(RADIUS, 0.1)}, slip_reference="rim")
    assert len(rows) == 2
    assert not np.isnan(rows.given_sd["resistance_moment"]).any()
    page = (tmp_path / "m.html").read_text()
    assert "simulated data" in page
    assert "stand still" in page
    assert "data:image/svg+xml" in page
    with pytest.raises(ResultError, match=r"m\.html' exists already and is not overwritten: give another name"):
        reduction.save(tmp_path / "m.csv")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["log.csv", "m.csv", "m.html"]


def test_angular_speed_and_position_give_the_same(drive: SimulatedDrive, write: Callable[..., Path]) -> None:
    """rad/s with a radius instead of the rim's speed, the carriage's place instead of its speed."""
    table = drive.table.copy()
    table["omega [rad/s]"] = table.pop("rim_speed [mm/s]") / 1e3 / RADIUS
    table["position [m]"] = np.cumsum(table.pop("travel_speed [mm/s]")) / 1e5
    rows = reduce_logs([write(table)], **WHEEL).tables()["measurements"]
    assert_allclose(rows["slip"], [slip for slip, _ in STATES], atol=0.003)
    with pytest.raises(StudyError, match="'wheel_speed' needs the radius that slip is to be on: --radius"):
        reduce_logs([write(table)])


def test_zero_records_are_subtracted(drive: SimulatedDrive, write: Callable[..., Path]) -> None:
    """Of forces and moments, not of speeds or sinkage."""
    rng = np.random.default_rng(0)
    offset = drive.table.assign(**{"drawbar_pull [N]": drive.table["drawbar_pull [N]"] - 42})
    zero = pd.DataFrame(
        {"time [s]": np.arange(1000) / 100, "drawbar_pull [N]": -42 + rng.standard_normal(1000), "sinkage [mm]": 5.0}
    )
    log, record = write(offset), write(zero, "zero.csv")
    plain = reduce_logs([write(drive.table, "plain.csv")], **WHEEL).tables()["measurements"]
    rows = reduce_logs([log], zero=record, **WHEEL)
    ((name, (mean, error)),) = rows.logs[0].zeros.items()
    assert name == "drawbar_pull"
    assert mean == pytest.approx(-42, abs=4 * error)
    assert_allclose(rows.tables()["measurements"]["drawbar_pull [N]"], plain["drawbar_pull [N]"], atol=4 * error)
    assert_allclose(rows.tables()["measurements"]["sinkage [mm]"], plain["sinkage [mm]"])
    zero.loc[19:, "drawbar_pull [N]"] = np.nan
    short = r"zero record 'short.csv' must hold at least 20 readings of 'drawbar_pull' \(got 19\)"
    with pytest.raises(StudyError, match=short):
        reduce_logs([log], zero=write(zero, "short.csv"), **WHEEL)


def test_a_drive_that_never_settles_is_rejected_by_name(
    drive: SimulatedDrive, write: Callable[..., Path], tmp_path: Path
) -> None:
    """The channel, and between what it still moves."""
    time = drive.table["time [s]"].to_numpy()
    sinking = drive.table.assign(**{"sinkage [mm]": 6 + 0.1 * time})
    reduction = reduce_logs([write(sinking)], **WHEEL)
    assert not reduction.kept
    assert "wheel sinkage is not steady up to the end" in reduction.windows[-1].rejected
    with pytest.raises(ResultError, match=r"no steady window was found: .*wheel sinkage is not steady"):
        reduction.save(tmp_path / "m.csv")
    assert not list(tmp_path.glob("m.*"))


def test_a_speed_of_the_other_sign_gives_no_row(drive: SimulatedDrive, write: Callable[..., Path]) -> None:
    """Slips beyond 1 are said, not written; backwards altogether is as good as forwards."""
    travel, rim = "travel_speed [mm/s]", "rim_speed [mm/s]"
    turned = drive.table.assign(**{travel: -drive.table[travel]})
    reduction = reduce_logs([write(turned)], **WHEEL)
    assert not reduction.kept
    assert reduction.windows[-1].rejected == "slip 1.6: wheel and carriage go opposite ways"
    backwards = turned.assign(**{rim: -turned[rim]})
    rows = reduce_logs([write(backwards, "back.csv")], **WHEEL).tables()["measurements"]
    assert_allclose(rows["slip"], [slip for slip, _ in STATES], atol=0.003)


def test_what_is_too_short_says_why(drive: SimulatedDrive, write: Callable[..., Path]) -> None:
    """Too few lugs for an error of the mean; a speed that changes again at once."""
    few = reduce_logs([write(drive.table.iloc[:1500])], radius=f"{RADIUS} m", lugs=4)
    assert few.windows[-1].rejected == "too short: 1 passing lugs, 12 s each, and 8 are needed"
    jolted = drive.table.copy()
    jolted.loc[2000:2150, "rim_speed [mm/s]"] *= 3
    reasons = [window.rejected for window in reduce_logs([write(jolted)], **WHEEL).windows]
    assert "too short: speeds change again before 4% of the log are over" in reasons


def test_a_slow_beginning_is_not_part_of_the_window(drive: SimulatedDrive, write: Callable[..., Path]) -> None:
    """A depth that settles exponentially to a level without noise: its mean is that of the level."""
    time = drive.table["time [s]"].to_numpy()
    depth = 23.9 - 8 * np.exp(-np.maximum(time - 3, 0) / 3) + 0.01 * np.random.default_rng(1).standard_normal(len(time))
    first = time < 53
    log = drive.table[first].assign(**{"sinkage [mm]": depth[first]})[[*drive.table.columns[:4]]]
    (window,) = reduce_logs([write(log)], **WHEEL).kept
    assert window.start > 10
    assert window.mean["sinkage"] == pytest.approx(23.9e-3, abs=0.1e-3)


def of_plate(path: Path) -> Reduction:
    """A plate of 100 mm."""
    return reduce_logs([path], plate="100 mm")


def test_a_plate_test_is_its_loading_branch(write: Callable[..., Path]) -> None:
    """Contact, force in air, the loop and the end left out; readings on the curve."""
    (branch,) = of_plate(write(plate())).branches
    assert branch.zero == pytest.approx(1.5e-3, abs=0.1e-3)
    assert branch.air == pytest.approx(-3.0, abs=0.15)
    z, force = branch.readings.T
    assert_allclose(force[z > 1e-3], 40 * (z[z > 1e-3] * 1e3) ** 0.8, rtol=0.05)
    assert any("unloading and reloading" in note for note in branch.notes)
    assert any("after the greatest load" in note for note in branch.notes)
    assert 20 < len(z) < 120
    table = of_plate(write(plate())).tables()["readings"]
    assert table.columns.tolist() == ["test", "plate_diameter [mm]", "sinkage [mm]", "force [N]", "# kind"]


def test_a_plate_test_without_air_keeps_its_zeros(write: Callable[..., Path]) -> None:
    """And without a loop nothing is called one."""
    (branch,) = of_plate(write(plate(loop=False, air=0))).branches
    assert (branch.zero, branch.air) == (0.0, 0.0)
    assert branch.notes[0] == "it begins in contact: zeros are those of the log"
    assert not any("unloading" in note for note in branch.notes)


@pytest.mark.parametrize(
    ("change", "options", "message"),
    [
        ({"travel_speed [mm/s]": None}, {}, "column 'travel_speed [m/s]' or 'position [m]' is missing"),
        ({"rim_speed [mm/s]": None}, {}, "column 'rim_speed [m/s]' or 'wheel_speed [rad/s]' is missing"),
        ({"time [s]": None}, {}, "column 'time [s]' is missing"),
        ({"time [s]": 5.0}, {}, "column 'time [s]' is missing"),
        ({}, {"plate": "100 mm"}, ""),
        ({"sinkage [mm]": None}, {"plate": "100 mm"}, "a plate test needs 'sinkage [mm]' and 'force [N]'"),
        ({}, {"radius": "58"}, "'radius' needs a unit"),
        ({}, {"radius": "-1 m"}, "'radius' must be above 0 (got -1 m)"),
        ({}, {"steady": 1.5}, "'steady' must lie in [0, 1) (got 1.5)"),
        ({}, {"kind": "guessed"}, "unknown kind 'guessed' (known: measured, digitised, simulated)"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line(
    change: dict[str, Any], options: dict[str, Any], message: str, drive: SimulatedDrive, write: Callable[..., Path]
) -> None:
    """What is missing, and what to give."""
    table = drive.table.iloc[:2000].drop(columns=[name for name, value in change.items() if value is None])
    path = write(table.assign(**{name: value for name, value in change.items() if value is not None}))
    if not message:
        assert reduce_logs([path], **options).branches
        return
    with pytest.raises(StudyError) as caught:
        reduce_logs([path], **options)
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_logs_that_are_none_are_refused(write: Callable[..., Path], drive: SimulatedDrive) -> None:
    """Too few samples, no known channel, a clock that runs backwards."""
    with pytest.raises(StudyError, match="must hold at least 20 samples of known channels"):
        reduce_logs([write(drive.table.iloc[:10])])
    backwards = drive.table.iloc[::-1]
    with pytest.raises(StudyError, match=r"'time' must not run backwards \(it does in row 2\)"):
        reduce_logs([write(backwards)], **WHEEL)


def test_logs_of_one_name_stay_apart(write: Callable[..., Path], drive: SimulatedDrive, tmp_path: Path) -> None:
    """Tests have names of their own, rows the kind of their own log; a log given twice is refused."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    first, second = write(plate(), "a/plate.csv"), write(plate(loop=False), "b/plate.csv")
    reduction = reduce_logs([first, second], plate="100 mm")
    assert [branch.test for branch in reduction.branches] == [str(first), str(second)]
    one, two = (len(of_plate(path).branches[0].readings) for path in (first, second))
    assert reduction.tables()["readings"].groupby("test").size().tolist() == [one, two]
    again = write(plate().assign(test="1"), "second.csv")
    tests = reduce_logs([write(plate().assign(test="1"), "first.csv"), again], plate="100 mm").branches
    assert [branch.test for branch in tests] == ["1", "second.csv 1"]
    for twice in (again, again.parent / "a" / ".." / again.name):
        with pytest.raises(StudyError, match=r"second\.csv' is given twice: name it once$"):
            reduce_logs([again, twice], plate="100 mm")
    plain = drive.table.drop(columns="remark")
    logs = [write(drive.table, "b/log.csv"), write(plain, "a/log.csv")]
    kinds = reduce_logs(logs, **WHEEL).tables()["measurements"]["# kind"].tolist()
    alone = [kind for log in logs for kind in reduce_logs([log], **WHEEL).tables()["measurements"]["# kind"]]
    assert kinds == alone
    assert len({*kinds}) == 2


def test_a_plate_has_one_diameter(write: Callable[..., Path]) -> None:
    """Of the cells that say one; several in a test, or none above 0, are refused."""
    table = plate().assign(**{"plate_diameter [mm]": 80.0})
    table.loc[0, "plate_diameter [mm]"] = np.nan
    (branch,) = of_plate(write(table)).branches
    assert branch.diameter == 0.08
    for value, got in ((50.0, "50 to 80 mm"), (-80.0, "-80 to 80 mm")):
        table.loc[5, "plate_diameter [mm]"] = value
        with pytest.raises(StudyError, match=rf"must be one length above 0 in a test \(got {got}, log.csv\)"):
            of_plate(write(table))
    for stated, mend in (([0.0], "$"), ([50.0, 80.0], ": name tests in a column 'test'$")):
        table["plate_diameter [mm]"] = np.resize(stated, len(table))
        with pytest.raises(StudyError, match=rf"mm, log.csv\){mend}"):
            of_plate(write(table))


def test_channels_without_a_reading_are_left_out(write: Callable[..., Path], drive: SimulatedDrive) -> None:
    """Of a log and of its zero record."""
    empty = write(drive.table.assign(**{"drawbar_pull [N]": np.nan}))
    zero = write(drive.table.iloc[:400], "zero.csv")
    reduction = reduce_logs([empty], zero=zero, **WHEEL)
    assert "drawbar_pull [N]" not in reduction.tables()["measurements"]
    assert "data:image/svg+xml" in reduction.page().html()
    both = pd.concat([plate().assign(test="A"), plate().assign(test="B", **{"force [N]": np.nan})])
    with pytest.raises(StudyError, match=r"a plate test needs 'sinkage \[mm\]' and 'force \[N\]'"):
        of_plate(write(both, "both.csv"))
    full = write(drive.table, "full.csv")
    of = reduce_logs([full], zero=write(drive.table.iloc[:400].assign(**{"load [N]": np.nan}), "z.csv"), **WHEEL)
    assert "drawbar_pull [N]" in of.tables()["measurements"]


def test_errors_of_awkward_logs_are_numbers_or_left_out(write: Callable[..., Path], drive: SimulatedDrive) -> None:
    """A channel of zeros has no error; a gap in a speed and a doubled time stamp cost no slip."""
    table = drive.table.assign(**{"drawbar_pull [N]": 0.0})
    rows = reduce_logs([write(table)], **WHEEL).tables()["measurements"]
    assert (rows["drawbar_pull [N]"] == 0).all()
    assert rows["drawbar_pull_sd [N]"].isna().all()
    time = drive.table["time [s]"]
    (window, *_) = reduce_logs([write(drive.table)], **WHEEL).kept
    middle = 0.5 * (window.start + window.end)
    gap = drive.table.copy()
    gap.loc[(time > middle) & (time < middle + 3 * window.period), "travel_speed [mm/s]"] = np.nan
    assert reduce_logs([write(gap)], **WHEEL).tables()["measurements"]["# slip_sd"].notna().all()
    place = drive.table.copy()
    place["position [m]"] = np.cumsum(place.pop("travel_speed [mm/s]")) / 1e5
    place.loc[1, ["time [s]", "position [m]"]] = place.loc[0, ["time [s]", "position [m]"]]
    place.loc[place.index % 2 == 1, "position [m]"] = np.nan
    rows = reduce_logs([write(place)], **WHEEL).tables()["measurements"]
    assert_allclose(rows["slip"], [slip for slip, _ in STATES], atol=0.003)
    place.loc[1:, "position [m]"] = np.nan
    with pytest.raises(StudyError, match="'position' has readings at one time only"):
        reduce_logs([write(place)], **WHEEL)
