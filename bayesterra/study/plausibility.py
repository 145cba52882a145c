"""Readings that no wheel makes, and noise that repeats contradict, found before they pass for a soil."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.models import Wheel
from bayesterra.parameters import CHANNELS, OUTCOMES
from bayesterra.study.noise import Noise
from bayesterra.study.observations import Observations

GRAVITY = 9.81
SPARE = 1.2
"""By how much readings may go beyond what is possible, as they have errors."""
MOST_MOMENT = 1.5
"""Moment over load and radius of the tips, beyond which no soil holds a wheel."""
FEW, SPAN = 4, 0.1
"""Rows and range of slip from which on a channel that never changes is doubted."""


SAME_SLIP, SAME_LOAD = 0.005, 0.01
"""Slips, and shares of a load, nearer than which readings repeat one another."""
SURE = 0.001
"""Probability of a scatter as small, or as great, below which repeats contradict the stated noise."""


@dataclass(frozen=True)
class Repeats:
    """Scatter of readings of one channel that were taken again under the same conditions."""

    sd: float  # pooled standard deviation about the means, SI
    stated: float  # standard deviation that the study states there, SI; NaN where it is estimated
    freedom: int  # degrees of freedom, readings less conditions

    @property
    def contradict(self) -> bool:
        """True where the stated noise makes such a scatter less often than ``SURE`` on either side."""
        below = chi2.cdf(self.freedom * (self.sd / self.stated) ** 2, self.freedom)
        return bool(below < SURE or below > 1.0 - SURE)


def repeats(rows: Observations, noise: Mapping[str, Noise]) -> dict[str, Repeats]:
    """Repeats by channel, of rows in the fit with the same wheel, load and slip; none where there are none."""
    used, found = rows.used().numbers(), dict[str, Repeats]()
    driven = list(zip(used.wheel, map(_level, used.load.tolist()), used.slip.tolist(), strict=True))
    group, first, number = np.zeros(len(used), dtype=np.int64), -1, -1
    for i in sorted(range(len(used)), key=driven.__getitem__):
        near = first >= 0 and driven[i][:2] == driven[first][:2] and driven[i][2] - driven[first][2] < SAME_SLIP
        if not near:  # of the first one: row by row, a log would all be one condition
            first, number = i, number + 1
        group[i] = number
    for name, law in noise.items():
        values, apart, freedom, stated = _read(used, name), 0.0, 0, list[float]()
        for level in np.unique(group):
            mine = (group == level) & ~np.isnan(values)
            if mine.sum() > 1:
                middle = values[mine].mean()
                apart, freedom = apart + ((values[mine] - middle) ** 2).sum(), freedom + int(mine.sum()) - 1
                if law.law is None:
                    stated += [
                        float(law.scale(np.array([[middle]]), None, sd[None])[0, 0]) for sd in used.given_sd[name][mine]
                    ]
        if freedom and apart > 0:
            size = float(np.sqrt(np.mean(np.square(stated)))) if stated else np.nan
            found[name] = Repeats(float(np.sqrt(apart / freedom)), size, freedom)
    return found


def _level(load: float) -> float:
    """Loads within a share of each other as one number; 0 where none is stated."""
    return 0.0 if np.isnan(load) or load <= 0 else float(round(np.log(load) / SAME_LOAD))


def _contradicted(rows: Observations, noise: Mapping[str, Noise]) -> Iterator[str]:
    """Stated noise that repeats contradict; heavy tails bear with them."""
    for name, each in repeats(rows, noise).items():
        if np.isinf(noise[name].tails.code) and each.contradict:
            scale, unit = CHANNELS[name].scale, CHANNELS[name].unit
            yield (
                f"{name} repeats to {each.sd / scale:.2g} {unit} ({each.freedom} degrees of freedom), and its noise is "
                f"stated as {each.stated / scale:.2g} {unit}: is it a guess? Estimate it, see 'estimate' in [noise]"
            )


def implausible(rows: Observations, wheels: Mapping[str, Wheel], noise: Mapping[str, Noise]) -> tuple[str, ...]:
    """Sentences on rows in the fit that a wheel can hardly have made, with row and mend; mostly none."""
    used = rows.used().numbers()
    each = ((name, wheels[name]) for name in dict.fromkeys(used.wheel))
    bare = (name for name, wheel in each if wheel.lug_height and not wheel.lug_count)
    lugs = (f"wheel {name} has lugs of a height, and a count of 0: is 'lug_count' missing?" for name in bare)
    return (*lugs, *_beyond_the_load(used, wheels), *_signs(used), *_repeated(used), *_contradicted(rows, noise))


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
    kilograms = over.sum() > 0.3 * len(over) and (np.abs(pull[over]) < GRAVITY * load[over]).all()
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


def silent(rows: Observations, channels: Iterable[str]) -> Iterator[str]:
    """A note on rows in use without a reading of these channels."""
    used = rows.used()
    none = np.all([np.isnan(_read(used, name)) for name in channels], axis=0) & np.ones(len(used), np.bool_)
    if none.any():
        yield f"no reading in {_named(used, none)}: it only excludes soils without an answer there"


def _read(rows: Observations, name: str) -> FloatArray:
    return rows.values.get(name, np.full(len(rows), np.nan))


def _named(rows: Observations, chosen: BoolArray) -> str:
    """Rows by number, the first few of many."""
    numbers = [str(number) for number, one in zip(rows.rows, chosen, strict=True) if one]
    more = f" and {len(numbers) - 3} more" if len(numbers) > 4 else ""
    return f"row{'s' if len(numbers) > 1 else ''} {', '.join(numbers[: 3 if more else 4])}{more}"
