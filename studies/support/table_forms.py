"""Four rows of a wheel as people write them down: forms of one table, and tables that leave something open."""

from __future__ import annotations

import codecs
import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import date
from typing import Any

import openpyxl
import pandas as pd
from scipy.io import savemat

HEADER = ("slip", "load [N]", "sinkage [mm]", "drawbar_pull [N]", "resistance_moment [N m]")
ROWS = (
    (0.1, 80.0, 5.25, 14.0, 3.5),
    (0.2, 80.5, 7.5, 20.125, 5.0),
    (0.3, 79.5, None, 24.5, 6.25),
    (0.4, 80.0, 12.0, 27.0, 7.0),
)
"""None is not measured. Binary fractions but for the slips, so that conversions are exact to the last digits."""


@dataclass(frozen=True)
class TableForm:
    """A table in one form.

    Attributes
    ----------
    name : what is special about it.
    file : name of the file.
    content : of the file.
    data : keys of [data] that go with it.
    asks : part of the line that is said of it where it cannot be taken as it is; empty: it means ``ROWS``.
    """

    name: str
    content: bytes
    file: str = "table.csv"
    data: Mapping[str, str] = field(default_factory=dict)
    asks: str = ""


def text_of(
    header: Sequence[str] = HEADER,
    rows: Sequence[Sequence[object]] = ROWS,
    *,
    sep: str = ",",
    point: str = ".",
    end: str = "\n",
    more: str = "",
    quoted: bool = False,
) -> str:
    """The table as text: separator, decimal mark, line ends, what every line ends with, quotes."""

    def cell(value: object) -> str:
        written = "" if value is None else f"{value:g}".replace(".", point) if isinstance(value, float) else str(value)
        return f'"{written}"' if quoted or (sep in written and not isinstance(value, str)) else written

    return "".join(sep.join(map(cell, line)) + more + end for line in (header, *rows))


def changed(column: int, change: Callable[[float], object]) -> list[list[object]]:
    """The rows with one column written otherwise."""
    return [[change(cell) if i == column and cell is not None else cell for i, cell in enumerate(row)] for row in ROWS]


def workbook(*sheets: tuple[str, Sequence[Sequence[Any]]]) -> bytes:
    """An Excel workbook of sheets with names."""
    book, file = openpyxl.Workbook(), io.BytesIO()
    book.remove(book.active)
    for name, lines in sheets:
        page = book.create_sheet(name)
        for line in lines:
            page.append(list(line))
    book.save(file)
    return file.getvalue()


def _texts() -> list[TableForm]:
    semicolons, german = text_of(sep=";"), text_of(sep=";", point=",")
    noted = text_of(("remark", *HEADER), [("Böschung, 20 °C", *row) for row in ROWS], sep=";", point=",")
    return [
        TableForm("commas", text_of().encode()),
        TableForm("a byte order mark", codecs.BOM_UTF8 + text_of().encode()),
        TableForm("CRLF", text_of(end="\r\n").encode()),
        TableForm("CR, as old Macs", text_of(end="\r").encode()),
        TableForm("everything in quotes", text_of(quoted=True).encode()),
        TableForm("commas after the last column", text_of(more=",").encode()),
        TableForm("commas and blank lines at the end", (text_of() + ",,,,\n\n,,,,\n").encode()),
        TableForm("semicolons", semicolons.encode()),
        TableForm("semicolons, decimal commas", german.encode()),
        TableForm("semicolons, decimal commas, sep=", ("sep=;\r\n" + german).encode()),
        TableForm("commas, decimal commas in quotes", text_of(point=",").encode()),
        TableForm("tabs", text_of(sep="\t").encode()),
        TableForm("tabs, decimal commas", text_of(sep="\t", point=",").encode()),
        TableForm("UTF-16, tabs, as Excel's Unicode text", text_of(sep="\t").encode("utf-16")),
        TableForm("UTF-16 little endian, decimal commas", codecs.BOM_UTF16_LE + german.encode("utf-16-le")),
        TableForm("UTF-16 big endian", codecs.BOM_UTF16_BE + text_of().encode("utf-16-be")),
        TableForm("UTF-16 without a mark", german.encode("utf-16-le")),
        TableForm("Latin-1 remarks", noted.encode("latin-1")),
        TableForm("UTF-8 remarks", noted.encode()),
        TableForm(
            "remarks, dates, operators",
            text_of(
                ("date", *HEADER, "# checked", "driver"), [("2021-03-16", *row, 3, "C. P.") for row in ROWS]
            ).encode(),
        ),
        TableForm(
            "dates under another name", text_of(("day", *HEADER), [("16.03.2021", *row) for row in ROWS]).encode()
        ),
        TableForm("round brackets", text_of([name.replace("[", "(").replace("]", ")") for name in HEADER]).encode()),
        TableForm(
            "thousands in one column",
            text_of(
                ("slip", "load [mN]", *HEADER[2:]), changed(1, lambda load: f"{load * 1e3:,.1f}"), sep=";"
            ).encode(),
        ),
        TableForm(
            "thousands apart by points",
            text_of(
                ("slip", "load [mN]", *HEADER[2:]),
                changed(1, lambda load: f"{load * 1e3:,.1f}".translate(str.maketrans(",.", ".,"))),
                sep=";",
                point=",",
            ).encode(),
        ),
        TableForm(
            "numbers of rows, as pandas writes them",
            text_of(("", *HEADER), [(str(i), *row) for i, row in enumerate(ROWS)]).encode(),
        ),
        TableForm("an order of its own", text_of(HEADER[::-1], [row[::-1] for row in ROWS]).encode()),
        TableForm("spaces around everything", text_of().replace(",", " , ").encode()),
        TableForm(
            "a column of its own without a header, empty", text_of(("", *HEADER), [("", *row) for row in ROWS]).encode()
        ),
    ]


def _names() -> list[TableForm]:
    def renamed(*header: str, **how: Any) -> bytes:
        return text_of(header, **how).encode()

    kilograms = changed(1, lambda load: f"{load / 9.80665:.17g}")
    percent = [
        [100 * row[0], row[1] / 1e3, *(x and x / 10 for x in row[2:3]), row[3] / 1e3, row[4] * 1e3] for row in ROWS
    ]
    return [
        TableForm("letters of the paper", renamed("s", "W [N]", "z [mm]", "F_DP [N]", "M_DR [N m]")),
        TableForm("other letters", renamed("slip ratio", "F_z [N]", "z [mm]", "DP [N]", "torque [N m]")),
        TableForm(
            "words in capitals",
            renamed("Slip [-]", "Load [N]", "Wheel sinkage [mm]", "Drawbar Pull [N]", "Torque [N*m]"),
        ),
        TableForm("axes of a sensor", renamed("s", "Fz [N]", "sinkage [mm]", "Fx [N]", "My [N m]")),
        TableForm(
            "percent, kN, cm, N mm",
            renamed(
                "slip [%]", "load [kN]", "sinkage [cm]", "DP [kN]", "M [N mm]".replace("M ", "moment "), rows=percent
            ),
        ),
        TableForm("units at the end of names", renamed("slip", "load_N", "sinkage_mm", "DP_N", "torque_Nm")),
        TableForm("loads in kilograms", renamed("slip", "load [kg]", *HEADER[2:], rows=kilograms)),
        TableForm("loads in kilograms of force", renamed("slip", "load [kgf]", *HEADER[2:], rows=kilograms)),
    ]


def _workbooks() -> list[TableForm]:
    lines, other = (HEADER, *ROWS), (("what", "who"), ("a wheel", "us"))
    texts = [[cell if cell is None else f"{cell:g}".replace(".", ",") for cell in row] for row in ROWS]
    dated = [("day", *HEADER, "remark"), *((date(2021, 3, 16), *row, "fine") for row in ROWS)]
    return [
        TableForm("Excel", workbook(("rows", lines)), "table.xlsx"),
        TableForm(
            "Excel, one sheet of two", workbook(("about", other), ("Test 1", lines)), "t.xlsx", {"sheet": "Test 1"}
        ),
        TableForm("Excel, dates and remarks", workbook(("rows", dated)), "table.xlsx"),
        TableForm("Excel, numbers as text with commas", workbook(("rows", (HEADER, *texts))), "table.xlsx"),
        TableForm(
            "Excel, two sheets",
            workbook(("about", other), ("Test 1", lines)),
            "table.xlsx",
            asks="has 2 sheets ('about', 'Test 1'): say which, e.g. sheet = \"about\" in [data]",
        ),
        TableForm(
            "Excel, an error in a cell",
            workbook(("rows", (HEADER, (0.1, 80.0, "#DIV/0!", 14.0, 3.5)))),
            "table.xlsx",
            asks="'sinkage' must be a number or empty (got '#DIV/0!', row 1)",
        ),
    ]


def _recordings() -> list[TableForm]:
    columns = pd.DataFrame(ROWS, columns=pd.Index(HEADER), dtype=float)
    parquet, matlab = io.BytesIO(), io.BytesIO()
    columns.set_index("slip").to_parquet(parquet)
    names = ("slip", "load_N", "sinkage_mm", "drawbar_pull_N", "torque_Nm")
    savemat(matlab, {"test": dict(zip(names, columns.to_numpy().T, strict=True))})
    return [
        TableForm("Parquet, slip as the index", parquet.getvalue(), "table.parquet"),
        TableForm("MATLAB, a struct of vectors", matlab.getvalue(), "table.mat"),
        TableForm(
            "MATLAB, version 7.3",
            b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(512) + b"\x89HDF\r\n\x1a\n",
            "table.mat",
            asks="is a MATLAB file of version 7.3: save it with save('log.mat', '-v7')",
        ),
    ]


def _open() -> list[TableForm]:
    heavy = "slip [%];load [N];sinkage [mm]\n10;1,234;5\n20;1,250;7\n"
    answer = 'say what separates decimals, decimal = "," or decimal = "."'
    return [
        TableForm(
            "1,234 and nothing beside it", heavy.encode(), asks=f"'1,234' in row 1 may be 1.234 or 1234: {answer}"
        ),
        TableForm(
            "1,234 beside decimal points", heavy.replace(";5", ";5.25").encode(), asks=f"may be 1.234 or 1234: {answer}"
        ),
        TableForm(
            "1.234 between semicolons",
            heavy.replace(",", ".").encode(),
            asks=f"'1.234' in row 1 may be 1234 or 1.234: {answer}",
        ),
        TableForm(
            "commas and points",
            text_of(sep=";").replace("5.25", "5,25").encode(),
            asks=f"has decimal commas ('5,25', row 1) and points ('0.1', row 1): {answer}",
        ),
        TableForm(
            "two separators in the header",
            b"slip;load [N],DP [N]\n0.1;80,3\n",
            asks="columns may be separated by commas or semicolons",
        ),
        TableForm(
            "a slip twice",
            text_of(("slip", "s", *HEADER[2:])).encode(),
            asks="column 'slip' must appear once (columns 's' and 'slip' both hold it)",
        ),
        TableForm(
            "a column that nobody knows",
            text_of((*HEADER[:4], "power [W]")).encode(),
            asks="unknown column 'power [W]'",
        ),
        TableForm(
            "a mistyped column",
            text_of((*HEADER[:2], "sinkge [mm]", *HEADER[3:])).encode(),
            asks="(did you mean 'sinkage'?)",
        ),
        TableForm(
            "percent as slip",
            text_of(rows=changed(0, lambda slip: 100 * slip)).encode(),
            asks="'slip' must lie in [0, 1) (got 10, row 1): percent stand in a column 'slip [%]'",
        ),
        TableForm(
            "metres as millimetres",
            text_of(rows=changed(2, lambda z: 100 * z)).encode(),
            asks="'sinkage' must be below the wheel radius 157.35 mm (got 525 mm, row 1)",
        ),
        TableForm(
            "a number that became a date",
            text_of(rows=changed(0, lambda slip: "2021-05-01")).encode(),
            asks="'slip' must be a number or empty (got '2021-05-01', row 1): a spreadsheet made a date of it",
        ),
        TableForm(
            "percent signs in cells",
            text_of(rows=changed(0, lambda slip: f"{100 * slip:g}%")).encode(),
            asks="'slip' must be a number or empty (got '10%', row 1): units stand in the header, 'slip [unit]'",
        ),
        TableForm(
            "errors in cells",
            text_of(rows=changed(2, lambda z: f"{z}±0.5")).encode(),
            asks="(got '5.25±0.5', row 1): errors stand in a column of their own, 'sinkage_sd'",
        ),
        TableForm(
            "a title before the header",
            ("Campaign of March\n\n" + text_of()).encode(),
            asks="every row must have 1 cell, as the first line has, which must be the header ('Campaign of March')",
        ),
        TableForm(
            "spaces between columns",
            text_of(("slip", "load_N"), [row[:2] for row in ROWS], sep=" ").encode(),
            asks="columns must be separated by commas, semicolons or tabs (got '0.1 80')",
        ),
        TableForm(
            "a braked wheel",
            text_of(rows=changed(0, lambda slip: -slip)).encode(),
            asks="(got -0.1, row 1): rows of a braked wheel are left out by 0 in a column 'use'",
        ),
        TableForm(
            "no unit",
            text_of(("slip", "load", *HEADER[2:])).encode(),
            asks="column 'load' needs a unit, e.g. 'load [N]'",
        ),
    ]


def table_forms() -> list[TableForm]:
    """All of them."""
    return [*_texts(), *_names(), *_workbooks(), *_recordings(), *_open()]
