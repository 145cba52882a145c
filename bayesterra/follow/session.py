"""The job ``follow``: rows from a file or standard input, one by one."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, TextIO

import numpy as np
import pandas as pd

from bayesterra.errors import BayesterraError, ResultError, StudyError, errors_in
from bayesterra.follow.rows import Alarm, Update, cells, read_row
from bayesterra.follow.stream import STATE, Stream, load_stream
from bayesterra.runtime.folders import check_free, write_text
from bayesterra.runtime.reading import check_sums, damage
from bayesterra.runtime.tables import csv_text, read_csv, rows_of_cells
from bayesterra.study import schema
from bayesterra.study.assembly import LOAD_EFFECT_MODEL
from bayesterra.study.drive import Drive
from bayesterra.study.observations import Observations
from bayesterra.study.result import AnalysisResult, Result
from bayesterra.study.study import STUDY_FILE, Study, load_study, without_wheels

UPDATES = "updates.csv"


@dataclass(frozen=True)
class RowOutcome:
    """A row and what it did, or why it was left out."""

    number: int
    row: Observations | None = None
    update: Update | None = None
    problem: str = ""
    begun_anew: int | None = None
    place: int = 0  # in the file, of the row or of that where the soil changed; 0 where it has the same number


@dataclass
class FollowedStream(AnalysisResult):
    """A stream that is being followed."""

    MARK = Stream.MARK
    RECORD = Stream.RECORD
    VIEW = "bayesterra.follow.page:followed"
    PAGE = ""
    FIGURES: ClassVar[Mapping[str, str]] = {"rows.png": "bands_over_rows"}
    CALLED = "Written"

    stream: Stream  # as it stands
    table: list[dict[str, object]] = field(default_factory=list)  # one entry per row as in ``updates.csv``
    soil: int = 1  # number of the soil that the rover is on, by the alarms so far
    alarms: list[Alarm] = field(default_factory=list)  # all of them
    left_out: int = 0  # number of rows that could not be used
    places: dict[int, int] = field(default_factory=dict)  # number in the file of the rows that were added now

    def take(self, table: pd.DataFrame, *, restart: bool) -> RowOutcome:
        """Add a row; one that cannot be used is left out, unless it is the very first.

        After an error or an interruption everything stands as before the row, table and stream alike.
        """
        own, rows, alarms = vars(self).copy(), len(self.table), len(self.alarms)
        try:
            with self.stream.all_or_nothing():
                return self._taken(table, restart=restart)
        except BaseException:
            vars(self).update(own)
            del self.table[rows:], self.alarms[alarms:]
            raise

    def _taken(self, table: pd.DataFrame, *, restart: bool) -> RowOutcome:
        stream = self.stream
        number = stream.offset + len(stream) + 1
        place = int(table.attrs.get("row", number))
        try:
            row = read_row(stream.study, table, number, stream.references)
            update = stream.learn(row)
        except BayesterraError as error:
            if not self.table and not len(stream):
                raise
            self.left_out += 1
            return RowOutcome(number, problem=str(error), place=place if place != number else 0)
        self.places[number] = place
        by = stream.rows.by
        label = {by: row.label(by)[0]} if by else {}
        self.table.append({"soil": self.soil, **label, **cells(update, row)})
        anew, since = None, 0
        if update.alarm:
            self.alarms.append(update.alarm)
            since = self.places.get(update.alarm.since, update.alarm.since)
            since = since if since != update.alarm.since else 0
            if restart:
                anew = update.alarm.since
                self.stream, self.soil = stream.restarted(anew), self.soil + 1
        return RowOutcome(number, row, update, begun_anew=anew, place=since)

    @property
    def misses(self) -> tuple[int, int]:
        """Readings outside the 90 % bands that were expected of them, and readings; before a change of the soil."""
        alarm = self.stream.alarm
        rows = [
            row
            for row in self.table
            if row["soil"] == self.soil and (alarm is None or int(str(row["row"])) < alarm.since)
        ]
        table = pd.DataFrame(rows)
        places = table[[name for name in table if str(name).endswith("_pit")]].to_numpy(dtype=float)
        return int((np.abs(places - 0.5) > 0.45).sum()), int((~np.isnan(places)).sum())

    def tables(self) -> Mapping[str, pd.DataFrame]:
        """The summary; the table of the rows has a format of its own."""
        return self.stream.tables()

    def to_record(self) -> dict[str, Any]:
        """Content of the JSON file."""
        return self.stream.to_record()

    def write_inputs(self, part: Path) -> None:
        """Write the state, and the table of the rows."""
        self.stream.write_inputs(part)
        write_text(part / UPDATES, csv_text(pd.DataFrame(self.table), "%.7g"))

    def figures(self) -> dict[str, bytes]:
        """Every parameter over the rows."""
        from bayesterra.follow.page import bands_over_rows
        from bayesterra.report.figures import white_png

        truth = self.stream.study.truth
        values = dict(truth.values) if truth else None
        return {"rows.png": white_png(bands_over_rows(pd.DataFrame(self.table), values), 150)}


def begin(what: Path | Result, first: pd.DataFrame, **settings: Any) -> FollowedStream:
    """A stream on a study file, on a finished result, or on a stream that was put down.

    Parameters
    ----------
    what : a finished result, or the path of a study or of a stream.
    first : table of the first row, which takes the place of the study's measurements.
    **settings : of :class:`bayesterra.follow.stream.Stream`; None for what the study file says. A stream
        that was put down has its own.

    Raises
    ------
    StudyError, ResultError : what is there cannot be used.
    """
    options = {name: value for name, value in settings.items() if value is not None}
    if isinstance(what, Result):
        return FollowedStream(Stream(what, **options))
    if (what / Stream.MARK).exists() or (what / STATE).exists():
        stream = load_stream(what)
        check_sums(what, UPDATES)
        return _gone_on(stream, what / UPDATES)
    path = what / STUDY_FILE if what.is_dir() else what
    with errors_in(path):
        content = schema.checked(schema.read_toml(path), bare=False)
    stated = {name: getattr(content.data, name) for name in ("slip_reference", "sinkage_reference")}
    study = _whole(path, content) or load_study(path, prior_only=True, table=first)
    without_wheels(study, "follow")
    return FollowedStream(Stream(study, **{**stated, **options}))


def _whole(path: Path, content: schema.StudyContent) -> Study | None:
    """The study on its own table where it leaves to it the range or the mean of loads; None where it does not."""
    told = {"load_range": Drive(content.drive).latent_load and content.load_range is None,
            "mean_load": content.model == LOAD_EFFECT_MODEL and content.model_options.mean_load is None}  # fmt: skip
    if content.data is None or not any(told.values()):
        return None
    try:
        return load_study(path, prior_only=True)
    except StudyError as error:
        keys = " and ".join(f"'{key}'" for key, needed in told.items() if needed)
        raise StudyError(f"{keys} must be given to follow rows, as no whole table tells it ({error})") from error


def _gone_on(stream: Stream, updates: Path) -> FollowedStream:
    """A stream that was put down, with the table of its rows."""
    if not updates.is_file():
        return FollowedStream(stream)
    with damage(ResultError, updates):
        before = read_csv(updates)
        table = [{str(key): value for key, value in row.items()} for row in before.to_dict("records")]
        if before.empty:
            return FollowedStream(stream, table)
        last = before.iloc[-1]
        begun_anew = pd.notna(last["alarm"]) and stream.alarm is None  # just before it was put down
        return FollowedStream(stream, table, int(last["soil"]) + int(begun_anew))


def follow(
    what: Path | Result,
    data: Path | TextIO,
    *,
    out: Path | None = None,
    restart: bool = False,
    overwrite: bool = False,
    show: Callable[[RowOutcome], None] = lambda seen: None,
    **settings: Any,
) -> FollowedStream:
    """Follow rows of a CSV one by one; with ``out`` write tables, a figure and the state at their end.

    An interruption (Ctrl-C) counts as the end of the rows: what was learned is written, then it goes on up.

    Parameters
    ----------
    what, settings : see :func:`begin`.
    data : a CSV file, or an open one that may grow while it is read.
    restart : after an alarm begin anew, from the prior and the row at which the soil changed.
    show : called after every row.

    Raises
    ------
    StudyError, ResultError : the study or the first row cannot be used, or ``out`` cannot be written.
    """
    if out is not None:
        check_free(out, overwrite=overwrite, mark=Stream.MARK)
    with ExitStack() as stack:
        rows = rows_of(data, stack)
        first = next(rows, None)
        if first is None:
            raise StudyError(f"{_named(data)}: must hold a header and at least one row")
        following = begin(what, first, **settings)
        try:
            with errors_in(_named(data)):
                show(following.take(first, restart=restart))
            for table in rows:
                show(following.take(table, restart=restart))
        finally:
            if out is not None and following.table:
                following.save(out, overwrite=overwrite)
    return following


def rows_of(data: Path | TextIO, stack: ExitStack) -> Iterator[pd.DataFrame]:
    """Tables of one row each, as they come; blank lines do not count, rows with ``use`` 0 are passed over."""
    name = _named(data)
    if isinstance(data, Path):
        try:
            data = stack.enter_context(data.open(newline="", encoding="utf-8"))
        except OSError as error:
            raise StudyError(f"{data}: cannot be read ({error.strerror})") from error
    with errors_in(name):
        lines = rows_of_cells(data)
        header = next(lines, [])
        for number, line in enumerate(lines, start=1):
            if len(line) != len(header):
                raise StudyError(f"every row must have {len(header)} cells (got {len(line)}, row {number})")
            cell = dict(zip((name.strip() for name in header), line, strict=True))
            if cell.get("use", "1").strip() not in ("0", "0.0"):
                table = pd.DataFrame([line], columns=pd.Index(header), dtype=str)
                table.attrs["row"] = number
                yield table


def _named(data: Path | TextIO) -> str:
    return str(data) if isinstance(data, Path) else "standard input"
