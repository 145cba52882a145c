"""Recordings of measuring programs as lines of cells: Parquet, MATLAB files to version 7, and ROS bags.

No file makes code: Parquet and MATLAB files are asked for numbers and texts, and messages of a bag are read
by the definitions that ``rosbags`` ships, never by those that the bag brings along.
"""

import os
from collections import defaultdict
from collections.abc import Iterator
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from scipy.io import loadmat, whosmat

from bayesterra.errors import StudyError
from bayesterra.runtime.reading import MEGABYTE, check_ordinary, reason

MOST_CELLS = 32_000_000
MOST_BAG = 65_536 * MEGABYTE
PACKAGES = ("std_msgs/", "geometry_msgs/", "nav_msgs/msg/Odometry")
"""Messages that hold numbers of a drive."""
AXES = {"force.x": "Fx", "force.z": "Fz", "torque.y": "My", "linear.x": "travel_speed", "position.x": "position"}
"""Columns of what messages have along axes: x ahead, z up."""


def is_bag(path: Path) -> bool:
    """True for ROS bags, by name: files of ROS 1, files or folders of ROS 2."""
    return path.suffix in (".bag", ".mcap", ".db3") or (path / "metadata.yaml").is_file()


def recording_cells(path: Path, content: bytes, rows: int) -> tuple[list[list[Any]], str]:
    """Header and lines of a recording, and its form in words; none where it is no recording.

    Dates are texts. Columns of MATLAB files are vectors, alone or in structs; texts and single numbers stand
    in every row. Columns of a bag are in SI, at the times of its fastest topic, between messages by lines.

    Raises
    ------
    StudyError : it is too large, damaged or of a form that cannot be read; what to do.
    """
    matlab = content.startswith(b"MATLAB") or path.suffix == ".mat"
    form = "ROS bag" if is_bag(path) else "Parquet" if content.startswith(b"PAR1") else "MATLAB" if matlab else ""
    if not form:
        return [], ""
    try:
        frame = _bag(path, rows) if form == "ROS bag" else _parquet(content) if form == "Parquet" else _matlab(content)
    except (StudyError, MemoryError):
        raise
    except Exception as error:  # damaged files fail with errors of many kinds
        raise StudyError(f"is no {form} file that can be read ({reason(error)})") from error
    if len(frame) > rows:
        raise StudyError(f"must have at most {rows} rows")
    for name, column in frame.select_dtypes(include=["datetime", "datetimetz"]).items():
        frame[name] = [moment.isoformat() for moment in column]
    return [list(map(str, frame.columns)), *frame.to_numpy(dtype=object).tolist()], form


def _check_size(cells: int) -> None:
    if cells > MOST_CELLS:
        raise StudyError(f"must have at most {MOST_CELLS} cells (got {cells})")


def _parquet(content: bytes) -> pd.DataFrame:
    try:
        from pyarrow.parquet import ParquetFile
    except ImportError as error:
        raise StudyError("Parquet needs pyarrow: pip install 'bayesterra[parquet]', or save as CSV") from error
    file = ParquetFile(BytesIO(content))
    _check_size(file.metadata.num_rows * file.metadata.num_columns)
    frame: pd.DataFrame = file.read().to_pandas()
    return frame if isinstance(frame.index, pd.RangeIndex) else frame.reset_index()


def _matlab(content: bytes) -> pd.DataFrame:
    """Vectors of a MATLAB file, and those of its structs."""
    if content.startswith(b"MATLAB 7.3"):
        raise StudyError("is a MATLAB file of version 7.3: save it with save('log.mat', '-v7')")
    _check_size(sum(prod(shape) for _, shape, _ in whosmat(BytesIO(content))))
    columns: dict[str, Any] = {}
    for name, value in loadmat(BytesIO(content), simplify_cells=True).items():
        if not name.startswith("__"):
            columns |= value if isinstance(value, dict) else {name: value}
    vectors = {name: value for name, value in columns.items() if isinstance(value, np.ndarray) and value.ndim == 1}
    if not vectors:
        raise StudyError("holds no vectors: save those of a log, of a table T by S = table2struct(T,'ToScalar',true)")
    if len({len(vector) for vector in vectors.values()}) > 1:
        lengths = ", ".join(f"{name} {len(vector)}" for name, vector in vectors.items())
        raise StudyError(f"vectors must be of one length ({lengths}): save those of one log alone")
    single = {name: value for name, value in columns.items() if isinstance(value, str | int | float)}
    return pd.DataFrame({**vectors, **single})


def _bag(path: Path, rows: int) -> pd.DataFrame:
    """Numbers of the messages of a bag by topic, at the times of the topic with the most messages."""
    try:
        from rosbags import rosbag1, rosbag2
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        raise StudyError("ROS bags need rosbags: pip install 'bayesterra[rosbags]', or export CSV") from error
    for file in path.iterdir() if path.is_dir() else [path]:
        check_ordinary(os.stat(file), file, MOST_BAG)
    first = path.suffix == ".bag"
    store = get_typestore(Stores.ROS1_NOETIC if first else Stores.LATEST)
    decoded = store.deserialize_ros1 if first else store.deserialize_cdr
    series: dict[tuple[str, str], list[tuple[float, float]]] = defaultdict(list)
    with rosbag1.Reader(path) if first else rosbag2.Reader(path) as bag:
        known = [each for each in bag.connections if each.msgtype.startswith(PACKAGES) and "Accel" not in each.msgtype]
        if any(each.msgcount > rows for each in known):
            raise StudyError(f"must have at most {rows} messages of a topic")
        for connection, stamp, raw in bag.messages(connections=known) if known else ():
            for field, number in _numbers(decoded(raw, connection.msgtype)):
                series[connection.topic, field].append(((stamp - bag.start_time) * 1e-9, number))
        types = ", ".join(sorted({f"{each.topic} ({each.msgtype})" for each in bag.connections})) or "nothing"
    if not series:
        raise StudyError(f"holds no numbers of std_msgs or geometry_msgs (it has {types}): record such topics")
    clock = np.array(max(series.values(), key=len))[:, 0]
    columns, topics = {"time [s]": clock}, {"time [s]": ""}
    for (topic, field), points in series.items():
        name = AXES.get(field) or (topic.rpartition("/")[2] if field == "data" else f"{topic} {field}")
        if name in columns:
            raise StudyError(f"topics '{topics[name]}' and '{topic}' both hold '{name}': leave one out of the bag")
        times, numbers = np.array(points).T
        columns[name], topics[name] = np.interp(clock, times, numbers, left=np.nan, right=np.nan), topic
    return pd.DataFrame(columns)


def _numbers(message: Any, field: str = "") -> Iterator[tuple[str, float]]:
    """Numbers of a message, by the last two of the names that lead to them."""
    for name in message.__dataclass_fields__:
        value = getattr(message, name)
        if hasattr(value, "__dataclass_fields__") and name not in ("header", "covariance"):
            yield from _numbers(value, name)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield f"{field}.{name}".strip("."), float(value)
