"""Outlook of a rover: the draws of a result on slopes and against tow forces, as a folder."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, fields, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Literal

import numpy as np
import pandas as pd
from numpy.random import default_rng
from numpy.typing import ArrayLike

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.errors import StudyError, check_kind, checked_path
from bayesterra.likelihood.posterior import posterior
from bayesterra.models import statics
from bayesterra.models.statics import CurvedGround, Greatest, Ground, Outcome, State, Sweep, greatest
from bayesterra.parameters import CHANNELS
from bayesterra.prediction import prediction
from bayesterra.prediction.prediction import UNANSWERED, Condition, quantile_columns, quantiles, say
from bayesterra.prediction.rover import AXLES, EARTH, Rover, read_rover
from bayesterra.runtime.tables import Count, Number, Record
from bayesterra.study.result import AnalysisResult, Result
from bayesterra.study.study import Study, without_wheels
from bayesterra.study.units import quantity
from bayesterra.study.wheels import measured_loads, prior_phi, resolved

QUANTITIES = {
    "slip": ("slip", 1.0, "-"),
    "load": ("load", 1.0, "N"),
    "sinkage": ("sinkage", CHANNELS["sinkage"].scale, "mm"),
    "pull": ("drawbar_pull", 1.0, "N"),
    "moment": ("resistance_moment", 1.0, "N m"),
}
"""Fields of a state: name in tables, SI value of a field unit, field unit."""
GREATEST = {"slope": "rad", "tow": "N"}
"""Greatest values that may be asked for, and their dimensions."""
MODEL_ERROR = say.plain("model_error")
FAILURES = (Outcome.CANNOT, Outcome.SINKS, Outcome.LIFTS)
DEGREE = float(np.pi / 180)


@dataclass(frozen=True)
class RoverOutlook(AnalysisResult):
    """A rover on the soils of n posterior draws."""

    MARK = "rover.json"
    RECORD = Record.having(
        kind=Literal["rover"], title=str, model=str, bayesterra=str, rover=dict, slope=list[Number],
        tow=list[Number], draws=Count, share_that_cannot=list[Number], share_without_answer=list[Number],
        marked_above=Number, notes=list[str],
    )  # fmt: skip
    VIEW = "bayesterra.prediction.page:rover"
    PAGE = ""
    FIGURES: ClassVar[Mapping[str, str]] = {"rover.png": "rover_outlook"}
    CALLED = "Written"
    DIGITS = None

    title: str  # of the study that the draws come from
    model: str  # name of its wheel-soil model
    rover: Rover  # weight, dimensions, wheels, and which of these are assumptions
    asked: State  # states (n, k) at every slope and tow force that were asked for
    over_slope: State  # states at slopes for a smooth curve, against the first tow force
    over_tow: State | None  # the same at tow forces on the first slope; None where no tow force was asked for
    slopes: Greatest  # without a tow force
    slopes_driven: Greatest  # the same at slips no higher than the highest that was driven
    tows: Greatest  # tow forces on the flat
    tows_driven: Greatest  # the same at slips no higher than that
    index: IntArray  # (n, 2) chain and draw of every parameter set, as in ``draws.nc``
    driven: tuple[float, float]  # lowest and highest slip of the study's rows in the fit
    remarks: tuple[str, ...]  # where rover and loads leave what was measured; one sentence each
    basis: str = ""  # of a joint posterior, where the parameters come from; a sentence
    conditions: tuple[Condition, ...] = ()  # whose probability is asked for

    @property
    def probabilities(self) -> pd.DataFrame:
        """One row per condition, slope and tow force: share of all draws that meet it on both axles.

        Draws that do not hold meet none. Of the greatest slope and tow force there is one row each.
        """
        rows, states = list[dict[str, Any]](), self.asked
        for condition in self.conditions:
            of = {"slope [deg]": np.nan, "tow [N]": np.nan, "condition": condition.text}
            if condition.name in GREATEST:
                peak = self.slopes if condition.name == "slope" else self.tows
                rows.append({**of, "probability": condition.share(np.asarray(peak.value))})
                continue
            field = next(field for field, (name, _, _) in QUANTITIES.items() if name == condition.name)
            values = getattr(states, field)
            worst = values.min(axis=2) if condition.above else values.max(axis=2)
            for i, (slope, tow) in enumerate(zip(states.slope[0], states.tow[0], strict=True)):
                at = {"slope [deg]": float(_degrees(slope)), "tow [N]": float(tow)}
                rows.append({**of, **at, "probability": condition.share(worst[:, i])})
        return pd.DataFrame(rows).assign(model_error=MODEL_ERROR not in self.remarks)

    @property
    def greatest_slope(self) -> FloatArray:
        """Greatest slope (n,) that each draw climbs without a tow force, rad; NaN where it has no answer."""
        return self.slopes.value

    @property
    def greatest_tow(self) -> FloatArray:
        """Greatest tow force (n,) that each draw holds on the flat, N; NaN where it has no answer."""
        return self.tows.value

    def probability_to_climb(self, slope: float, *, driven: bool = False) -> float:
        """Share of all draws that climb ``slope`` (rad) at some slip; ``driven``: at driven slips only."""
        slopes = self.slopes_driven if driven else self.slopes
        return float((np.nan_to_num(slopes.value, nan=-np.inf) >= slope).mean())

    @property
    def cannot(self) -> FloatArray:
        """Share (k,) of the draws that do not hold each slope and tow force that were asked for."""
        return cannot(self.asked)

    @property
    def unanswered(self) -> FloatArray:
        """Share (k,) of the draws for which the model has no answer there."""
        return unanswered(self.asked)

    @property
    def notes(self) -> tuple[str, ...]:
        """Assumptions, where the prediction leaves what was measured, and what is not in it."""
        assumed = (str(note) for note in self.rover.assumptions)
        source = (self.basis,) if self.basis else ()
        return (*source, *assumed, *self._slips(), *self.remarks)

    def _slips(self) -> Iterator[str]:
        low, high = self.driven
        middle = quantiles(self.asked.slip.max(axis=2))[2]
        beyond = [i for i, slip in enumerate(middle) if slip > high]
        if beyond:
            named = ", ".join(_place(self.asked, i) for i in (beyond if len(beyond) < 4 else beyond[:3]))
            more = "" if len(beyond) < 4 else " and more"
            yield say.plain("slips", named + more, low, high)
        above = float((self.slopes.slip > high).mean())
        if above > UNANSWERED:
            yield say.plain("greatest", above, low, high)

    @property
    def table(self) -> pd.DataFrame:
        """One row per slope, tow force, axle and quantity: quantiles of the draws that hold, and shares.

        ``rolls`` counts the draws that hold without slip; they enter the quantiles with slip 0.
        """
        states = self.asked
        return pd.DataFrame(
            [
                _row(states, i, axle, name, self.driven)
                for i in range(states.slip.shape[1])
                for axle in range(len(AXLES))
                for name in QUANTITIES
            ]
        )

    @property
    def greatest_table(self) -> pd.DataFrame:
        """Quantiles of the greatest slope and tow force, at all slips and at the driven ones."""
        peaks = [
            ("greatest_slope", "deg", DEGREE, {"all": self.slopes, "driven": self.slopes_driven}),
            ("greatest_tow", "N", 1.0, {"all": self.tows, "driven": self.tows_driven}),
        ]
        rows = [
            {
                "quantity": name,
                "unit": unit,
                "slips": slips,
                **quantile_columns(peak.value, scale),
                "at_slip_q50": quantiles(peak.slip)[2],
                "draws": len(peak.value),
                "no_answer": int(np.isnan(peak.value).sum()),
                "still_rising": int(peak.rising.sum()),
            }
            for name, unit, scale, by_slips in peaks
            for slips, peak in by_slips.items()
        ]
        return pd.DataFrame(rows)

    @property
    def climb_table(self) -> pd.DataFrame:
        """Probability to climb slopes in steps of half a degree, at all slips and at the driven ones."""
        steepest = np.nanmax(self.slopes.value, initial=0.0) / DEGREE
        slopes = np.arange(0, np.ceil(steepest) + 0.75, 0.5)
        chances = {
            name: [self.probability_to_climb(slope * DEGREE, driven=driven) for slope in slopes]
            for name, driven in (("probability", False), ("probability_driven_slips", True))
        }
        return pd.DataFrame({"slope [deg]": slopes, **chances})

    def to_dataframe(self) -> pd.DataFrame:
        """Every draw at every slope and tow force asked for: its state, and how the question ended."""
        states = self.asked
        k = states.outcome.shape[1]
        columns: dict[str, object] = {
            "chain": np.repeat(self.index[:, 0], k),
            "draw": np.repeat(self.index[:, 1], k),
            "slope [deg]": _degrees(states.slope.ravel()),
            "tow [N]": states.tow.ravel(),
            "outcome": [statics.OUTCOMES[Outcome(int(code))] for code in states.outcome.ravel()],
        }
        for field, (name, scale, unit) in QUANTITIES.items():
            for axle, called in enumerate(AXLES):
                header = f"{called}_{name}" + ("" if unit == "-" else f" [{unit}]")
                columns[header] = getattr(states, field)[:, :, axle].ravel() / scale
        return pd.DataFrame(columns)

    def tables(self) -> dict[str, pd.DataFrame]:
        """Bands, draws, the greatest slopes and tow forces, and the probability to climb."""
        return {
            "bands": self.table,
            "draws": self.to_dataframe(),
            "greatest": self.greatest_table,
            "climb": self.climb_table,
            **({"probabilities": self.probabilities} if self.conditions else {}),
        }

    def to_record(self) -> dict[str, Any]:
        """Content of the JSON file."""
        return {
            "kind": "rover", "title": self.title, "model": self.model, "bayesterra": version("bayesterra"),
            "rover": asdict(self.rover), "slope": self.asked.slope[0].tolist(), "tow": self.asked.tow[0].tolist(),
            "draws": len(self.index), "share_that_cannot": self.cannot.tolist(),
            "share_without_answer": self.unanswered.tolist(), "marked_above": UNANSWERED, "notes": list(self.notes),
        }  # fmt: skip


def cannot(states: State) -> FloatArray:
    """Share (k,) of the draws that hold at no slip: too little pull, too deep, or an axle lifts off."""
    return np.asarray(np.isin(states.outcome, FAILURES).mean(axis=0))


def unanswered(states: State) -> FloatArray:
    """Share (k,) of the draws for which the model has no answer at the slips that matter.

    Draws that hold at every slip with an answer, but whose answers begin above slip 0, are among them.
    """
    return np.asarray(np.isin(states.outcome, (Outcome.NO_ANSWER, Outcome.UNSETTLED)).mean(axis=0))


def _degrees(slope: ArrayLike) -> FloatArray:
    """Slopes as they were written, without the rounding of their conversion."""
    return np.round(np.asarray(slope) / DEGREE, 9)


def _place(states: State, i: int) -> str:
    slope, tow = states.slope[0, i] / DEGREE, states.tow[0, i]
    return f"{slope:.3g}°" + (f" and {tow:.3g} N" if tow else "")


def _row(states: State, i: int, axle: int, field: str, driven: tuple[float, float]) -> dict[str, object]:
    name, scale, unit = QUANTITIES[field]
    codes = states.outcome[:, i]
    slip = quantiles(states.slip[:, i, axle])[2]
    return {
        "slope [deg]": _degrees(states.slope[0, i]), "tow [N]": states.tow[0, i], "axle": AXLES[axle],
        "quantity": name, "unit": unit, **quantile_columns(getattr(states, field)[:, i, axle] / scale, 1.0),
        "draws": len(codes), "cannot": float(cannot(states)[i]), "unanswered": float(unanswered(states)[i]),
        "pulls_too_little": int((codes == Outcome.CANNOT).sum()), "sinks": int((codes == Outcome.SINKS).sum()),
        "lifts": int((codes == Outcome.LIFTS).sum()), "no_answer": int((codes == Outcome.NO_ANSWER).sum()),
        "unsettled": int((codes == Outcome.UNSETTLED).sum()), "rolls": int((codes == Outcome.BRAKES).sum()),
        "marked": bool(cannot(states)[i] + unanswered(states)[i] > UNANSWERED),
        "extrapolated": bool(slip > driven[1]),
    }  # fmt: skip


SLOPES = (0.0, 5 * DEGREE, 10 * DEGREE, 15 * DEGREE)
"""Slopes, rad, that are asked for by default."""
DRAWS = 1000
"""Posterior draws, at most, that a rover drives on."""
STEEPEST = 45 * DEGREE
CURVE = 21
"""Slopes, or tow forces, of a smooth curve."""
CURVES = 1
"""Seed of the model's own errors of a rover's wheels."""
RESPONSE = ("sinkage", "drawbar_pull", "resistance_moment")
"""What a ground answers with, in its order."""


def predict_rover(
    result: Result,
    rover: Rover | str | Path,
    *,
    slopes: Sequence[float | str] = SLOPES,
    tows: Sequence[float | str] = (0.0,),
    group: str | None = None,
    probabilities: Sequence[str] = (),
) -> RoverOutlook:
    """Drive a rover up slopes and against tow forces on the soil of every posterior draw.

    Parameters
    ----------
    rover : a :class:`Rover`, or a file of one.
    slopes : rad, or text with a unit, from 0 to 45 degrees.
    tows : forces that pull back along the slope, N or text with a unit; every slope is tried with each.
    group : of a joint posterior, whose parameters count; by default that of the rover's wheels if it has one,
        else one that was not tested.
    probabilities : conditions whose probability is asked for, such as ``slope > 15 deg`` of the greatest slope that
        is climbed, or ``sinkage < 30 mm`` of both axles on every slope.

    Raises
    ------
    StudyError : a file that describes no rover, or a slope or tow force outside its range.
    """
    check_kind("bt.predict_rover", result, Result)
    without_wheels(result.study, "predict")
    dimensions = {**GREATEST, **{name: CHANNELS[name].dimension for name, _, _ in QUANTITIES.values()}}
    conditions = tuple(Condition.read(text, dimensions) for text in probabilities)
    if not isinstance(rover, Rover):
        path = checked_path("bt.predict_rover", rover, "a rover file, or a bt.Rover")
        rover = read_rover(path, result.study.wheels, prior_phi(result.study))
    alike = [name for name, wheel in result.study.wheels.items() if {wheel} == set(rover.wheels)]
    both = [name for name in dict.fromkeys(rover.wheel_names) if name in alike] or alike[:1]
    result = result.of_group(group, wheel=both[0] if len(both) == 1 else "")
    study = result.study
    front, rear = (resolved(wheel, prior_phi(study)) for wheel in rover.wheels)
    rover = replace(rover, wheels=(front, rear))
    alphas, pulls = checked_slopes(slopes), np.unique([quantity(tow, "N", "tow", bare=True) for tow in tows])
    if not pulls.size or pulls[0] < 0:
        raise StudyError(f"'tow' must not be below 0 N (got {f'{pulls[0]:g} N' if pulls.size else 'none'})")
    draws, index = prediction.spread(result, DRAWS)
    ground: Ground = rover.on(study.prior.soil_values(draws), study.model)
    if study.errors.discrepancy:
        ground = _with_curves(study, rover, ground, draws)
    sweeps = {tow: statics.sweep(rover, ground, len(draws), "slope", tow) for tow in dict.fromkeys((0.0, *pulls))}
    pulled = statics.sweep(rover, ground, len(draws), "tow")
    states = [statics.states_at(rover, ground, sweeps[tow], alphas) for tow in pulls]
    each = {of.name: [getattr(state, of.name) for state in states] for of in fields(State)}
    asked = State(**{name: np.concatenate(parts, axis=1) for name, parts in each.items()})
    steepest = max(alphas.max(), SLOPES[-1])
    rows = study.observations.used().slip
    driven = (float(rows.min()), float(rows.max()))
    return RoverOutlook(
        title=study.title, model=study.model.name, rover=rover, asked=asked,
        over_slope=statics.states_at(rover, ground, sweeps[pulls[0]], np.linspace(0.0, steepest, CURVE)),
        over_tow=_over_tow(rover, ground, float(alphas[0]), pulls, pulled),
        slopes=greatest(rover, ground, sweeps[0.0]),
        slopes_driven=greatest(rover, ground, sweeps[0.0], driven[1]), tows=greatest(rover, ground, pulled),
        tows_driven=greatest(rover, ground, pulled, driven[1]), index=index, driven=driven,
        remarks=tuple(_remarks(study, rover, asked, known=bool(result.basis))), basis=result.basis,
        conditions=conditions,
    )  # fmt: skip


def checked_slopes(slopes: Sequence[float | str]) -> FloatArray:
    """Slopes, rad, in ascending order, each once."""
    values = np.unique([quantity(slope, "rad", "slope", bare=True) for slope in slopes])
    wrong = values[(values < 0) | (values > STEEPEST * (1 + 1e-12))]
    if wrong.size or not values.size:
        got = f"{wrong[0] / DEGREE:.4g} deg" if wrong.size else "none"
        raise StudyError(f"'slope' must lie between 0 and 45 deg (got {got})")
    return values


def _with_curves(study: Study, rover: Rover, ground: Ground, draws: FloatArray) -> CurvedGround:
    """A ground with the model's own error of each wheel, one curve over slip for every draw."""
    target, curves, rng = posterior(study), {}, default_rng(CURVES)
    read, soil, values = target.likelihood, study.prior.soil_values(draws), target.noise_values(draws)
    axles = [(wheel, prediction.name_of(study, wheel, called))
             for wheel, called in zip(rover.wheels, rover.wheel_names, strict=True)]  # fmt: skip
    for axle in dict.fromkeys(axles):
        drawn = read.beyond(soil, values, axle[1], statics.SLIPS, rng)
        curves[axle] = np.zeros((len(draws), len(statics.SLIPS), len(RESPONSE)))
        for i, name in enumerate(RESPONSE):
            if drawn is not None and name in read.channels:
                curves[axle][:, :, i] = drawn[:, :, read.channels.index(name)]
    return CurvedGround(ground, (curves[axles[0]], curves[axles[1]]))


def _over_tow(rover: Rover, ground: Ground, slope: float, tows: FloatArray, flat: Sweep) -> State | None:
    if tows[-1] == 0:
        return None
    traction = flat if slope == 0 else statics.sweep(rover, ground, len(flat.held), "tow", slope)
    return statics.states_at(rover, ground, traction, np.linspace(0.0, tows[-1], CURVE))


def _remarks(study: Study, rover: Rover, asked: State, *, known: bool) -> Iterator[str]:
    """Sentences on where loads, wheels and gravity leave what was measured, and on the model's own error."""
    for wheel in dict.fromkeys(rover.wheels) if study.errors.discrepancy else ():
        yield prediction.error_remark(study, wheel)
    ends, middles = measured_loads(study), quantiles(asked.load)[2]
    loads = middles[np.isfinite(middles)]
    if ends and loads.size and not (0.999 * ends[0] <= loads.min() and loads.max() <= 1.001 * ends[1]):
        named = " to ".join(dict.fromkeys(f"{end:.4g}" for end in ends))
        yield say.plain("loads", loads.min(), loads.max(), named)
    for wheel in dict.fromkeys(rover.wheels):
        yield from prediction.wheel_remarks(study, wheel, known=known)
    if rover.gravity is not None and abs(rover.gravity - EARTH) > 0.1:
        yield say.plain("gravity", rover)
    if not study.errors.discrepancy:
        yield MODEL_ERROR


def slopes_of(texts: Sequence[str]) -> tuple[float | str, ...]:
    """Slopes from texts such as ``0,5,10``, degrees where no unit is given; the default where there are none.

    StudyError where one is not a number.
    """
    slopes: list[float | str] = []
    for part in (part.strip() for text in texts for part in text.split(",")):
        try:
            slopes.append(float(part) * DEGREE)
        except ValueError:
            if not part[:1].isdigit():
                raise StudyError(f"'slope' must be degrees with commas, e.g. 0,5,10 (got {part!r})") from None
            slopes.append(part)
    return tuple(slopes) or SLOPES


def tows_of(texts: Sequence[str]) -> tuple[float | str, ...]:
    """Tow forces from texts such as ``0 N,35 N``; none where there are none."""
    return tuple(part.strip() for text in texts for part in text.split(",")) or (0.0,)
