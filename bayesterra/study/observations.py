"""Tables of measurements: CSV or DataFrame in, checked arrays in SI out."""

import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from bayesterra.arrays import BoolArray, FloatArray, frozen
from bayesterra.errors import StudyError, checked_name, did_you_mean, enumerated, errors_after, suggestion
from bayesterra.models import Wheel
from bayesterra.models.geometry import convert_slip
from bayesterra.parameters import CHANNELS, OUTCOMES, Channel
from bayesterra.runtime.tables import read_cells
from bayesterra.study.noise import LEAST
from bayesterra.study.units import REMARKS, STANDARD_GRAVITY, factor, known_column

SD_SUFFIX = "_sd"
MOST_LOAD = 1e12
"""N, at most, of a load: beyond it sums and squares overflow."""
MOST = 1e4
"""Pull and moment (at an arm of 1 m), at most, as a multiple of the greatest load in the table."""
MASSES = ("kg",)
"""Units of mass that a force may be given in."""
WEIGHT = f"kg: the weight of that mass under standard gravity, {STANDARD_GRAVITY} m/s²"
LABELS = ("site", "run")
"""Columns, beside the wheel, that may say which group a row belongs to."""


@dataclass(frozen=True)
class Observations:
    """Measurements of m rows: SI units, slip on the shearing radius, sinkage from the rim; all read-only.

    Attributes
    ----------
    wheel : name of the wheel of every row.
    slip : (m,) slip ratio.
    load : (m,) vertical load, N; NaN where absent.
    values : (m,) for every channel of ``parameters.OUTCOMES`` that has a column; NaN = not measured.
    given_sd : (m,) standard deviations from the table, at least for every channel in ``values``; NaN = none.
    use : (m,) whether the row takes part in the fit.
    rows : row numbers as in the file, the first data row is 1.
    notes : rows that had to be left out altogether, and why; one sentence each.
    labels : the columns of ``LABELS`` that the table has.
    limits : (m, 2) for channels of which a reading is known only to lie below or above a limit: a reading at
        or below the first means anything below it, one at or above the second anything above; −inf and +inf
        where the row has none.
    headings : how every column of the table was understood.
    form : encoding, separators and decimal marks of the file.
    """

    wheel: tuple[str, ...]
    slip: FloatArray
    load: FloatArray
    values: Mapping[str, FloatArray]
    given_sd: Mapping[str, FloatArray]
    use: BoolArray
    rows: tuple[int, ...]
    notes: tuple[str, ...] = ()
    labels: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    limits: Mapping[str, FloatArray] = field(default_factory=dict)
    headings: "tuple[Heading, ...]" = ()
    form: str = ""

    def __len__(self) -> int:
        return len(self.rows)

    @classmethod
    def none(cls) -> "Observations":
        """No rows: of a study without wheels."""
        empty = frozen(np.empty(0))
        return cls((), empty, empty, {}, {}, frozen(np.empty(0), np.bool_), ())

    def used(self) -> "Observations":
        """Only the rows that take part in the fit."""
        return self.take(self.use)

    @property
    def carried(self) -> FloatArray:
        """Load (m,) of every row, N: as given, else the measured normal force; NaN where there is neither."""
        force = self.values.get("normal_force", self.load)
        return np.where(np.isnan(self.load), force, self.load)

    @property
    def known_loads(self) -> FloatArray:
        """The same, and the median of the others where there is neither."""
        loads = self.carried
        middle = float(np.median(loads[~np.isnan(loads)])) if not np.isnan(loads).all() else np.nan
        return np.where(np.isnan(loads), middle, loads)

    def limited(self, name: str) -> BoolArray:
        """Rows (m,) of which a channel's reading is known to lie below or above a limit only."""
        if name not in self.limits:
            return np.zeros(len(self), dtype=np.bool_)
        lower, upper = self.limits[name].T
        return np.asarray((self.values[name] <= lower) | (self.values[name] >= upper))

    def cells(self, name: str, unit: float = 1.0) -> NDArray[Any]:
        """Readings (m,) of a channel as a table has them, in a unit: numbers, or texts such as ``<0.002``."""
        values = self.values.get(name, self.load) / unit
        if not self.limited(name).any():
            return values
        cells = zip(self.marks(name), values.tolist(), strict=True)
        return np.array([f"{mark}{value!r}" if mark else value for mark, value in cells], dtype=object)

    def marks(self, name: str) -> tuple[str, ...]:
        """``<`` or ``>`` (m,) before readings of a channel that are known by a limit only; else empty."""
        upper = self.limits[name][:, 1] if name in self.limits else np.full(len(self), np.inf)
        beyond = self.values[name] >= upper if name in self.values else self.limited(name)
        words = np.where(self.limited(name), np.where(beyond, ">", "<"), "")
        return tuple(words.tolist())

    def numbers(self) -> "Observations":
        """The same without the readings that are known by a limit only."""
        values = {name: np.where(self.limited(name), np.nan, column) for name, column in self.values.items()}
        return replace(self, values=values, limits={})

    def label(self, by: str) -> tuple[str, ...]:
        """Group of every row: its wheel, or what a column of ``LABELS`` says; StudyError without it."""
        if by == "wheel":
            return self.wheel
        if by not in self.labels:
            names = ", ".join(("wheel", *self.labels))
            raise StudyError(f"[pooling] column '{by}' is not in the table (columns that may group: {names})")
        return self.labels[by]

    def followed_by(self, rows: "Observations") -> "Observations":
        """These rows and then others; readings and labels that only one of the two has are empty there."""
        n, empty = len(rows), ("",) * len(rows)

        def column(own: Mapping[str, FloatArray], other: Mapping[str, FloatArray], name: str) -> FloatArray:
            lost = np.full(len(self), np.nan), np.full(n, np.nan)
            return frozen(np.concatenate([own.get(name, lost[0]), other.get(name, lost[1])]))

        nowhere = np.array([-np.inf, np.inf])
        limits = {
            name: np.concatenate([part.limits.get(name, np.tile(nowhere, (len(part), 1))) for part in (self, rows)])
            for name in {**self.limits, **rows.limits}
        }
        return Observations(
            wheel=self.wheel + rows.wheel, slip=frozen(np.concatenate([self.slip, rows.slip])),
            load=frozen(np.concatenate([self.load, rows.load])),
            values={name: column(self.values, rows.values, name) for name in {**self.values, **rows.values}},
            given_sd={k: column(self.given_sd, rows.given_sd, k) for k in {**self.given_sd, **rows.given_sd}},
            use=frozen(np.concatenate([self.use, rows.use]), np.bool_), rows=self.rows + rows.rows,
            labels={name: own + rows.labels.get(name, empty) for name, own in self.labels.items()},
            limits=limits,
        )  # fmt: skip

    def take(self, keep: BoolArray) -> "Observations":
        """Only the rows where ``keep`` (m,) holds."""
        return replace(
            self, wheel=tuple(np.array(self.wheel, dtype=object)[keep]), slip=frozen(self.slip[keep]),
            load=frozen(self.load[keep]),
            values={name: frozen(column[keep]) for name, column in self.values.items()},
            given_sd={name: frozen(column[keep]) for name, column in self.given_sd.items()},
            use=frozen(self.use[keep], np.bool_), rows=tuple(int(row) for row in np.array(self.rows)[keep]),
            labels={n: tuple(np.array(c, dtype=object)[keep]) for n, c in self.labels.items()},
            limits={name: frozen(ends[keep]) for name, ends in self.limits.items()},
        )  # fmt: skip


def read_table(path: str | Path, sheet: str = "", decimal: str | None = None, **most: int) -> pd.DataFrame:
    """A table as people have them, as :func:`bayesterra.runtime.tables.read_cells` reads it; texts or numbers.

    Blank lines do not count as rows. ``attrs["form"]`` says what the form of the file is.
    """
    (header, *rows), form = read_cells(Path(path), sheet, decimal, **most)
    table = pd.DataFrame(rows, columns=pd.Index(map(str, header)), dtype=object)
    table.attrs["form"] = form
    return table


def observations(
    table: pd.DataFrame, wheels: Mapping[str, Wheel], *, slip_reference: str, sinkage_reference: str = "rim"
) -> Observations:
    """Check a table and convert it, once, to SI, to slip on the shearing radius and to sinkage of the rim.

    StudyError names column, row, what must hold and the value got.

    Parameters
    ----------
    table : columns as in the measurement files, units in the headers, e.g. ``sinkage [mm]``.
    wheels : by name, with their shearing-radius coefficients known.
    slip_reference : the radius behind the slip column: ``rim`` r, ``tip`` r + h, ``shearing`` r_s.
    sinkage_reference : the zero of the sinkage column: ``rim``, or ``tip`` of the lugs (h is subtracted).
    """
    if len(table) == 0:
        raise StudyError("must hold at least one row of measurements (the table is empty)")
    columns = named_columns(table, _column_scale, _known_columns())
    raw = Observations(
        wheel=_wheel_names(columns, len(table), tuple(wheels)), slip=required(columns, "slip"),
        load=columns["load"].si() if "load" in columns else np.full(len(table), np.nan),
        values={name: columns[name].readings for name in OUTCOMES if name in columns},
        limits={name: columns[name].limits() for name in OUTCOMES if name in columns and columns[name].marks},
        given_sd=_given_sd(columns, len(table)), use=used_rows(columns, len(table)),
        rows=tuple(range(1, len(table) + 1)),
        labels={name: labels(columns[name]) for name in LABELS if name in columns},
        notes=tuple(f"column '{each.header}' in {WEIGHT}" for each in columns.values() if each.unit in MASSES),
        headings=headings(table, columns), form=table.attrs.get("form", ""),
    )  # fmt: skip
    rows = _referenced(raw, wheels, slip_reference, sinkage_reference)
    return sifted(rows, [_problem(rows, i, float(raw.slip[i]), wheels, columns) for i in range(len(raw))])


@dataclass(frozen=True)
class Column:
    """One column as it stands in the table: cells, and the SI value of one of its unit."""

    name: str
    cells: list[Any]
    scale: float
    header: str = ""
    unit: str = ""

    @property
    def stated(self) -> str:
        """Unit as it was typed, with a space before it, for a message."""
        return f" {self.unit}" if self.unit else ""

    def si(self) -> FloatArray:
        """The cells as SI numbers, NaN where empty."""
        return self._numbers(self.cells)

    def heading(self) -> "Heading":
        """How the column was understood: its unit, and its readings as they were typed."""
        if self.name in ("wheel", "test", *LABELS):
            return Heading(self.header, self.name, "names", ", ".join(dict.fromkeys(map(str, self.cells))))
        values = self.readings / self.scale
        there = values[~np.isnan(values)]
        ends = f", {there.min():g} to {there.max():g}" if there.size else ""
        unit = WEIGHT if self.unit in MASSES else self.unit or "no unit"
        return Heading(self.header, self.name, unit, f"{there.size}{ends}")

    def _numbers(self, cells: Sequence[Any]) -> FloatArray:
        values = [self._number(cell, row) for row, cell in enumerate(cells, start=1)]
        return np.array(values, dtype=np.float64) * self.scale

    @cached_property
    def marks(self) -> dict[int, str]:
        """``<`` or ``>`` by index of the cells that begin with it: readings known by a limit only."""
        texts = {i: cell.strip() for i, cell in enumerate(self.cells) if isinstance(cell, str)}
        return {i: text[0] for i, text in texts.items() if text[:1] in ("<", ">")}

    @cached_property
    def readings(self) -> FloatArray:
        """The cells as SI numbers, limits where they begin with ``<`` or ``>``; NaN where empty."""
        bare = [cell.strip()[1:].strip() or cell if i in self.marks else cell for i, cell in enumerate(self.cells)]
        return self._numbers(bare)

    def limits(self) -> FloatArray:
        """Limits (m, 2) of the readings, −inf and +inf where there is none."""
        ends = np.tile([-np.inf, np.inf], (len(self.cells), 1))
        for i, mark in self.marks.items():
            ends[i, "<>".index(mark)] = self.readings[i]
        return ends

    def _number(self, cell: Any, row: int) -> float:
        if type(cell) is float and abs(cell) != np.inf:  # as are most cells of a log; NaN where empty
            return cell
        if cell is None or cell is pd.NA or (isinstance(cell, str) and not cell.strip()):
            return float("nan")
        try:
            if isinstance(cell, bool | np.bool_) and self.name != "use":  # which is what truth values are for
                raise TypeError
            value = float(cell.replace("_", "?").replace("−", "-")) if isinstance(cell, str) else float(cell)
        except (TypeError, ValueError):
            mend = next((mend for form, mend in _MENDS if form.fullmatch(str(cell).strip())), "").format(self.name)
            raise StudyError(f"'{self.name}' must be a number or empty (got {cell!r}, row {row}){mend}") from None
        if np.isinf(value) or (isinstance(cell, str) and np.isnan(value)):
            raise StudyError(f"'{self.name}' must be finite or empty (got {cell}, row {row})")
        return value


_MENDS = (
    (re.compile(r"\d{4}-\d\d-\d\d.*|\d{1,2}[./]\d{1,2}[./]\d{2,4}.*"), ": a spreadsheet made a date of it"),
    (re.compile(r"[-+\d.]+ ?(±|\+/-).*"), ": errors stand in a column of their own, '{0}_sd'"),
    (re.compile(r"[-+\d.]+ ?[^\d\s.,:+-]+"), ": units stand in the header, '{0} [unit]'"),
)
"""Cells that are no numbers, and what to do."""


@dataclass(frozen=True)
class Heading:
    """How a column was understood."""

    header: str  # as it stands in the table
    name: str  # of what it holds; empty where it is left alone
    remark: str  # unit and conversion, or why it is left alone
    readings: str = ""  # how many there are, and between what


def named_columns(
    table: pd.DataFrame, scale: Callable[[str, str, str | None], float], known: Collection[str]
) -> dict[str, Column]:
    """Columns of a table by name, each once, without those that are left alone.

    Parameters
    ----------
    scale : SI value of a unit by header, name, unit; StudyError where there is no such column or unit.
    known : names that the table may have; headers may also be their synonyms.
    """
    columns: dict[str, Column] = {}
    for position, header in enumerate(map(str, table.columns)):
        (name, unit), cells = known_column(header, known), list(table.iloc[:, position])
        if name not in known and _left_alone(header, cells, known):
            continue
        scaled = scale(header, name, unit)
        if name in columns:
            both = {columns[name].header, header}
            which = f"columns {enumerated([repr(each) for each in sorted(both)])} both hold it" if len(both) > 1 else ""
            raise StudyError(f"column '{name}' must appear once ({which or 'it appears twice'})")
        columns[name] = Column(name, cells, scaled, header, "" if unit in (None, "-") else str(unit))
    return columns


def _left_alone(header: str, cells: Sequence[Any], known: Collection[str]) -> bool:
    """True for remarks: columns that say so in their header, or hold texts and have no name like a known one."""
    words = header.casefold().split()
    if not words or words[0] == "unnamed:":  # the numbers that pandas gives to rows
        return [str(cell) for cell in cells] in ([str(i + j) for i in range(len(cells))] for j in (0, 1))
    if words[0].strip(":") in REMARKS or words[0].startswith("#"):
        return True
    texts = [cell for cell in cells if isinstance(cell, str) and cell.strip()]
    return len(texts) == len(cells) > 0 and not any(map(_is_number, texts)) and not suggestion(header, known)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True


def headings(table: pd.DataFrame, columns: Mapping[str, Column]) -> tuple[Heading, ...]:
    """How every column of a table was understood."""
    by_header = {column.header: column for column in columns.values()}
    return tuple(
        by_header[header].heading() if header in by_header else Heading(header, "", "left alone")
        for header in map(str, table.columns)
    )


def _column_scale(header: str, name: str, unit: str | None) -> float:
    channel = CHANNELS.get(name.removesuffix(SD_SUFFIX))
    if name in ("wheel", "use", *LABELS) and unit is None:
        return 1.0
    if channel is None or name == "slip" + SD_SUFFIX:
        alone = "; one that is to be left alone begins with 'remark'"
        raise StudyError(f"unknown column '{header}'{did_you_mean(name, _known_columns())}{alone}")
    return unit_scale(header, name, unit, channel)


def unit_scale(header: str, name: str, unit: str | None, channel: Channel) -> float:
    """SI value of the unit of a channel's column; StudyError where it has none, or one of another kind."""
    pure = unit in (None, "", "-")
    if pure and channel.dimension:
        raise StudyError(f"column '{name}' needs a unit, e.g. '{name} [{channel.unit}]' (got '{header}')")
    if channel.dimension == "N" and unit in MASSES:
        return STANDARD_GRAVITY
    with errors_after(f"column '{header}': "):
        return factor(unit or "", channel.dimension) if not pure else 1.0


def _known_columns() -> list[str]:
    measured = [name for name in CHANNELS if name != "slip"]
    return ["slip", "wheel", "use", *measured, *(name + SD_SUFFIX for name in measured), *LABELS]


def required(columns: Mapping[str, Column], name: str) -> FloatArray:
    """A column as SI numbers (m,); StudyError where there is none, or a cell is empty."""
    if name not in columns:
        raise StudyError(f"column '{name}' is missing")
    values = columns[name].si()
    if np.isnan(values).any():
        raise StudyError(f"'{name}' must be given in every row (empty in row {_first(np.isnan(values))})")
    return values


def _first(mask: BoolArray) -> int:
    return int(np.argmax(mask)) + 1


def _wheel_names(columns: Mapping[str, Column], length: int, wheels: tuple[str, ...]) -> tuple[str, ...]:
    if "wheel" not in columns and len(wheels) == 1:
        return wheels * length
    if "wheel" not in columns:
        raise StudyError(f"column 'wheel' is needed with several wheels ({', '.join(wheels)})")
    names = labels(columns["wheel"])
    for row, name in enumerate(names, start=1):
        if name not in wheels:
            raise StudyError(f"unknown wheel '{name}' in row {row}{did_you_mean(name, wheels)}")
    return names


def labels(column: Column) -> tuple[str, ...]:
    """A column as names; StudyError where a cell is empty or no name."""
    names = tuple("" if pd.isna(cell) else str(cell).strip() for cell in column.cells)
    for row, name in enumerate(names, start=1):
        if not name:
            raise StudyError(f"'{column.name}' must be given in every row (empty in row {row})")
        checked_name(name, f"'{column.name}' in row {row}")
    return names


def used_rows(columns: Mapping[str, Column], length: int) -> BoolArray:
    """Column ``use`` (m,); all rows where there is none, StudyError for what is neither 0 nor 1."""
    if "use" not in columns:
        return np.ones(length, dtype=np.bool_)
    values = columns["use"].si()
    wrong = ~np.isin(values, (0.0, 1.0))
    if wrong.any():
        row = _first(wrong)
        raise StudyError(f"'use' must be 0 or 1 (got {columns['use'].cells[row - 1]!r}, row {row})")
    return np.asarray(values == 1.0)


def _given_sd(columns: Mapping[str, Column], length: int) -> dict[str, FloatArray]:
    """Standard deviations of every measured channel, NaN where the table has none."""
    sd = {name: np.full(length, np.nan) for name in ("load", *OUTCOMES) if name in columns}
    for name, column in columns.items():
        if name in CHANNELS or not name.endswith(SD_SUFFIX):
            continue
        channel, values = name.removesuffix(SD_SUFFIX), column.si()
        if channel not in columns:
            raise StudyError(f"column '{name}' needs a column '{channel}' beside it")
        if (values < LEAST).any():
            row = _first(values < LEAST)
            rule = "above 0" if values[row - 1] <= 0 else f"at least {LEAST / column.scale:g}{column.stated}"
            raise StudyError(f"'{name}' must be {rule} (got {column.cells[row - 1]}{column.stated}, row {row})")
        sd[channel] = values
    return sd


def _referenced(
    raw: Observations, wheels: Mapping[str, Wheel], slip_reference: str, sinkage_reference: str
) -> Observations:
    """Convert slip by (3) to the shearing radius, and sinkage to the rim."""
    of_row = [wheels[name] for name in raw.wheel]
    shearing = np.array([wheel.shearing_radius() for wheel in of_row])
    lug = np.array([wheel.lug_height for wheel in of_row])
    rim = np.array([wheel.radius for wheel in of_row])
    behind = {"rim": rim, "tip": rim + lug, "shearing": shearing}[slip_reference]
    slip = raw.slip if slip_reference == "shearing" else np.asarray(convert_slip(raw.slip, behind, shearing))
    values, limits = dict(raw.values), dict(raw.limits)
    if "sinkage" in values and sinkage_reference == "tip":
        values["sinkage"] = values["sinkage"] - lug
        if "sinkage" in limits:
            limits["sinkage"] = limits["sinkage"] - lug[:, None]
    return replace(raw, slip=slip, values=values, limits=limits)


def sifted(observations: Observations, problems: Sequence[str | None]) -> Observations:
    """Refuse rows in use that have a problem; leave unused ones out, with one note.

    ``problems`` say what is wrong with each row (m,), None where nothing is.
    """
    for problem, used in zip(problems, observations.use, strict=True):
        if problem and used:
            raise StudyError(problem)
    keep = np.array([problem is None for problem in problems])
    reasons = [problem for problem in problems if problem]
    more = f"; {len(reasons) - 1} more rows likewise" if len(reasons) > 1 else ""
    notes = (f"row left out, as its 'use' is 0: {reasons[0]}{more}",) if reasons else ()
    return replace(observations, notes=observations.notes + notes).take(keep)


def _problem(
    rows: Observations, index: int, slip: float, wheels: Mapping[str, Wheel], columns: Mapping[str, Column]
) -> str | None:
    """The problem that takes one row outside the model's range, in the units of the table; or None."""
    row, radius = rows.rows[index], wheels[rows.wheel[index]].radius
    converted, load = float(rows.slip[index]), float(rows.load[index])

    def typed(name: str, value: float) -> str:
        return f"{value / columns[name].scale:.6g}{columns[name].stated}"

    if not 0 <= converted < 1:
        became = "" if converted == slip else f", on the shearing radius {converted / columns['slip'].scale:.4g}"
        percent = ": percent stand in a column 'slip [%]'" if slip > 1.5 and not columns["slip"].unit else ""
        percent = ": rows of a braked wheel are left out by 0 in a column 'use'" if slip < 0 else percent
        unit = columns["slip"].stated
        got = f"got {typed('slip', slip)}{became}{unit if became else ''}, row {row}"
        return f"'slip' must lie in [0, {1 / columns['slip'].scale:g}){unit} ({got}){percent}"
    # a wheel pulls less than it carries
    loads = np.concatenate([rows.load, rows.values.get("normal_force", rows.load[:0])])
    carried = np.abs(loads[np.isfinite(loads) & (np.abs(loads) <= MOST_LOAD)])
    greatest = MOST * float(carried.max(initial=10.0)) * max(1.0, radius)
    for name, column in {"load": rows.load, **rows.values}.items():
        most = {"load": MOST_LOAD, "normal_force": MOST_LOAD, "sinkage": radius}.get(name, greatest)
        if abs(column[index]) > most and not (name == "sinkage" and column[index] > 0):
            return f"'{name}' must lie within ±{typed(name, most)} (got {typed(name, column[index])}, row {row})"
    if load <= 0:
        return f"'load' must be above 0 (got {typed('load', load)}, row {row})"
    if "sinkage" in rows.values and (sinkage := float(rows.values["sinkage"][index])) >= radius:
        below, got = typed("sinkage", radius), typed("sinkage", sinkage)
        return f"'sinkage' must be below the wheel radius {below} (got {got}, row {row})"
    return None
