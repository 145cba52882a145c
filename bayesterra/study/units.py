"""Quantities with units: text at the edge, SI numbers inside. The only module that knows pint."""

import re
import tomllib
from collections.abc import Collection
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from bayesterra.errors import StudyError
from bayesterra.runtime.reading import MEGABYTE, read_text

ANGLES = ("radian", "degree", "milliradian", "grade", "turn", "arcminute", "arcsecond")
"""Units of an angle. Pint counts angles as pure numbers; here they are kept apart."""

_EXAMPLES = {
    "": "0.5", "rad": "32 deg", "m": "12 mm", "Pa": "250 kPa", "N": "80 N", "N m": "0.3 N m",
    "Pa m": "15.6 kPa m", "kg": "25 kg", "m/s^2": "9.81 m/s^2", "rad/s": "1 rad/s, 10 rpm or 1 turn/s",
}  # fmt: skip
_NAMES = {
    "": "pure number", "rad": "angle", "m": "length", "Pa": "pressure", "N": "force", "N m": "torque",
    "Pa m": "pressure times length", "kg": "mass", "m/s^2": "acceleration",
    "rad/s": "angular speed",
}  # fmt: skip
_FIELD_UNITS = {"rad": "deg", "m": "mm", "Pa": "kPa", "Pa m": "kPa m"}
_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\d\s.,+-].*?)?\s*")
_POWERS = re.compile(r"\d\s*\d|(\^|\*\*)[^*/]*(\^|\*\*)")
"""Powers beyond one digit, or of powers: pint would work them out, however long it takes."""
LONGEST = 200
"""Characters, at most, of a quantity or the header of a column: patterns are slow on long texts."""
_HEADER = re.compile(r"\s*([^\[\]]*?)\s*(?:\[([^\[\]]*)\])?\s*")
_ROUND_HEADER = re.compile(r"\s*([^()]*?)\s*\(([^()]*)\)\s*")
_ENDINGS = {"Nm": "N m", "m_s": "m/s", "cm_s": "cm/s", "mm_s": "mm/s", "rad_s": "rad/s", "percent": "%", "pct": "%"}
_UNIT_ENDING = re.compile(rf"(.+?)_(mm|cm|m|N|kN|Pa|kPa|s|ms|rpm|kg|kgf|{'|'.join(_ENDINGS)})")
"""Units at the end of names that cannot have brackets."""
STANDARD_GRAVITY = 9.80665
"""m/s², exactly: CGPM 1901."""
SYNONYMS: dict[str, list[str]] = tomllib.loads(read_text(Path(__file__).with_name("synonyms.toml"), MEGABYTE))
"""Other names of columns, in small letters with underscores."""
REMARKS = ("remark", "remarks", "comment", "comments", "note", "notes", "date", "operator", "#")
"""First words of headers of columns that are left alone."""


@cache
def _registry() -> Any:
    import pint

    return pint.UnitRegistry()


@lru_cache(1024)
def factor(unit: str, dimension: str) -> float:
    """SI value of one ``unit``.

    Parameters
    ----------
    unit : e.g. ``"kPa"``.
    dimension : an SI unit of the dimension that is expected; "" for pure numbers, "rad" for angles.

    Raises
    ------
    StudyError : the unit is not known or has another dimension.
    """
    parsed, expected = _parsed(unit), _registry().Unit(dimension)
    turns = any(word in str(parsed) for word in (*ANGLES, "revolution"))
    angle, asked = (turns, str(parsed) in ANGLES), (dimension in ("rad", "rad/s"), dimension == "rad")
    if parsed.dimensionality != expected.dimensionality or angle != asked:
        example = _EXAMPLES.get(dimension, f"1 {dimension}")
        wanted = f'{_NAMES.get(dimension, dimension)} (e.g. "{example}")'
        raise StudyError(f"the unit '{unit}' is not a unit of {wanted}")
    return float(_registry().Quantity(1.0, parsed).to(expected).magnitude)


def si_of(unit: str, name: str) -> tuple[float, str]:
    """SI value of a unit, and the SI unit of its dimension; 1 and "" for a pure number.

    StudyError where the unit is not known.
    """
    if not unit:
        return 1.0, ""
    try:
        parsed = _parsed(unit)
    except StudyError as error:
        raise StudyError(f"the unit of '{name}': {error}") from error
    if str(parsed) in ANGLES:
        return factor(unit, "rad"), "rad"
    base = _registry().Quantity(1.0, parsed).to_base_units()
    return float(base.magnitude), f"{base.units:~C}"


def _parsed(unit: str) -> Any:
    if len(unit) > LONGEST or _POWERS.search(unit):
        raise StudyError(f"unknown unit '{unit:.{LONGEST}}'")
    try:
        return _registry().parse_units(unit)
    # Pint's parser lets errors of many kinds through, depending on where the text stops making sense.
    except Exception as error:
        raise StudyError(f"unknown unit '{unit}'") from error


def quantity(value: object, dimension: str, name: str, *, bare: bool = False) -> float:
    """SI value of a quantity.

    Parameters
    ----------
    value : text such as ``"32 deg"``, or a number where ``dimension`` is "" (or ``bare`` is set).
    dimension : an SI unit of the expected dimension, "" for pure numbers, "rad" for angles.
    name : what the value is called in error messages.
    bare : take numbers as SI values.

    Raises
    ------
    StudyError : no number, no unit or the wrong one, or not finite.
    """
    if isinstance(value, str):
        return _from_text(value, dimension, name)
    if isinstance(value, bool) or not isinstance(value, int | float | np.integer | np.floating):
        raise StudyError(f"'{name}' must be {_form(dimension)} (got {value!r})")
    if dimension and not bare:
        raise StudyError(f"'{name}' needs a unit: {_form(dimension)} (got {value!r})")
    try:
        number = float(value)
    except OverflowError:  # a whole number of more than 308 digits
        number = np.inf
    if not np.isfinite(number):
        raise StudyError(f"'{name}' must be finite (got {value!r:.40})")
    return number


def _form(dimension: str) -> str:
    return f'text with a unit, e.g. "{_EXAMPLES.get(dimension)}"' if dimension else "a number"


def _from_text(text: str, dimension: str, name: str) -> float:
    match = _NUMBER.fullmatch(text) if len(text) <= LONGEST else None
    if match is None:
        raise StudyError(f"'{name}' must be {_form(dimension)} (got {text!r})")
    number, unit = match.groups()
    if dimension and not unit:
        raise StudyError(f"'{name}' needs a unit: {_form(dimension)} (got {text!r})")
    try:
        value = float(number) * (factor(unit, dimension) if unit else 1.0)
    except StudyError as error:
        raise StudyError(f"'{name}': {error} (got {text!r})") from error
    return quantity(value, dimension, name, bare=True)


def column_header(header: str) -> tuple[str, str | None]:
    """Split a column header: ``"sinkage [mm]"`` or ``"sinkage (mm)"`` into ``("sinkage", "mm")``; None: no unit."""
    short = str(header) if len(str(header)) <= LONGEST else ""
    match = _ROUND_HEADER.fullmatch(short) or _HEADER.fullmatch(short) if short else None
    if match is None:
        return str(header).strip(), None
    name, unit = match.groups()
    return name, None if unit is None else unit.strip()


def column_name(name: str, known: Collection[str]) -> str:
    """The known name of a column that is called so, itself or by a synonym; else the name as it is.

    >>> column_name("F_DP_sd", ["slip", "drawbar_pull", "drawbar_pull_sd"])
    'drawbar_pull_sd'
    """
    plain = re.sub(r"[\s\-.]+", "_", name.strip().casefold()).strip("_")
    stem, suffix = (plain[:-3], "_sd") if plain.endswith("_sd") else (plain, "")
    if name in known:
        return name
    if plain in known:
        return plain
    return next((each + suffix for each in SYNONYMS if each + suffix in known and stem in SYNONYMS[each]), name)


def known_column(header: str, known: Collection[str]) -> tuple[str, str | None]:
    """Known name, else the name as it is, and unit of a column; ``z_mm`` is ``sinkage [mm]``.

    >>> known_column("travel speed_mm_s", ["travel_speed"])
    ('travel_speed', 'mm/s')
    """
    stem, unit = column_header(header)
    name = column_name(stem, known)
    ending = _UNIT_ENDING.fullmatch(stem) if name not in known and unit is None else None
    if ending and column_name(ending[1], known) in known:
        return column_name(ending[1], known), _ENDINGS.get(ending[2], ending[2])
    return name, unit


def text(value: float, dimension: str) -> str | float:
    """Write an SI value, in a field unit where that is exact, such that :func:`quantity` reads it back.

    Parameters
    ----------
    value : SI value.
    dimension : as in :func:`quantity`; pure numbers stay numbers.
    """
    if not dimension:
        return float(value)
    unit = _FIELD_UNITS.get(dimension, dimension)
    scale = factor(unit, dimension)
    near = value / scale
    candidates = (f"{near:.{digits}g}" for digits in (15, 16, 17))
    exact = next((number for number in candidates if float(number) * scale == value), None)
    return f"{float(value)!r} {dimension}" if exact is None else f"{exact} {unit}"
