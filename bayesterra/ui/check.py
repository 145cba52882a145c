"""Check of a study in the page: what ``bayesterra check`` says, beside pictures of readings and priors."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from markupsafe import Markup

from bayesterra.errors import BayesterraError
from bayesterra.parameters import PARAMETERS, in_order
from bayesterra.report.blocks import Blocks, Cell, Table, Text
from bayesterra.report.symbols import letters
from bayesterra.study.observations import read_table
from bayesterra.study.priors import Entry
from bayesterra.study.schema import read_toml
from bayesterra.study.study import SOIL_TEST_FILE, STUDY_FILE, Study, load_soil_test, load_study
from bayesterra.ui.folder import Folder
from bayesterra.ui.picture import law_picture, looks, study_panels

MOST_ROWS = 30
"""Rows of a table that are shown where it is not understood yet."""


def loaded(folder: Folder, path: Path, *, prior_only: bool = False) -> Study:
    """A study of the folder; StudyError where it is none, names code, or reaches out of the folder."""
    folder.check(path)
    if (path / SOIL_TEST_FILE).is_file() and not (path / STUDY_FILE).is_file():
        return load_soil_test(path)
    return load_study(path, prior_only=prior_only)


def checked(folder: Folder, path: Path) -> dict[str, Any]:
    """What is understood of a study: its overview and pictures, or the error and the table as it is typed."""
    from bayesterra.likelihood.page import study_overview

    try:
        study = loaded(folder, path)
        overview = study_overview(study)
    except BayesterraError as error:
        return {
            "study": None,
            "error": _said(str(error), path),
            "warnings": (),
            "blocks": _typed(folder, path),
            "panels": (),
            "looks": (),
        }
    warnings = tuple(block for block in overview if isinstance(block, Text) and block.text.startswith("Warning:"))
    blocks = tuple(block for block in overview if block not in warnings)
    return {
        "study": study, "error": "", "warnings": warnings, "blocks": blocks, "panels": study_panels(study),
        "looks": looks(study),
    }  # fmt: skip


def _said(message: str, path: Path) -> str:
    """A message without the path of a file that the page made itself."""
    for place in (f"{path / STUDY_FILE}: ", f"{path}/"):
        message = message.replace(place, "")
    return message


def _typed(folder: Folder, path: Path) -> Blocks:
    """The first rows of the table as they stand in the file."""
    place = path / STUDY_FILE if path.is_dir() else path
    try:
        data = read_toml(place).get("data", {})
        table = read_table(folder.inside(place.parent / data["file"]), str(data.get("sheet", "")), data.get("decimal"))
    except (BayesterraError, KeyError, TypeError, AttributeError, OSError) as error:
        return (Text(_said(str(error), path), "bad"),) if isinstance(error, BayesterraError) else ()
    rows = tuple(tuple(map(str, row)) for row in table.head(MOST_ROWS).to_numpy().tolist())
    caption: Cell = f"The table as it is typed, {table.attrs['form']}" + (
        "" if len(table) <= MOST_ROWS else ", first rows"
    )
    return (Table(caption, "l" * len(table.columns), tuple(map(str, table.columns)), rows),)


def laws(entries: Mapping[str, Entry]) -> list[dict[str, Any]]:
    """Priors in words and pictures, with where they come from."""
    from bayesterra.likelihood.page import stated_law

    shown = []
    for name in in_order(entries):
        quantity, entry = PARAMETERS[name], entries[name]
        shown.append({
            "name": name, "symbol": letters(quantity.symbol), "meaning": quantity.description,
            "unit": "" if quantity.unit == "-" else quantity.unit, "law": _stated(stated_law, name, entry),
            "picture": law_picture(name, entry), "source": getattr(entry, "source", ""),
        })  # fmt: skip
    return shown


def _stated(say: Any, name: str, entry: Entry) -> Markup:
    words: Markup = say(name, entry)
    return words
