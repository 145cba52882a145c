"""Bands and draws for wheels, loads and slips that were not measured."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.derived import DERIVED, EFFICIENCY
from bayesterra.diagnostics import hdi
from bayesterra.models import Wheel
from bayesterra.parameters import CHANNELS, Channel
from bayesterra.posteriors import REASONS
from bayesterra.results import CURVE_QUANTILES

UNANSWERED = 0.05
"""Share of draws without an answer from which a band is marked."""
PREDICTED: dict[str, Channel] = {
    **{name: CHANNELS[name] for name in ("sinkage", "drawbar_pull", "resistance_moment")},
    EFFICIENCY.name: EFFICIENCY,
}
"""What is predicted, the last axis of predictions."""
_MODELLED, _READING = "modelled", "reading"


@dataclass(frozen=True)
class Prediction:
    """One wheel under one load, at some slips.

    Attributes
    ----------
    title : of the study that the draws come from.
    name : of the wheel.
    wheel : its dimensions.
    load : N.
    slip : (k,) on the shearing radius, ascending.
    modelled : (n, k, 4) without noise in the order of ``PREDICTED``, SI; NaN where the model has no answer.
    readings : the same with the study's measurement noise; NaN also for what was not measured there.
    reasons : (n, k) why there is no answer: a key of ``posteriors.REASONS``, 0 where there is one.
    index : (n, 2) chain and draw of every parameter set, as in ``draws.nc``.
    driven : lowest and highest slip of the study's rows in the fit.
    derived, derived_prior : draws of the quantities of ``derived.DERIVED`` for this wheel and load, SI.
    remarks : where load and wheel leave what was measured; one sentence each.
    """

    title: str
    name: str
    wheel: Wheel
    load: float
    slip: FloatArray
    modelled: FloatArray
    readings: FloatArray
    reasons: IntArray
    index: IntArray
    driven: tuple[float, float]
    derived: Mapping[str, FloatArray]
    derived_prior: Mapping[str, FloatArray]
    remarks: tuple[str, ...]

    @property
    def notes(self) -> tuple[str, ...]:
        """Where the prediction leaves what was measured; one sentence each."""
        low, high = self.driven
        beyond = self.slip[(self.slip < low) | (self.slip > high)]
        if not beyond.size:
            return self.remarks
        named = ", ".join(f"{slip:.3g}" for slip in (beyond if beyond.size < 4 else beyond[[0, -1]]))
        return (
            f"slip {named} lies outside the driven slips, {low:.3g} to {high:.3g}: extrapolated",
            *self.remarks,
        )

    def at(self, slip: FloatArray) -> Prediction:
        """The same prediction at some of its slips only."""
        keep = np.isin(self.slip, slip)
        return replace(
            self,
            slip=self.slip[keep],
            modelled=self.modelled[:, keep],
            readings=self.readings[:, keep],
            reasons=self.reasons[:, keep],
        )

    @property
    def unanswered(self) -> FloatArray:
        """Share (k,) of the draws for which the model has no answer at each slip."""
        return np.asarray((self.reasons != 0).mean(axis=0))

    @property
    def marked(self) -> tuple[float, ...]:
        """Slips at which more than ``UNANSWERED`` of the draws have no answer: no band to rely on."""
        return tuple(float(slip) for slip in self.slip[self.unanswered > UNANSWERED])

    @property
    def table(self) -> pd.DataFrame:
        """Bands: one row per slip and quantity, field units; quantiles of the draws that have an answer."""
        return pd.DataFrame(
            [self._row(i, name) for i in range(len(self.slip)) for name in PREDICTED],
        )

    def _row(self, i: int, name: str) -> dict[str, object]:
        known, column = PREDICTED[name], list(PREDICTED).index(name)
        bands = {
            f"{kind}_q{100 * level:02.0f}": value / known.scale
            for kind, values in ((_MODELLED, self.modelled), (_READING, self.readings))
            for level, value in zip(CURVE_QUANTILES, quantiles(values[:, i, column]), strict=True)
        }
        codes, counts = np.unique(self.reasons[:, i][self.reasons[:, i] != 0], return_counts=True)
        return {
            "wheel": self.name,
            "load [N]": self.load,
            "slip": self.slip[i],
            "quantity": name,
            "unit": known.unit,
            **bands,
            "draws": len(self.reasons),
            "no_answer": int(counts.sum()),
            "marked": bool(self.unanswered[i] > UNANSWERED),
            "reason": REASONS[int(codes[counts.argmax()])] if len(codes) else "",
            "extrapolated": not self.driven[0] <= self.slip[i] <= self.driven[1],
        }

    @property
    def derived_table(self) -> pd.DataFrame:
        """Posterior and prior of every derived quantity that has an answer, field units."""
        rows = (_derived_row(name, self.derived[name], self.derived_prior[name]) for name in self.derived)
        return pd.DataFrame([row for row in rows if row])

    def to_dataframe(self) -> pd.DataFrame:
        """Every draw at every slip: chain, draw, wheel, load, slip, then values without and with noise."""
        n, k = self.reasons.shape
        columns: dict[str, object] = {
            "chain": np.repeat(self.index[:, 0], k),
            "draw": np.repeat(self.index[:, 1], k),
            "wheel": self.name,
            "load [N]": self.load,
            "slip": np.tile(self.slip, n),
        }
        for column, (name, known) in enumerate(PREDICTED.items()):
            unit = "" if known.unit == "-" else f" [{known.unit}]"
            for kind, values in (("", self.modelled), ("_" + _READING, self.readings)):
                if not np.isnan(values[:, :, column]).all():
                    columns[f"{name}{kind}{unit}"] = values[:, :, column].ravel() / known.scale
        return pd.DataFrame(columns)


def quantiles(values: FloatArray) -> FloatArray:
    """Quantiles ``results.CURVE_QUANTILES`` of the finite ones among ``values`` (n,), NaN where none is."""
    answered = values[np.isfinite(values)]
    return np.quantile(answered, CURVE_QUANTILES) if answered.size else np.full(len(CURVE_QUANTILES), np.nan)


def _derived_row(name: str, posterior: FloatArray, prior: FloatArray) -> dict[str, object]:
    """One row; empty where no draw has an answer."""
    known = DERIVED[name]
    after, before = (values[np.isfinite(values)] / known.scale for values in (posterior, prior))
    if not after.size or not before.size:
        return {}
    low, high = hdi(after)
    return {
        "quantity": name,
        "unit": known.unit,
        "median": np.median(after),
        "mean": after.mean(),
        "sd": after.std(),
        "hdi90_lo": low,
        "hdi90_hi": high,
        "prior_median": np.median(before),
        "prior_q05": np.quantile(before, 0.05),
        "prior_q95": np.quantile(before, 0.95),
        "no_answer": int(len(posterior) - after.size),
    }
