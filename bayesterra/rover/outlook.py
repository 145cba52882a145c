"""What the draws of a result say about a rover: slips, loads, sinkages, and the greatest slope."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.parameters import CHANNELS
from bayesterra.prediction import UNANSWERED, quantiles
from bayesterra.results import CURVE_QUANTILES
from bayesterra.rover.climbing import Greatest
from bayesterra.rover.equilibrium import OUTCOMES, Outcome, State
from bayesterra.rover.geometry import AXLES, Rover

QUANTITIES = {
    "slip": ("slip", 1.0, "-"),
    "load": ("load", 1.0, "N"),
    "sinkage": ("sinkage", CHANNELS["sinkage"].scale, "mm"),
    "pull": ("drawbar_pull", 1.0, "N"),
    "moment": ("resistance_moment", 1.0, "N m"),
}
"""Fields of a state: name in tables, SI value of a field unit, field unit."""
MODEL_ERROR = (
    "the bands hold what the readings leave open about the soil; the error of the wheel-soil model itself"
    " is not in them"
)
FAILURES = (Outcome.CANNOT, Outcome.SINKS, Outcome.LIFTS)
DEGREE = float(np.pi / 180)


@dataclass(frozen=True)
class RoverOutlook:
    """A rover on the soils of n posterior draws.

    Attributes
    ----------
    title : of the study that the draws come from.
    model : name of its wheel-soil model.
    rover : weight, dimensions, wheels, and which of these are assumptions.
    asked : states (n, k) at every slope and tow force that were asked for.
    over_slope : states at slopes for a smooth curve, against the first tow force.
    over_tow : the same at tow forces on the first slope; None where no tow force was asked for.
    slopes, tows : greatest slope without a tow force, greatest tow force on the flat.
    slopes_driven, tows_driven : the same at slips no higher than the highest that was driven.
    index : (n, 2) chain and draw of every parameter set, as in ``draws.nc``.
    driven : lowest and highest slip of the study's rows in the fit.
    remarks : where rover and loads leave what was measured; one sentence each.
    """

    title: str
    model: str
    rover: Rover
    asked: State
    over_slope: State
    over_tow: State | None
    slopes: Greatest
    slopes_driven: Greatest
    tows: Greatest
    tows_driven: Greatest
    index: IntArray
    driven: tuple[float, float]
    remarks: tuple[str, ...]

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
        found = self.slopes_driven if driven else self.slopes
        return float((np.nan_to_num(found.value, nan=-np.inf) >= slope).mean())

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
        return (*(str(one) for one in self.rover.assumptions), *self._slips(), *self.remarks, MODEL_ERROR)

    def _slips(self) -> Iterator[str]:
        low, high = self.driven
        middle = [quantiles(self.asked.slip[:, i].max(axis=1))[2] for i in range(self.asked.slip.shape[1])]
        beyond = [i for i, slip in enumerate(middle) if slip > high]
        if beyond:
            named = ", ".join(_place(self.asked, i) for i in (beyond if len(beyond) < 4 else beyond[:3]))
            more = "" if len(beyond) < 4 else " and more"
            yield (
                f"at {named}{more} the median slip lies above the driven slips, {low:.3g} to {high:.3g}:"
                " extrapolated"
            )
        above = float((self.slopes.slip > high).mean())
        if above > UNANSWERED:
            yield (
                f"for {100 * above:.0f} % of the draws the greatest slope is reached above the driven slips,"
                f" {low:.3g} to {high:.3g}: extrapolated; its value at driven slips stands beside it"
            )

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
        rows = []
        for name, unit, scale, found, most in (
            ("greatest_slope", "deg", DEGREE, self.slopes, "all"),
            ("greatest_slope", "deg", DEGREE, self.slopes_driven, "driven"),
            ("greatest_tow", "N", 1.0, self.tows, "all"),
            ("greatest_tow", "N", 1.0, self.tows_driven, "driven"),
        ):
            values = zip(CURVE_QUANTILES, quantiles(found.value) / scale, strict=True)
            rows.append(
                {
                    "quantity": name,
                    "unit": unit,
                    "slips": most,
                    **{f"q{100 * level:02.0f}": value for level, value in values},
                    "at_slip_q50": quantiles(found.slip)[2],
                    "draws": len(found.value),
                    "no_answer": int(np.isnan(found.value).sum()),
                    "still_rising": int(found.rising.sum()),
                }
            )
        return pd.DataFrame(rows)

    @property
    def climb_table(self) -> pd.DataFrame:
        """Probability to climb slopes in steps of half a degree, at all slips and at the driven ones."""
        steepest = np.nanmax(self.slopes.value, initial=0.0) / DEGREE
        slopes = np.arange(0, np.ceil(steepest) + 0.75, 0.5)
        return pd.DataFrame(
            {
                "slope [deg]": slopes,
                "probability": [self.probability_to_climb(one * DEGREE) for one in slopes],
                "probability_driven_slips": [
                    self.probability_to_climb(one * DEGREE, driven=True) for one in slopes
                ],
            }
        )

    def to_dataframe(self) -> pd.DataFrame:
        """Every draw at every slope and tow force asked for: its state, and how the question ended."""
        states = self.asked
        k = states.outcome.shape[1]
        columns: dict[str, object] = {
            "chain": np.repeat(self.index[:, 0], k),
            "draw": np.repeat(self.index[:, 1], k),
            "slope [deg]": _degrees(states.slope.ravel()),
            "tow [N]": states.tow.ravel(),
            "outcome": [OUTCOMES[Outcome(int(code))] for code in states.outcome.ravel()],
        }
        for field, (name, scale, unit) in QUANTITIES.items():
            for axle, called in enumerate(AXLES):
                header = f"{called}_{name}" + ("" if unit == "-" else f" [{unit}]")
                columns[header] = getattr(states, field)[:, :, axle].ravel() / scale
        return pd.DataFrame(columns)


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
    values = quantiles(getattr(states, field)[:, i, axle] / scale)
    codes = states.outcome[:, i]
    slip = quantiles(states.slip[:, i, axle])[2]
    return {
        "slope [deg]": _degrees(states.slope[0, i]),
        "tow [N]": states.tow[0, i],
        "axle": AXLES[axle],
        "quantity": name,
        "unit": unit,
        **{f"q{100 * level:02.0f}": value for level, value in zip(CURVE_QUANTILES, values, strict=True)},
        "draws": len(codes),
        "cannot": float(cannot(states)[i]),
        "unanswered": float(unanswered(states)[i]),
        "pulls_too_little": int((codes == Outcome.CANNOT).sum()),
        "sinks": int((codes == Outcome.SINKS).sum()),
        "lifts": int((codes == Outcome.LIFTS).sum()),
        "no_answer": int((codes == Outcome.NO_ANSWER).sum()),
        "unsettled": int((codes == Outcome.UNSETTLED).sum()),
        "rolls": int((codes == Outcome.BRAKES).sum()),
        "marked": bool(cannot(states)[i] + unanswered(states)[i] > UNANSWERED),
        "extrapolated": bool(slip > driven[1]),
    }
