"""Tables as CSV, from which no spreadsheet takes a text for a formula, and read back as they were; records.

Every table that the package writes goes through :func:`csv_text`. A text that begins with one of ``= + - @``
(or their full-width forms), a tab or a line break, and is no number, gets an apostrophe before it; so does
one that begins with apostrophes before any of these. Our own readers take that apostrophe off again.
"""

import codecs
import csv
import json
import math
import re
import zipfile
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from datetime import date, time
from io import BytesIO, StringIO
from pathlib import Path
from typing import Annotated, Any, ClassVar, TextIO

import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from bayesterra.errors import ResultError, StudyError, counted
from bayesterra.runtime.folders import write_text
from bayesterra.runtime.reading import MEGABYTE, MOST_TABLE, read_bytes, read_json, read_text, reason
from bayesterra.runtime.recordings import is_bag, recording_cells

LONGEST = 10_000
"""Characters, at most, of a cell."""
MOST_COLUMNS = 1000
MOST_ROWS = 200_000
LONGEST_LINE = 2**20
"""Characters, at most, of a line of a table that is read row by row."""

_EXACT: dict[str, Any] = {} if pd.__version__ >= "3" else {"float_precision": "round_trip"}
"""How numbers are read back to the last digit; pandas does so by itself from 3.0 on."""
_FORMULA = re.compile(r"'*(\s*[=+\-@＝＋－＠].|[\t\r\n])", re.DOTALL)  # a sign alone is none
_NUMBER = re.compile(r"[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?|[-+]?(inf|nan)")


def shielded(text: str) -> str:
    """The text as it is written, harmless in a spreadsheet."""
    return f"'{text}" if _formula_like(text) else text


def unshielded(text: str) -> str:
    """The inverse of :func:`shielded`; what a person wrote without thinking of formulas stays."""
    return text[1:] if text.startswith("'") and _formula_like(text[1:]) else text


def _formula_like(text: str) -> bool:
    return _FORMULA.match(text) is not None and _NUMBER.fullmatch(text) is None


def csv_text(table: pd.DataFrame, float_format: str | None = None) -> str:
    """A table as CSV with a header and without its index; texts are shielded, numbers stay numbers."""
    safe = _with_texts(table, shielded)
    text: str = safe.to_csv(index=False, float_format=float_format)
    if "\r" in text:  # which Python's writer leaves without quotes
        text = safe.to_csv(index=False, float_format=float_format, quoting=csv.QUOTE_NONNUMERIC)
    return text


def _with_texts(table: pd.DataFrame, change: Callable[[str], str]) -> pd.DataFrame:
    """The table with its texts changed, those of the header too."""

    def changed(value: Any) -> Any:
        return change(value) if isinstance(value, str) else value

    other = table.rename(columns=changed)
    for position, kind in enumerate(table.dtypes):
        if not pd.api.types.is_numeric_dtype(kind):
            other.isetitem(position, [changed(value) for value in table.iloc[:, position]])
    return other


def read_csv(path: Path) -> pd.DataFrame:
    """Read a table that :func:`csv_text` wrote; numbers become numbers.

    OSError or ValueError where it cannot be read, or is no such table.
    """
    text = read_text(path, MOST_TABLE)
    try:
        for _ in _lines(StringIO(text, newline="")):
            pass  # the shape is checked before another parser sees it
    except StudyError as error:
        raise ValueError(f"{path.name} {error}") from error
    return _with_texts(pd.read_csv(StringIO(text), **_EXACT), unshielded)


def read_cells(
    path: Path, sheet: str = "", decimal: str | None = None, *, size: int = MOST_TABLE, rows: int = MOST_ROWS
) -> tuple[list[list[Any]], str]:
    """Lines of a table as people have them, none of them blank, and what its form is in words.

    Parameters
    ----------
    path : text in UTF-8, UTF-16 or Latin-1, separated by commas, semicolons or tabs; an Excel workbook; or
        what :func:`bayesterra.runtime.recordings.recording_cells` reads.
    sheet : of the workbook; needed where it has several.
    decimal : ``,`` or ``.``; the other one then stands between thousands. By default what the cells tell.
    size, rows : bytes and rows, at most.

    Returns
    -------
    cells : header first, all lines of its length. Numbers in text have decimal points; numbers of a
        workbook are numbers, its dates texts.
    form : e.g. ``UTF-16, tabs, decimal commas``.

    Raises
    ------
    StudyError : there is no such file, it is too large, no table, or can be read in two ways; what to do.
    """
    try:
        content = b"" if is_bag(path) and path.exists() else read_bytes(path, size)
        recording, form = recording_cells(path, content, rows)
    except FileNotFoundError as error:
        raise StudyError("no such file of measurements") from error
    except OSError as error:
        raise StudyError(f"cannot be read ({reason(error)})") from error
    if content.startswith(b"\xd0\xcf\x11\xe0"):
        raise StudyError("is a workbook of an old form: save it as .xlsx or as CSV")
    workbook = content.startswith(b"PK")
    if sheet and not workbook:
        raise StudyError(f"is no .xlsx workbook, so it has no sheet '{sheet}': leave 'sheet' out")
    if form:
        return recording, form
    lines, form = _sheet(content, sheet, rows) if workbook else _separated(*_decoded(content), rows)
    cells = _rectangular(lines)
    doubtful = ",." if form.endswith(SEPARATORS[";"]) else ","  # beside commas "1.234" has a decimal point
    pointed, mark = _with_points(cells, decimal, doubtful=doubtful)
    return pointed, f"{form}, {mark}" if mark else form


def _decoded(content: bytes) -> tuple[str, str]:
    """Text and the name of its encoding; StudyError where it is damaged UTF-8, or no text."""
    wide = content[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    if wide or b"\0" in content[:2]:
        name = "utf-16" if wide else "utf-16-be" if content[:1] == b"\0" else "utf-16-le"
        try:
            return content.decode(name), "UTF-16"
        except UnicodeDecodeError as error:
            raise StudyError(f"must be text (byte {error.start} is no UTF-16)") from error
    try:
        return content.decode("utf-8-sig"), "UTF-8"
    except UnicodeDecodeError as error:
        if not content.decode("utf-8", "ignore").isascii() or b"\0" in content:
            raise StudyError(f"must be UTF-8 text (byte {error.start} is not)") from error
    return content.decode("latin-1"), "Latin-1"


SEPARATORS = {",": "commas", ";": "semicolons", "\t": "tabs"}


def _separated(text: str, encoding: str, most: int) -> tuple[list[list[str]], str]:
    """Lines of a text, and its form; StudyError where the header leaves two separators open."""
    first, _, rest = text.lstrip("\r\n").partition("\n")
    if stated := re.fullmatch(r"sep=([,;\t])\r?", first):  # as Excel writes it
        text, separators = rest, [stated[1]]
    else:
        bare = re.sub(r'"[^"]*"|\[[^\]]*\]|\([^)]*\)', "", first)
        separators = [separator for separator in SEPARATORS if separator in bare] or [","]
    tables = {each: list(_lines(StringIO(text, newline=""), most, each)) for each in separators}
    even = {each: lines for each, lines in tables.items() if len({len(line) for line in lines}) == 1}
    if len(tables) > 1 and len(even) != 1:
        names = " or ".join(SEPARATORS[each] for each in tables)
        raise StudyError(f"columns may be separated by {names}: take the others out of the header (got {first!r:.80})")
    separator, lines = next(iter((even or tables).items()))
    return lines, f"{encoding}, {SEPARATORS[separator]}"


MOST_UNPACKED = 256 * MEGABYTE


def _sheet(content: bytes, sheet: str, most: int) -> tuple[list[list[Any]], str]:
    """Lines of a sheet of an Excel workbook, by openpyxl: pandas takes cells with errors for empty ones."""
    try:
        import openpyxl
    except ImportError as error:
        raise StudyError("Excel workbooks need openpyxl: pip install 'bayesterra[excel]', or save as CSV") from error
    try:
        with zipfile.ZipFile(BytesIO(content)) as archive:
            if sum(member.file_size for member in archive.infolist()) > MOST_UNPACKED:
                raise StudyError(f"is larger than {MOST_UNPACKED // MEGABYTE} MB when unpacked")
        book = openpyxl.load_workbook(BytesIO(content), read_only=True, data_only=True)
        names = [page.title for page in book.worksheets]
        chosen = _chosen_sheet(sheet, names)
        page = book[chosen]
        page.reset_dimensions()  # which other programs write as they like
        lines = list(_sheet_lines(page.iter_rows(), most))
        width = max(map(len, lines), default=0)
        return [[*line, *[""] * (width - len(line))] for line in lines], f"Excel, sheet '{chosen}'"
    except StudyError:
        raise
    except Exception as error:  # a damaged workbook fails in zip, XML or openpyxl, each with errors of its own
        raise StudyError(f"is no Excel workbook that can be read ({reason(error)})") from error


def _chosen_sheet(sheet: str, names: Sequence[str]) -> str:
    listed = ", ".join(f"'{name}'" for name in names)
    if sheet and sheet not in names:
        raise StudyError(f"has no sheet '{sheet}' (it has {listed})")
    if not sheet and len(names) != 1:
        raise StudyError(
            f"has {len(names)} sheets ({listed}): say which, e.g. sheet = {json.dumps(names[0])} in [data] (or --sheet)"
        )
    return sheet or names[0]


def _sheet_lines(rows: Iterable[Sequence[Any]], most: int) -> Iterator[list[Any]]:
    """Lines of a sheet that are not blank, within the limits; dates as texts, percents as they show below a % sign."""
    count, percents = 0, list[bool]()
    for row in rows:
        cells = [_sheet_value(cell, i < len(percents) and percents[i]) for i, cell in enumerate(row)]
        while cells and not str(cells[-1]).strip():
            cells.pop()
        _check_cells(cells, count)
        if cells:
            percents = percents or [_PERCENT.search(str(title)) is not None for title in cells]
            count += 1
            yield cells
        if count > most + 1:
            raise StudyError(f"must have at most {most} rows")


_PERCENT, _LITERAL = re.compile(r"%|percent|pct\b", re.IGNORECASE), re.compile(r'"[^"]*"|\\.')
"""Units of headers that are percents; what a number format shows as it stands."""


def _sheet_value(cell: Any, percent: bool) -> Any:
    """Value of a cell of a sheet; where the column is in ``percent``, a cell that shows 10 % says 10."""
    value = cell.value
    if percent and isinstance(value, float | int) and "%" in _LITERAL.sub("", cell.number_format or ""):
        return round(100 * value, 12)
    return "" if value is None else str(value) if isinstance(value, date | time) else value


def _rectangular(lines: list[list[Any]]) -> list[list[Any]]:
    """Lines as long as the header, without columns that have neither header nor cells; StudyError else."""
    if len(lines) < 2:
        raise StudyError("must hold a header and at least one row of measurements (the table is empty)")
    width = max((i for i, name in enumerate(lines[0], start=1) if str(name).strip()), default=0)
    for number, line in enumerate(lines[1:], start=1):
        if len(line) < width or any(str(cell).strip() for cell in line[width:]):
            title = (
                f", as the first line has, which must be the header ({str(lines[0][0])!r:.60})" if width == 1 else ""
            )
            raise StudyError(f"every row must have {counted(width, 'cell')}{title} (got {len(line)}, row {number})")
    if width == 1 and len(str(lines[1][0]).split()) > 1:
        raise StudyError(f"columns must be separated by commas, semicolons or tabs (got {str(lines[1][0])!r:.60})")
    kept = [i for i in range(width) if any(str(line[i]).strip() for line in lines)]
    return [[line[i] for i in kept] for line in lines]


_PLAIN = {mark: re.compile(rf"[-+]?(\d+({re.escape(mark)}\d*)?|{re.escape(mark)}\d+)([eE][-+]?\d+)?") for mark in ",."}
_GROUPED = {
    mark: re.compile(rf"[-+]?[1-9]\d{{0,2}}({re.escape(other)}\d{{3}})+({re.escape(mark)}\d*)?")
    for mark, other in (",.", ".,")
}
"""Numbers with a decimal mark; and with the other one between thousands."""


def _readings(cell: str) -> dict[str, str]:
    """Python's text of a number under each decimal mark that it may be written with."""
    found, cell = {}, cell.replace("−", "-")
    for mark, other in (",.", ".,"):
        if _PLAIN[mark].fullmatch(cell):
            found[mark] = cell.replace(mark, ".")
        elif _GROUPED[mark].fullmatch(cell):
            found[mark] = cell.replace(other, "").replace(mark, ".")
    return found


def _with_points(lines: list[list[Any]], decimal: str | None, *, doubtful: str) -> tuple[list[list[Any]], str]:
    """Lines with decimal points, and how they were written; ``doubtful`` marks need a cell that shows it."""
    marked = {mark for line in lines[1:] for cell in line if isinstance(cell, str) for mark in ",." if mark in cell}
    if decimal != "," and not marked & {",", *doubtful}:
        return lines, ""
    mark = decimal or _decimal_mark(lines[1:], doubtful)
    pointed = [[_pointed(cell, mark) for cell in line] for line in lines[1:]]
    return [lines[0], *pointed], "decimal commas" if mark == "," else "decimal points"


def _decimal_mark(rows: list[list[Any]], doubtful: str) -> str:
    """What separates decimals in the numbers of rows; StudyError where they leave that open."""
    shown: dict[str, str] = {}
    either: dict[str, str] = {}
    for row, line in enumerate(rows, start=1):
        for cell in line:
            bare = cell.strip().lstrip("<> ") if isinstance(cell, str) and ("," in cell or "." in cell) else ""
            readings = _readings(bare) if bare else {}
            if len(readings) == 1:
                shown.setdefault(next(iter(readings)), f"'{bare}', row {row}")
            elif readings:
                mark = "," if "," in bare else "."
                either.setdefault(mark, f"'{bare}' in row {row} may be {' or '.join(readings.values())}")
    if len(shown) == 2:
        raise StudyError(f"has decimal commas ({shown[',']}) and points ({shown['.']}){_ASKED}")
    mark = next(iter(shown), "," if "," in either else ".")
    for other, doubt in either.items():
        if other != mark or (not shown and other in doubtful):
            raise StudyError(f"{doubt}{_ASKED}")
    return mark


_ASKED = ': say what separates decimals, decimal = "," or decimal = "." in [data] (or --decimal)'


def _pointed(cell: Any, mark: str) -> Any:
    """A cell with a decimal point, where it is text of a number under a decimal mark."""
    if not isinstance(cell, str) or not ("," in cell or "." in cell):
        return cell
    sign = cell.strip()[:1] if cell.strip()[:1] in ("<", ">") else ""
    reading = _readings(cell.strip().lstrip("<> ")).get(mark)
    return sign + reading if reading else cell


def _lines(text: Iterable[str], most: int | None = MOST_ROWS, separator: str = ",") -> Iterator[list[str]]:
    """Lines that are not blank, within the limits."""
    count = 0
    try:
        for line in csv.reader(text, strict=True, delimiter=separator):
            _check_cells(line, count)
            if any(cell.strip() for cell in line):
                count += 1
                yield [unshielded(cell) for cell in line]
            if most is not None and count > most + 1:
                raise StudyError(f"must have at most {most} rows")
    except csv.Error as error:
        words = f"{SEPARATORS[separator].removesuffix('s')}-separated"
        raise StudyError(f"must be a table of {words} values ({error})") from error


def _check_cells(line: Sequence[Any], row: int) -> None:
    if len(line) > MOST_COLUMNS:
        raise StudyError(f"must have at most {MOST_COLUMNS} columns (got {len(line)})")
    if any(isinstance(cell, str) and len(cell) > LONGEST for cell in line):
        raise StudyError(f"cells must have at most {LONGEST} characters (row {row})")


def rows_of_cells(text: TextIO) -> Iterator[list[str]]:
    """Lines of a CSV that comes in bit by bit, however long it goes on; blank lines do not count.

    StudyError where it is no CSV, no UTF-8, or a line is too long.
    """
    try:
        yield from _lines(_bounded(text), most=None)
    except UnicodeDecodeError as error:
        raise StudyError(f"must be UTF-8 text (byte {error.start} of a block is not)") from error


def _bounded(text: TextIO) -> Iterator[str]:
    """Lines of a text that may have no line breaks at all."""
    first = True
    while line := text.readline(LONGEST_LINE + 1):
        if len(line) > LONGEST_LINE:
            raise StudyError(f"lines must have at most {LONGEST_LINE} characters")
        yield line.removeprefix("\ufeff") if first else line
        first = False


Number = Annotated[float, Field(gt=-1e300, lt=1e300, allow_inf_nan=False)]
Count = Annotated[int, Field(ge=0, lt=10**15)]
"""A whole number that some study reaches."""


class Record(BaseModel):
    """The content of a JSON file; entries that it does not name may be there, and stay as they are.

    ``FORMAT`` is the number of the form in which the file is written; one without a number has form 1.
    """

    model_config = ConfigDict(strict=True, extra="allow")
    FORMAT: ClassVar[int] = 1

    @classmethod
    def having(cls, **kinds: Any) -> "type[Record]":
        """A model of records that have more entries, each of its kind."""
        entries: dict[str, Any] = {name: (kind, ...) for name, kind in kinds.items()}
        return create_model(cls.__name__, __base__=cls, **entries)

    @classmethod
    def write(cls, path: Path, content: Mapping[str, Any]) -> None:
        """Write a record, its format number first; NaN and infinities become null."""
        stamped = {"format": cls.FORMAT, **{k: v for k, v in content.items() if k != "format"}}
        write_text(path, json.dumps(plain(stamped), indent=1, ensure_ascii=False, allow_nan=False) + "\n")

    @classmethod
    def read(cls, path: Path) -> dict[str, Any]:
        """Content of a file that :meth:`write` wrote, or a version before there were format numbers.

        OSError or ValueError where it cannot be read, or is no such record; ResultError where it has another format.
        """
        content = read_json(path)
        if isinstance(content, dict) and (number := content.get("format", 1)) != cls.FORMAT:
            raise ResultError(
                f"'{path}' has format {number!r:.40}, and this version of bayesterra reads format"
                f" {cls.FORMAT}: open it with the version that wrote it"
            )
        cls.check(content, path.name)
        return dict(content)

    @classmethod
    def check(cls, content: Any, name: str) -> None:
        """ValueError where something is missing, or of another kind than is relied on."""
        try:
            cls.model_validate(content)
        except ValidationError as error:
            for first in error.errors():
                *outer, last = (name, *map(str, first["loc"]))
                if first["type"] == "missing" and len(outer) == 1 and last in cls.excused(content):
                    continue
                if first["type"] == "missing":
                    raise ValueError(f"{': '.join(outer):.200} lacks '{last}'") from None
                reason = str(first.get("ctx", {}).get("error", "is of the wrong kind"))
                place = ": ".join((*outer, last))
                raise ValueError(f"{place:.200} {reason} (got {first['input']!r:.40})") from None

    @classmethod
    def excused(cls, content: dict[str, Any]) -> Collection[str]:
        """Entries that may be missing from a record, for a reason that it gives."""
        return ()


def plain(value: Any) -> Any:
    """A value that JSON can hold: NaN and infinities become null, NumPy numbers Python ones."""
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value
