"""Drives that could come next: slips, loads, wheels and what is read, from a study and a person's wishes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.data import DRIVE_OUTCOMES
from bayesterra.derived import reference_load
from bayesterra.errors import StudyError
from bayesterra.forward import known_loads
from bayesterra.messages import did_you_mean
from bayesterra.models import Wheel
from bayesterra.noise import Noise
from bayesterra.parameters import CHANNELS
from bayesterra.predicting import checked_slips
from bayesterra.study import Study
from bayesterra.units import quantity

SLIPS = 13
"""Slips of the default grid."""
MARGIN = 0.25
"""How far the default grid goes beyond the driven slips, as a share of their range."""
LOADS = 4
"""Distinct loads of a study that become candidates; of more, the lowest, the median and the highest do."""


@dataclass(frozen=True)
class Candidate:
    """One drive, or one new sensor on all drives: the rows that it would add.

    Parameters
    ----------
    wheel : name of the wheel of every row.
    wheels : its dimensions.
    slip, load : of every row (m,), slip on the shearing radius, N.
    noise : noise of every channel that is read, in the order of the package.
    repeats : whether these are the rows of the study, driven once more.
    """

    wheel: tuple[str, ...]
    wheels: tuple[Wheel, ...]
    slip: FloatArray
    load: FloatArray
    noise: tuple[Noise, ...]
    repeats: bool = False

    @property
    def channels(self) -> tuple[str, ...]:
        """What is read."""
        return tuple(noise.channel for noise in self.noise)

    @property
    def where(self) -> str:
        """The drive in a few words.

        >>> from bayesterra.models import Wheel
        >>> wheel = Wheel(radius=0.157, width=0.165)
        >>> Candidate(("Wh",), (wheel,), np.array([0.3]), np.array([80.0]), ()).where
        'wheel Wh, 80 N, slip 0.3'
        """
        if self.repeats:
            return f"the {len(self.slip)} rows of the study again"
        return f"wheel {self.wheel[0]}, {self.load[0]:.4g} N, slip {self.slip[0]:.3g}"


@dataclass(frozen=True)
class Wishes:
    """What a person asked for; everything has a default.

    Attributes
    ----------
    slips : on the shearing radius; by default the driven ones and a quarter of their range beyond.
    loads : N or texts with units; by default those of the study.
    wheels : by name; by default those of the study.
    sensors : channels to be read beside the study's, ``name`` or ``name=0.15 N m`` with its noise.
    about : parameters that the drive is to tell of; by default all that are free.
    """

    slips: Sequence[float] = ()
    loads: Sequence[float | str] = ()
    wheels: Mapping[str, Wheel] = field(default_factory=dict)
    sensors: Sequence[str] = ()
    about: Sequence[str] = ()


def candidates(study: Study, wishes: Wishes) -> list[Candidate]:
    """Every wheel under every load at every slip, read as in the study and with new sensors too.

    With new sensors there is one candidate more: they alone, on the rows of the study driven again.

    Raises
    ------
    StudyError : a slip, load or channel that cannot be, or no load is known.
    """
    wheels, loads, slips = wishes.wheels or study.wheels, _loads(study, wishes), _slips(study, wishes)
    own = tuple(study.noise.values())
    added = tuple(_sensor(study, text) for text in wishes.sensors)
    sets = [own, _ordered((*own, *added))] if added else [own]
    found = [
        Candidate((name,), (wheel,), np.array([slip]), np.array([load]), noise)
        for name, wheel in wheels.items()
        for load in loads
        for noise in sets
        for slip in slips
    ]
    return [*found, _again(study, _ordered(added))] if added else found


def parameters_of_interest(study: Study, about: Sequence[str]) -> tuple[str, ...]:
    """The parameters asked for, or all that are free.

    Raises
    ------
    StudyError : nothing is free, or one of them is unknown, fixed or tied.
    """
    free, prior = study.prior.names, study.prior
    if not free:
        raise StudyError("nothing is free: give at least one parameter a prior law")
    wanted = tuple(dict.fromkeys(about))
    for name in wanted:
        if name in prior.ties:
            raise StudyError(f"'{name}' is tied to '{prior.root(name)}': ask about that")
        if name in prior.fixed:
            raise StudyError(f"'{name}' is fixed at {prior.fixed[name]:g}: no drive tells more about it")
        if name not in free:
            raise StudyError(f"unknown parameter '{name}'{did_you_mean(name, free)}")
    return wanted or free


def _slips(study: Study, wishes: Wishes) -> FloatArray:
    if len(wishes.slips):
        return checked_slips(wishes.slips)
    driven = study.observations.used().slip
    low, high = float(driven.min()), float(driven.max())
    margin = MARGIN * (high - low) if high > low else 0.2
    return np.linspace(max(0.0, low - margin), min(0.95, high + margin), SLIPS)


def _loads(study: Study, wishes: Wishes) -> list[float]:
    if wishes.loads:
        return [_load(load) for load in wishes.loads]
    rows = study.observations.used()
    known = known_loads(rows)[~np.isnan(known_loads(rows))]
    distinct = np.unique([float(f"{load:.3g}") for load in known])
    if distinct.size > LOADS:
        distinct = np.quantile(known, (0.0, 0.5, 1.0))
    found = distinct.tolist() or [reference_load(study)]
    if np.isnan(found).any():
        raise StudyError("'load' must be given, as the study holds neither load nor normal force")
    return [float(load) for load in found]


def _load(given: float | str) -> float:
    load = quantity(given, "N", "load", bare=True)
    if load <= 0:
        raise StudyError(f"'load' must be above 0 (got {load:g} N)")
    return load


def _sensor(study: Study, text: str) -> Noise:
    """Noise of a new channel, from ``name`` or ``name=sd``."""
    name, equals, sd = (part.strip() for part in text.partition("="))
    known = DRIVE_OUTCOMES[study.drive]
    if name not in known:
        raise StudyError(f"unknown channel '{name}'{did_you_mean(name, known)}")
    if name in study.noise:
        raise StudyError(f"'{name}' is read already: every candidate has it")
    if not equals:
        raise StudyError(f"'{name}' needs its noise: --channel \"{name}={_example(name)}\"")
    return Noise(name, sd=quantity(sd, CHANNELS[name].dimension, f"noise of {name}"))


def _example(channel: str) -> str:
    return {"sinkage": "0.5 mm", "resistance_moment": "0.15 N m"}.get(channel, "1 N")


def _ordered(noise: tuple[Noise, ...]) -> tuple[Noise, ...]:
    return tuple(sorted(noise, key=lambda one: list(CHANNELS).index(one.channel)))


def _again(study: Study, noise: tuple[Noise, ...]) -> Candidate:
    """New sensors alone, on the study's rows driven again."""
    rows = study.observations.used()
    load = known_loads(rows)
    load = np.where(np.isnan(load), reference_load(study), load)
    return Candidate(rows.wheel, tuple(study.wheels[n] for n in rows.wheel), rows.slip, load, noise, True)
