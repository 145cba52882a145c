"""Files that describe a wheel alone, for predictions."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from bayesterra import schema
from bayesterra.errors import StudyError
from bayesterra.messages import errors_in
from bayesterra.models import Wheel

_DATA = {"file": "none", "slip_reference": "shearing"}


def read_wheel(path: Path) -> tuple[str, Wheel]:
    """Name and dimensions of the wheel in a TOML file.

    The file holds the keys of a wheel, and is named after it, or one table ``[wheels.<name>]`` as in a study
    file; what else a study file holds is left alone.

    Raises
    ------
    StudyError : no such file, several wheels, or a wrong key or value.
    """
    with errors_in(path):
        content = schema.read_toml(path)
        tables = content.get("wheels", {path.stem: content})
        if not isinstance(tables, dict) or len(tables) != 1:
            raise StudyError("must describe one wheel: its dimensions, or one table [wheels.<name>]")
        ((name, table),) = tables.items()
        return name, wheel_of(name, table)


def wheel_of(name: str, table: object) -> Wheel:
    """The wheel that a table ``[wheels.<name>]`` describes; StudyError for a wrong key or value."""
    checked = schema.checked({"data": _DATA, "wheels": {name: table}}, bare=False).wheels[name]
    try:
        return Wheel(**asdict(checked))
    except ValueError as error:
        raise StudyError(f"[wheels.{name}] {error}") from error
