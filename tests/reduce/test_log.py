"""Logs in the forms of measuring programs: Parquet, MATLAB, ROS bags; clocks and units that they leave out."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from rosbags import rosbag1, rosbag2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from scipy.io import savemat
from simulated_drives import LUGS, RADIUS, simulated_drive

from bayesterra.errors import StudyError
from bayesterra.reduce.log import LOGGED, read_log
from bayesterra.reduce.reduction import reduce_logs
from bayesterra.study.units import known_column

UNITS = {"s": "s", "mm/s": "mm_s", "mm": "mm", "N": "N", "N m": "Nm"}


@pytest.fixture(scope="module")
def table() -> pd.DataFrame:
    """A short simulated drive, labelled so."""
    return simulated_drive(np.random.default_rng(5), ((0.1, 60.0),)).table


def matlab(columns: Mapping[str, Any], **how: Any) -> bytes:
    """A MATLAB file of columns whose names end in their units."""
    file = io.BytesIO()
    names = {name: name.removesuffix("]").split(" [") for name in columns}
    savemat(file, {"_".join([name, *(UNITS[u] for u in unit)]): columns[full]
                   for full, (name, *unit) in names.items()}, **how)  # fmt: skip
    return file.getvalue()


def bag_of(path: Path, table: pd.DataFrame, more: Mapping[str, str] | None = None) -> Path:
    """A bag: speeds and depths as numbers, a force sensor as a wrench at half the rate, all in SI."""
    first = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.LATEST)
    message, encode = store.types, store.serialize_ros1 if first else store.serialize_cdr
    vector = message["geometry_msgs/msg/Vector3"]
    si = {known_column(name, LOGGED)[0]: table[name].to_numpy() * LOGGED[known_column(name, LOGGED)[0]].scale
          for name in table.columns if known_column(name, LOGGED)[0] in LOGGED}  # fmt: skip
    stamps = (1_600_000_000 * 10**9 + np.rint(si["time"] * 1e9).astype(np.int64)).tolist()
    with rosbag1.Writer(path) if first else rosbag2.Writer(path, version=9) as bag:
        number, wrench = "std_msgs/msg/Float64", "geometry_msgs/msg/Wrench"
        topics = {name: bag.add_connection(f"/rig/{name}", number, typestore=store)
                  for name in ("travel_speed", "rim_speed", "sinkage")}  # fmt: skip
        forces = bag.add_connection("/rig/ft", wrench, typestore=store)
        note = bag.add_connection("/note", "std_msgs/msg/String", typestore=store)
        bag.write(note, stamps[0], encode(message["std_msgs/msg/String"]("by hand"), "std_msgs/msg/String"))
        for name in more or {}:
            topics[name] = bag.add_connection(f"/other/{more[name] if more else name}", number, typestore=store)
            si[name] = si["sinkage"]
        for i, stamp in enumerate(stamps):
            for name, topic in topics.items():
                bag.write(topic, stamp, encode(message[number](si[name][i]), number))
            if i % 2 == 0:
                force = vector(si["drawbar_pull"][i], 0.0, si["normal_force"][i])
                torque = vector(0.0, si["resistance_moment"][i], 0.0)
                bag.write(forces, stamp, encode(message[wrench](force, torque), wrench))
    return path


def written(form: str, table: pd.DataFrame, folder: Path) -> Path:
    """The drive in one form."""
    path = folder / f"log{form}"
    if form == ".parquet":
        table.set_index("time [s]").to_parquet(path)
    elif form == ".mat":
        path.write_bytes(matlab({name: table[name].to_numpy() for name in table.columns[:-1]} | {"note": "simulated"}))
    elif form == ".struct.mat":
        savemat(path, {"rig": {f"{name.split(' [')[0]}_{UNITS[name[name.index('[') + 1 : -1]]}": table[name].to_numpy()
                               for name in table.columns[:-1]}, "made": "simulated"})  # fmt: skip
    else:
        bag_of(path, table)
    return path


@pytest.mark.parametrize("form", [".parquet", ".mat", ".struct.mat"])
def test_files_of_other_programs_hold_the_same(form: str, table: pd.DataFrame, tmp_path: Path) -> None:
    """Every sample of every channel, as from CSV; the label goes along."""
    table.to_csv(tmp_path / "log.csv", index=False)
    expected, log = read_log(tmp_path / "log.csv"), read_log(written(form, table, tmp_path))
    assert set(log.values) == set(expected.values)
    for name, values in expected.values.items():
        assert_allclose(log.values[name], values, rtol=1e-15)
    assert log.kind == "simulated"
    assert log.form == {"parquet": "Parquet", "mat": "MATLAB"}[form.rpartition(".")[2]]


@pytest.mark.parametrize("form", [".bag", ""])
def test_bags_give_the_same_row(form: str, table: pd.DataFrame, tmp_path: Path) -> None:
    """ROS 1 and ROS 2; numbers by topic and a wrench by axes, at the clock of the fastest topic."""
    table.drop(columns="remark").to_csv(tmp_path / "log.csv", index=False)
    path = written(form, table, tmp_path)
    log, wheel = read_log(path), {"radius": f"{RADIUS} m", "lugs": LUGS}
    expected = read_log(tmp_path / "log.csv")
    assert log.form == "ROS bag"
    assert [each.header for each in log.headings if each.name][:2] == ["time [s]", "travel_speed [m/s]"]
    assert_allclose(log.values["time"], expected.values["time"], atol=1e-6)
    assert_allclose(log.values["sinkage"], expected.values["sinkage"], rtol=1e-15)
    assert_allclose(log.values["drawbar_pull"][::2], expected.values["drawbar_pull"][::2], rtol=1e-15)
    between = (expected.values["drawbar_pull"][:-2:2] + expected.values["drawbar_pull"][2::2]) / 2
    assert_allclose(log.values["drawbar_pull"][1:-1:2], between, rtol=1e-6, atol=1e-6)
    row = reduce_logs([path], **wheel).tables()["measurements"].iloc[0]  # type: ignore[arg-type]
    other = reduce_logs([tmp_path / "log.csv"], **wheel).tables()["measurements"].iloc[0]  # type: ignore[arg-type]
    for name in ("slip", "sinkage [mm]", "drawbar_pull [N]", "normal_force [N]", "resistance_moment [N m]"):
        assert row[name] == pytest.approx(other[name], rel=1e-3)


def test_messages_of_own_definition_are_not_read(tmp_path: Path) -> None:
    """Definitions that a bag brings along build nothing; the line says what is there and what to record."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("float64 sinkage\n", "rig/msg/Depth"))
    with rosbag1.Writer(tmp_path / "own.bag") as bag:
        topic = bag.add_connection("/depth", "rig/msg/Depth", typestore=store)
        bag.write(topic, 1, store.serialize_ros1(store.types["rig/msg/Depth"](1.0), "rig/msg/Depth"))
    with pytest.raises(StudyError, match=r"holds no numbers of std_msgs or .*\(it has /depth \(rig/msg/Depth\)\): rec"):
        read_log(tmp_path / "own.bag")


def test_two_topics_of_one_channel_are_named(table: pd.DataFrame, tmp_path: Path) -> None:
    """Which ones, and what to do."""
    path = bag_of(tmp_path / "two.bag", table.iloc[:50], {"again": "sinkage"})
    with pytest.raises(StudyError, match="topics '/rig/sinkage' and '/other/sinkage' both hold 'sinkage': leave one"):
        read_log(path)


def files() -> Mapping[str, tuple[str, bytes, str]]:
    """Damaged and unfit files: name, content, what is said."""
    time = np.arange(30.0)
    parquet = io.BytesIO()
    pd.DataFrame({"time [s]": time}).to_parquet(parquet)
    hdf5 = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n"
    return {
        "a MATLAB file of version 7.3": ("a.mat", hdf5, "version 7.3: save it with save('log.mat', '-v7')"),
        "vectors of two lengths": (
            "a.mat",
            matlab({"time [s]": time, "sinkage [mm]": time[1:]}),
            "vectors must be of one length (time_s 30, sinkage_mm 29): save those of one log alone",
        ),
        "no vectors": ("a.mat", matlab({"note": "text"}), "holds no vectors: save those of a log, of a table T by"),
        "half a MATLAB file": ("a.mat", matlab({"time [s]": time})[:200], "is no MATLAB file that can be read ("),
        "no MATLAB file": ("a.mat", b"time [s]\n1\n", "is no MATLAB file that can be read ("),
        "half a Parquet file": ("a.parquet", parquet.getvalue()[:100], "is no Parquet file that can be read ("),
        "half a bag": ("a.bag", b"#ROSBAG V2.0\nE\x00", "is no ROS bag file that can be read ("),
        "no bag": ("a.db3", b"SQLite format 3\0" + bytes(90), "is no ROS bag file that can be read ("),
        "no unit": ("a.mat", matlab({"time": time, "load [N]": time}), "column 'time' needs a unit, e.g. 'time [s]'"),
    }


@pytest.mark.parametrize("case", files())
def test_files_that_cannot_be_read_are_one_line(case: str, tmp_path: Path) -> None:
    """What is wrong and, where there is one, the mend."""
    name, content, message = files()[case]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(StudyError) as caught:
        read_log(tmp_path / name)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("module", "write", "message"),
    [
        ("pyarrow.parquet", ".parquet", r"Parquet needs pyarrow: pip install 'bayesterra\[parquet\]', or save as CSV"),
        ("rosbags", ".bag", r"ROS bags need rosbags: pip install 'bayesterra\[rosbags\]', or export CSV"),
    ],
)
def test_missing_libraries_are_named(
    module: str, write: str, message: str, table: pd.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With the command that brings them."""
    path = written(write, table.iloc[:50], tmp_path)
    monkeypatch.setitem(__import__("sys").modules, module, None)
    with pytest.raises(StudyError, match=message):
        read_log(path)


def test_limits_hold_for_recordings(table: pd.DataFrame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cells before they are unpacked, rows after."""
    paths = [written(form, table.iloc[:50], tmp_path) for form in (".parquet", ".mat", ".bag")]
    monkeypatch.setattr("bayesterra.reduce.log.MOST_SAMPLES", 40)
    for path in paths:
        with pytest.raises(StudyError, match="must have at most 40 "):
            read_log(path)
    monkeypatch.setattr("bayesterra.runtime.recordings.MOST_CELLS", 40)
    for path in paths[:2]:
        with pytest.raises(StudyError, match="must have at most 40 cells"):
            read_log(path)


def test_clocks_with_dates_count_from_their_first(table: pd.DataFrame, tmp_path: Path) -> None:
    """Texts in CSV, moments in Parquet; with a zone or without."""
    seconds = table["time [s]"].to_numpy()
    moments = pd.Timestamp("2021-03-16T17:11:02") + pd.to_timedelta(seconds, unit="s")
    dated = table.drop(columns="time [s]").assign(timestamp=moments)
    dated.to_csv(tmp_path / "dated.csv", index=False)
    dated.assign(timestamp=moments.tz_localize("Europe/Berlin")).to_parquet(tmp_path / "dated.parquet")
    dated.assign(timestamp=moments.strftime("%H:%M:%S.%f")).to_csv(tmp_path / "day.txt", index=False, sep="\t")
    for name in ("dated.csv", "dated.parquet", "day.txt"):
        assert_allclose(read_log(tmp_path / name).values["time"], seconds - seconds[0], atol=1e-6)
    dated.assign(timestamp=moments.strftime("%d.%m.%Y %H:%M:%S")).to_csv(tmp_path / "german.csv", index=False)
    with pytest.raises(
        StudyError, match=r"'timestamp' must hold seconds, dates as .* \(got '16.03.2021 17:11:02', row 1"
    ):
        read_log(tmp_path / "german.csv")
    table.assign(**{"time [s]": "noon"}).to_csv(tmp_path / "noon.csv", index=False)
    with pytest.raises(StudyError, match=r"'time' must be a number or empty \(got 'noon', row 1\)"):
        read_log(tmp_path / "noon.csv")
