"""The rover: weight, dimensions and wheels, and the file that gives them.

A number in the file may say that it is an assumption, ``{ value = "0.28 m", assumption = "read from a
drawing" }``; it then does so wherever it is used.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, TypeAdapter
from pydantic.dataclasses import dataclass as table

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, checked_text, did_you_mean, errors_in
from bayesterra.likelihood.forward import model_columns, soil_at
from bayesterra.models import ForwardModel, Wheel, statics
from bayesterra.study.schema import Acceleration, Force, Length, Mass, Number, Table, Text, checked_by, read_toml
from bayesterra.study.units import text
from bayesterra.study.wheels import resolved, wheel_of

AXLES = ("front", "rear")
EARTH = 9.80665
"""Gravity, m/s², where the file names none."""
_CONFIG = ConfigDict(extra="forbid")


@dataclass(frozen=True)
class Assumption:
    """A value of the file that nobody measured: its key, the value as given, and why it was taken."""

    key: str
    value: str
    note: str

    def __str__(self) -> str:
        *tables, last = self.key.replace("_", " ").split(".")
        of = "".join(f" of the {table}" for table in reversed(tables))
        return f"{last}{of} {self.value} is an assumption: {self.note}"


@dataclass(frozen=True, kw_only=True)
class Rover(statics.Rover):
    """A rover with the names of its wheels, and what of its numbers nobody measured.

    Attributes
    ----------
    name : what it is called.
    wheel_names : of the front and the rear wheels.
    assumptions : which numbers are assumptions; that all wheels slip alike is one where no speeds are given.

    Raises
    ------
    StudyError : a value that no rover has.
    """

    name: str
    wheel_names: tuple[str, str] = AXLES
    assumptions: tuple[Assumption, ...] = ()

    def __post_init__(self) -> None:
        try:
            super().__post_init__()
        except ValueError as error:
            raise StudyError(str(error)) from error

    def on(self, soil: FloatArray, model: ForwardModel) -> statics.SoftGround:
        """Soils, soil arrays (n, p), under its wheels through a model."""
        front, rear = (model_columns(soil_at(soil, wheel.width), model) for wheel in self.wheels)
        return statics.SoftGround(model, self.wheels, (front, rear))


@table(frozen=True, kw_only=True, config=_CONFIG)
class _Centre(Table):
    """Place of the centre of gravity."""

    height: Length
    ahead_of_rear_axle: Length


@table(frozen=True, kw_only=True, config=_CONFIG)
class _File(Table):
    """The keys of a rover's file, but for the wheels."""

    wheelbase: Length
    centre_of_gravity: _Centre
    name: Text = ""
    mass: Mass | None = None
    weight: Force | None = None
    gravity: Acceleration | None = None
    tow_height: Length | None = None
    front_to_rear_speed: Number = 1.0
    wheel: Any = None
    front_wheel: Any = None
    rear_wheel: Any = None


_ADAPTER = TypeAdapter(_File)


def read_rover(path: Path, wheels: Mapping[str, Wheel], phi: float) -> Rover:
    """The rover that a TOML file describes.

    Parameters
    ----------
    wheels : those of a study, which the file may name.
    phi : friction angle, rad, at which (2) gives the shearing radius of a wheel that leaves it open.

    Raises
    ------
    StudyError : no such file, or a wrong key or value.
    """
    with errors_in(path):
        assumptions: list[Assumption] = []
        content = _plain(read_toml(path, "rover"), "", assumptions)
        checked = checked_by(_ADAPTER, content, bare=False)
        named = [_wheel(content, axle, wheels, phi) for axle in AXLES]
        weight, gravity = _weight(checked)
        return Rover(
            name=checked.name or path.stem, weight=weight, gravity=gravity, wheelbase=checked.wheelbase,
            centre_height=checked.centre_of_gravity.height,
            centre_ahead=checked.centre_of_gravity.ahead_of_rear_axle,
            tow_height=checked.centre_of_gravity.height if checked.tow_height is None else checked.tow_height,
            wheels=(named[0][1], named[1][1]), wheel_names=(named[0][0], named[1][0]),
            front_to_rear_speed=checked.front_to_rear_speed,
            assumptions=(*assumptions, *_left_out(checked)),
        )  # fmt: skip


def _plain(content: Mapping[str, Any], prefix: str, assumptions: list[Assumption]) -> dict[str, Any]:
    """The content with bare values in the place of assumptions, which are gathered."""
    plain: dict[str, Any] = {}
    for key, item in content.items():
        name = f"{prefix}{key}"
        noted = isinstance(item, Mapping) and not {"value", "assumption"}.isdisjoint(item)
        value = _value(name, item, assumptions) if noted else item
        plain[key] = _plain(value, f"{name}.", assumptions) if isinstance(value, Mapping) else value
    return plain


def _value(key: str, entry: Mapping[str, Any], assumptions: list[Assumption]) -> Any:
    note = entry.get("assumption")
    if set(entry) != {"value", "assumption"} or not isinstance(note, str) or not note.strip():
        form = '{ value = "0.28 m", assumption = "read from a drawing" }'
        raise StudyError(f"'{key}' must be a value or {form} (got the keys {', '.join(sorted(entry))})")
    value = entry["value"]
    shown = "as given in the file" if isinstance(value, Mapping) else str(value)
    assumptions.append(Assumption(key, shown, checked_text(note.strip(), f"{key}.assumption")))
    return value


def _weight(file: _File) -> tuple[float, float | None]:
    """Weight, and the gravity behind it where that is known."""
    if (file.mass is None) == (file.weight is None):
        present = "both" if file.mass is not None else "neither"
        raise StudyError(f"needs either 'mass' or 'weight' (got {present})")
    if file.weight is not None:
        return file.weight, file.gravity
    gravity = EARTH if file.gravity is None else file.gravity
    return (file.mass or 0.0) * gravity, gravity


def _left_out(file: _File) -> Iterator[Assumption]:
    """Assumptions that stand in for keys that were left out."""
    if file.mass is not None and file.gravity is None:
        yield Assumption("gravity", f"{EARTH} m/s²", "none is given, so the Earth's is taken")
    if file.tow_height is None:
        height = str(text(file.centre_of_gravity.height, "m"))
        yield Assumption("tow_height", height, "none is given, so the height of the centre of gravity is taken")
    if file.front_to_rear_speed == 1:
        yield Assumption("front_to_rear_speed", "1", "all wheels turn at one speed and slip alike")


def _wheel(content: Mapping[str, Any], axle: str, wheels: Mapping[str, Wheel], phi: float) -> tuple[str, Wheel]:
    """Name and dimensions of the wheels of an axle, its own or those of both."""
    keys = [key for key in (f"{axle}_wheel", "wheel") if key in content]
    if not keys:
        first = next(iter(wheels), None)
        hint = f' (e.g. wheel = "{first}", the study\'s)' if first else ""
        raise StudyError(f"needs 'wheel', or 'front_wheel' and 'rear_wheel'{hint}")
    key, entry = keys[0], content[keys[0]]
    if isinstance(entry, str):
        if entry not in wheels:
            raise StudyError(f"'{key}': unknown wheel '{entry}'{did_you_mean(entry, wheels)}")
        return entry, wheels[entry]
    if not isinstance(entry, Mapping):
        raise StudyError(f"'{key}' must be the name of a study's wheel or a table (got {entry!r})")
    try:
        return key.replace("_", " "), resolved(wheel_of(key, entry), phi)
    except StudyError as error:
        raise StudyError(str(error).replace("[wheels.", "[")) from error
