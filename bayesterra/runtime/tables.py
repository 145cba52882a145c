"""Tables as CSV, from which no spreadsheet takes a text for a formula, and read back as they were; records.

Every table that the package writes goes through :func:`csv_text`. A text that begins with one of ``= + - @``
(or their full-width forms), a tab or a line break, and is no number, gets an apostrophe before it; so does
one that begins with apostrophes before any of these. Our own readers take that apostrophe off again.
"""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from io import StringIO
from pathlib import Path
from typing import Annotated, Any, ClassVar, TextIO

import pandas as pd
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from bayesterra.errors import ResultError, StudyError
from bayesterra.runtime.folders import write_text
from bayesterra.runtime.reading import MOST_TABLE, read_json, read_text, reason

LONGEST = 10_000
"""Characters, at most, of a cell."""
MOST_COLUMNS = 1000
MOST_ROWS = 200_000
LONGEST_LINE = 2**20
"""Characters, at most, of a line of a table that is read row by row."""

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
    return _with_texts(pd.read_csv(StringIO(text)), unshielded)


def read_cells(path: Path) -> list[list[str]]:
    """Lines of a CSV file as texts, none of them blank; StudyError without one, or where it is too large."""
    try:
        return list(_lines(StringIO(read_text(path, MOST_TABLE), newline="")))
    except FileNotFoundError as error:
        raise StudyError("no such file of measurements") from error
    except OSError as error:
        raise StudyError(f"cannot be read ({reason(error)})") from error
    except UnicodeDecodeError as error:
        raise StudyError(f"must be UTF-8 text (byte {error.start} is not)") from error


def _lines(text: Iterable[str], most: int | None = MOST_ROWS) -> Iterator[list[str]]:
    """Lines that are not blank, within the limits."""
    count = 0
    try:
        for line in csv.reader(text, strict=True):
            if len(line) > MOST_COLUMNS:
                raise StudyError(f"must have at most {MOST_COLUMNS} columns (got {len(line)})")
            if any(len(cell) > LONGEST for cell in line):
                raise StudyError(f"cells must have at most {LONGEST} characters (row {count})")
            if any(cell.strip() for cell in line):
                count += 1
                yield [unshielded(cell) for cell in line]
            if most is not None and count > most + 1:
                raise StudyError(f"must have at most {most} rows")
    except csv.Error as error:
        raise StudyError(f"must be a table of comma-separated values ({error})") from error


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
    def having(cls, **kinds: Any) -> type[Record]:
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

        Raises
        ------
        OSError, ValueError : it cannot be read, or is no such record.
        ResultError : it has another format.
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
