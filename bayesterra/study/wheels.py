"""Wheels: files that describe one, wheels of a study by name, and the slips and loads that were driven."""

from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, did_you_mean, errors_after, errors_in
from bayesterra.models import Wheel
from bayesterra.stats.laws import Law
from bayesterra.study import schema
from bayesterra.study.assembly import with_coefficient
from bayesterra.study.study import Study

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
    with errors_after(f"[wheels.{name}] "):
        return Wheel(**asdict(checked))


GRID = 61


def driven_range(study: Study) -> FloatArray:
    """Slips for smooth bands, from the lowest to the highest that was driven."""
    slips = study.observations.used().slip
    return np.linspace(slips.min(), slips.max(), GRID)


def checked_slips(slip: ArrayLike) -> FloatArray:
    """Slips in ascending order, each once; StudyError where one lies outside [0, 1)."""
    if np.asarray(slip).dtype.kind not in "iuf":
        raise StudyError(f"'slip' must be a number or numbers (got {slip!r:.60})")
    slips = np.unique(np.atleast_1d(np.asarray(slip, dtype=np.float64)))
    wrong = slips[~((slips >= 0) & (slips < 1))]
    if wrong.size or not slips.size:
        raise StudyError(f"'slip' must lie in [0, 1) (got {f'{wrong[0]:g}' if wrong.size else 'none'})")
    return slips


def chosen_wheel(study: Study, wheel: str | Path | Wheel | None = None, name: str = "") -> tuple[str, Wheel]:
    """Name and dimensions of a wheel of the study by its name, by default its first, or of another one.

    Another one is given, with or without a ``name``, or read from a file. A shearing-radius coefficient that
    it leaves out comes from (2) at the median of the prior of φ, as in the study.

    Raises
    ------
    StudyError : neither a wheel of the study nor a file, or another one with the name of one of the study.
    """
    if isinstance(wheel, Wheel):
        other = resolved(wheel, prior_phi(study))
        if study.wheels.get(name, other) != other:
            raise StudyError(
                f"'{name}' is a wheel of the study with other dimensions: give the other wheel another name"
            )
        return name or "other wheel", other
    wheels, text = study.wheels, next(iter(study.wheels)) if wheel is None else str(wheel)
    if text in wheels:
        return text, wheels[text]
    if not text.endswith(".toml") and not Path(text).is_file():
        raise StudyError(f"'{text}' is neither a wheel of the study nor a file{did_you_mean(text, wheels)}")
    name, other = read_wheel(Path(text))
    return chosen_wheel(study, other, name)


def chosen_wheels(study: Study, wheels: Iterable[str | Wheel | None]) -> dict[str, Wheel]:
    """Wheels by name, each as in :func:`chosen_wheel`; StudyError for two wheels of one name."""
    chosen: dict[str, Wheel] = {}
    for each in wheels:
        name, wheel = chosen_wheel(study, each)
        if chosen.setdefault(name, wheel) != wheel:
            mend = "ask for one after the other" if isinstance(each, Wheel) else "rename one, its file or its table"
            raise StudyError(f"two wheels are called '{name}': {mend}")
    return chosen


def prior_phi(study: Study) -> float:
    """The friction angle, rad, at which (2) gives a wheel's shearing radius: the median of its prior."""
    phi = study.prior.entries[study.prior.root("phi")]
    return phi.median if isinstance(phi, Law) else study.prior.fixed["phi"]


def resolved(wheel: Wheel, phi: float) -> Wheel:
    """A wheel that is none of the study's, as :func:`bayesterra.study.assembly.with_coefficient`."""
    with errors_after("the other wheel's "):
        return with_coefficient(wheel, phi)


def measured_loads(study: Study) -> tuple[float, ...]:
    """Lowest and highest load (N) among the rows in the fit; nothing where none was measured."""
    rows = study.observations.used()
    loads = rows.load if not np.isnan(rows.load).all() else rows.values.get("normal_force", rows.load)
    measured = loads[~np.isnan(loads)]
    return (float(measured.min()), float(measured.max())) if measured.size else ()
