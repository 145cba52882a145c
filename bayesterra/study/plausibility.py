"""Readings that no wheel makes: wrong units, signs and columns, found before they pass for a soil."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.models import Wheel
from bayesterra.parameters import CHANNELS, OUTCOMES
from bayesterra.study.observations import Observations

GRAVITY = 9.81
SPARE = 1.2
"""By how much readings may go beyond what is possible, as they have errors."""
MOST_MOMENT = 1.5
"""Moment over load and radius of the tips, beyond which no soil holds a wheel."""
FEW, SPAN = 4, 0.1
"""Rows and range of slip from which on a channel that never changes is doubted."""


def implausible(rows: Observations, wheels: Mapping[str, Wheel]) -> tuple[str, ...]:
    """Sentences on rows in the fit that a wheel can hardly have made, with row and mend; mostly none."""
    used = rows.used().numbers()
    each = ((name, wheels[name]) for name in dict.fromkeys(used.wheel))
    bare = (name for name, wheel in each if wheel.lug_height and not wheel.lug_count)
    lugs = (f"wheel {name} has lugs of a height, and a count of 0: is 'lug_count' missing?" for name in bare)
    return (*lugs, *_beyond_the_load(used, wheels), *_signs(used), *_repeated(used))


def _beyond_the_load(rows: Observations, wheels: Mapping[str, Wheel]) -> Iterator[str]:
    """Forces and moments that the load cannot hold; a load and a normal force in different units."""
    load, pull, moment = rows.carried, _read(rows, "drawbar_pull"), _read(rows, "resistance_moment")
    rim = np.array([wheels[name].radius for name in rows.wheel])
    tips = rim + np.array([wheels[name].lug_height for name in rows.wheel])
    force = _read(rows, "normal_force")
    both = ~np.isnan(force / rows.load)
    if both.any() and np.median(force[both] / rows.load[both]) > 0.9 * GRAVITY:
        yield "normal forces are 9.8 times the loads: are loads in kilograms? Write the unit, e.g. load [kg]"
    over = np.abs(pull) > SPARE * load
    kilograms = over.mean() > 0.3 and (np.abs(pull[over]) < GRAVITY * load[over]).all()
    if over.any():
        hint = "are loads in kilograms?" if kilograms else "is the unit of one of them wrong?"
        yield f"drawbar_pull is above the load in {_named(rows, over)}: {hint}"
    if (over := np.abs(moment) > MOST_MOMENT * load * tips).any() and not kilograms:
        yield f"resistance_moment is more than the load can hold in {_named(rows, over)}: is it in N m?"
    over = SPARE * moment < pull * rim * (1.0 - rows.slip)
    if over.sum() >= max(FEW, 0.5 * len(over)):  # readings of small loads may be so by their noise
        named = _named(rows, over)
        yield f"the pull gives more power than the moment puts in, in {named}: are units and slip right?"


def _signs(rows: Observations) -> Iterator[str]:
    """Channels that point the wrong way."""
    for name in ("drawbar_pull", "resistance_moment"):
        values = _read(rows, name)[rows.slip > 0.2]
        if (~np.isnan(values)).sum() >= FEW and np.nanmax(values) < 0:
            yield f"{name} is negative beyond slip 0.2: it counts as positive where the wheel drives"


def _repeated(rows: Observations) -> Iterator[str]:
    """Rows that stand there twice, and channels that never change."""
    readings = np.column_stack([rows.slip, rows.load, *(_read(rows, name) for name in OUTCOMES)])
    seen: dict[tuple[object, ...], int] = {}
    for i, values in enumerate(np.nan_to_num(readings, nan=-1.0)):
        first = seen.setdefault((rows.wheel[i], *values), i)
        if first != i and (~np.isnan(readings[i, 2:])).sum() > 1:
            yield f"row {rows.rows[i]} repeats row {rows.rows[first]} to the last digit: was it copied?"
    for name in OUTCOMES:
        values, slip = _read(rows, name), rows.slip[~np.isnan(_read(rows, name))]
        if len(slip) >= FEW and np.ptp(slip) > SPAN and np.nanmax(values) == np.nanmin(values):
            value = f"{np.nanmax(values) / CHANNELS[name].scale:g} {CHANNELS[name].unit}"
            yield f"{name} is {value} in every row: was the column filled in?"


def _read(rows: Observations, name: str) -> FloatArray:
    return rows.values.get(name, np.full(len(rows), np.nan))


def _named(rows: Observations, chosen: BoolArray) -> str:
    """Rows by number, the first few of many."""
    numbers = [str(number) for number, one in zip(rows.rows, chosen, strict=True) if one]
    more = f" and {len(numbers) - 3} more" if len(numbers) > 4 else ""
    return f"row{'s' if len(numbers) > 1 else ''} {', '.join(numbers[: 3 if more else 4])}{more}"
