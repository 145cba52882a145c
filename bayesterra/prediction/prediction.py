"""Prediction: draws and bands for wheels, loads and slips that were not measured."""

import re
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
import pandas as pd
from numpy.random import default_rng
from numpy.typing import ArrayLike
from typing_extensions import TypedDict

from bayesterra.arrays import FloatArray, IntArray, answered_quantiles
from bayesterra.errors import StudyError, check_kind, check_seed, enumerated
from bayesterra.likelihood.forward import Forward, Outcomes, derive_for, load_of
from bayesterra.likelihood.posterior import REASONS, posterior
from bayesterra.models import Conditions, Wheel
from bayesterra.models.geometry import convert_slip
from bayesterra.models.traction import tractive_efficiency
from bayesterra.parameters import CHANNELS, DERIVED, EFFICIENCY, Channel
from bayesterra.report.sections import Prose
from bayesterra.runtime.tables import Count, Number, Record
from bayesterra.stats.diagnostics import hdi
from bayesterra.study.drive import Drive
from bayesterra.study.result import CURVE_QUANTILES, AnalysisResult, Result
from bayesterra.study.study import Study, without_wheels
from bayesterra.study.units import quantity
from bayesterra.study.wheels import checked_slips, chosen_wheel, chosen_wheels, driven_range, measured_loads

say = Prose("prediction")

UNANSWERED = 0.05
"""Share of draws without an answer from which a band is marked."""
PREDICTED: dict[str, Channel] = {**{name: CHANNELS[name] for name in Drive.LOAD.outcomes}, EFFICIENCY.name: EFFICIENCY}
"""Outcomes that are predicted, the last axis of predictions."""


@dataclass(frozen=True)
class Condition:
    """What a quantity is asked to be: above or below a value."""

    text: str  # as it was asked
    name: str  # of the quantity
    above: bool  # whether it is to lie above ``value``, SI, or below
    value: float

    @classmethod
    def read(cls, text: str, dimensions: Mapping[str, str]) -> "Condition":
        """Condition from a text such as ``drawbar_pull > 20 N``.

        Parameters
        ----------
        dimensions : of the quantities that may be asked for, a unit each.

        Raises
        ------
        StudyError : it has another form, or asks for another quantity.
        """
        found = re.fullmatch(r"\s*(\w+)\s*([<>])\s*(.+?)\s*", text)
        name, sign, value = found.groups() if found else ("", "", "")
        if name not in dimensions:
            raise StudyError(
                f"'probability' must be a quantity, > or <, and a value, e.g. \"drawbar_pull > 20 N\", of"
                f" {enumerated(list(dimensions))} (got {text!r})"
            )
        dimension = dimensions[name]
        size = float(value) if not dimension and _NUMBER.fullmatch(value) else quantity(value, dimension, name)
        return cls(f"{name} {sign} {value}", name, sign == ">", size)

    def share(self, values: FloatArray) -> float:
        """Share of draws (n,) that meet it; those without an answer do not."""
        met = values > self.value if self.above else values < self.value
        return float(np.mean(met & np.isfinite(values)))


_NUMBER = re.compile(r"[-+]?[0-9.]+(e[-+]?[0-9]+)?")

PredictedCase = TypedDict("PredictedCase", {  # noqa: UP013 (a line for each kind of entry)
    "wheel": dict[str, Any], "load": Number, "slip": list[Number], "draws": Count,
    "share_without_answer": list[Number], "marked_above": Number, "notes": list[str],
})  # fmt: skip


class Predicted(AnalysisResult):
    """Predictions that are shown and saved together."""

    MARK = "prediction.json"
    RECORD = Record.having(kind=Literal["prediction"], title=str, bayesterra=str, predictions=list[PredictedCase])
    VIEW = "bayesterra.prediction.page:forecast"
    PAGE = ""
    FIGURES: ClassVar[Mapping[str, str]] = {"prediction.png": "predictions"}
    CALLED = "Written"
    DIGITS = None

    @property
    @abstractmethod
    def cases(self) -> "Sequence[Case]":
        """Predictions on slip grids, and at the slips that were asked for."""

    @property
    def points(self) -> "list[Prediction]":
        """Predictions at the slips that were asked for."""
        return [at or curve for curve, at in self.cases]

    def tables(self) -> dict[str, pd.DataFrame]:
        """Bands, draws and derived quantities."""
        return {
            "bands": pd.concat([at.table for at in self.points]),
            "draws": pd.concat([at.to_dataframe() for at in self.points]),
            "derived": pd.concat([at.labelled_table for at in self.points]),
        }

    def to_record(self) -> dict[str, Any]:
        """Content of the JSON file."""
        return {
            "kind": "prediction",
            "title": self.points[0].title,
            "bayesterra": version("bayesterra"),
            "predictions": [
                {
                    "wheel": {"name": at.name, **asdict(at.wheel)},
                    "load": at.load,
                    "slip": at.slip.tolist(),
                    "draws": len(at.index),
                    "share_without_answer": at.unanswered.tolist(),
                    "marked_above": UNANSWERED,
                    "notes": list(at.notes),
                }
                for at in self.points
            ],
        }


@dataclass(frozen=True)
class Prediction(Predicted):
    """One wheel under one load, at some slips."""

    title: str  # of the study that the draws come from
    name: str  # of the wheel
    wheel: Wheel  # its dimensions
    load: float  # N
    slip: FloatArray  # (k,) on the shearing radius, ascending
    modelled: FloatArray  # (n, k, 4) without noise in the order of ``PREDICTED``, SI; NaN where the model has no answer
    readings: FloatArray  # the same with the study's measurement noise; NaN also for what was not measured there
    reasons: IntArray  # (n, k) why there is no answer: a key of ``REASONS`` of the posterior, 0 where there is one
    index: IntArray  # (n, 2) chain and draw of every parameter set, as in ``draws.nc``
    driven: tuple[float, float]  # lowest and highest slip of the study's rows in the fit
    derived: Mapping[str, FloatArray]  # draws of the quantities of ``derived.DERIVED`` for this wheel and load, SI
    derived_prior: Mapping[str, FloatArray]  # the same of the prior
    remarks: tuple[str, ...]  # where load and wheel leave what was measured; one sentence each
    model_error: bool = False  # whether the error of the model itself is part of the outcomes, as a study may state it

    @property
    def cases(self) -> "Sequence[Case]":
        """The prediction alone."""
        return ((self, None),)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences on where the prediction leaves what was measured, one each."""
        low, high = self.driven
        beyond = self.slip[(self.slip < low) | (self.slip > high)]
        if not beyond.size:
            return self.remarks
        named = ", ".join(f"{slip:.3g}" for slip in (beyond if beyond.size < 4 else beyond[[0, -1]]))
        return (f"slip {named} lies outside the driven slips, {low:.3g} to {high:.3g}: extrapolated", *self.remarks)

    def at(self, slip: FloatArray) -> "Prediction":
        """The same prediction at some of its slips only."""
        keep = np.isin(self.slip, slip)
        parts = {name: getattr(self, name)[:, keep] for name in ("modelled", "readings", "reasons")}
        return replace(self, slip=self.slip[keep], **parts)

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
        return pd.DataFrame([self._row(i, name) for i in range(len(self.slip)) for name in PREDICTED])

    def _row(self, i: int, name: str) -> dict[str, object]:
        outcome, column = PREDICTED[name], list(PREDICTED).index(name)
        modelled = quantile_columns(self.modelled[:, i, column], outcome.scale, "modelled_")
        readings = quantile_columns(self.readings[:, i, column], outcome.scale, "reading_")
        codes, counts = np.unique(self.reasons[:, i][self.reasons[:, i] != 0], return_counts=True)
        return {
            "wheel": self.name, "load [N]": self.load, "slip": self.slip[i], "quantity": name, "unit": outcome.unit,
            **modelled, **readings, "draws": len(self.reasons), "no_answer": int(counts.sum()),
            "marked": bool(self.unanswered[i] > UNANSWERED),
            "reason": REASONS[int(codes[counts.argmax()])] if len(codes) else "",
            "extrapolated": not self.driven[0] <= self.slip[i] <= self.driven[1],
        }  # fmt: skip

    @property
    def derived_table(self) -> pd.DataFrame:
        """Posterior and prior of every derived quantity that has an answer, field units."""
        rows = (_derived_row(name, self.derived[name], self.derived_prior[name]) for name in self.derived)
        return pd.DataFrame([row for row in rows if row])

    @property
    def labelled_table(self) -> pd.DataFrame:
        """The derived quantities with their wheel and load."""
        table = self.derived_table
        table.insert(0, "wheel", self.name)
        table.insert(1, "load [N]", self.load)
        return table

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
        for column, (name, outcome) in enumerate(PREDICTED.items()):
            unit = "" if outcome.unit == "-" else f" [{outcome.unit}]"
            for kind, values in (("", self.modelled), ("_reading", self.readings)):
                if not np.isnan(values[:, :, column]).all():
                    columns[f"{name}{kind}{unit}"] = values[:, :, column].ravel() / outcome.scale
        return pd.DataFrame(columns)


Case: TypeAlias = tuple[Prediction, Prediction | None]
"""A prediction on a slip grid, and at the slips that were asked for."""


@dataclass(frozen=True)
class Forecast(Predicted):
    """Predictions of several wheels and loads, and how probable it is that they meet some conditions."""

    cases: tuple[Case, ...] = ()
    conditions: tuple[Condition, ...] = ()

    @property
    def probabilities(self) -> pd.DataFrame:
        """One row per wheel, load, slip and condition: share of the draws that meet it, without noise of readings."""
        names = list(PREDICTED)
        rows = [
            {
                "wheel": at.name, "load [N]": at.load, "slip": slip, "condition": condition.text,
                "probability": condition.share(at.modelled[:, i, names.index(condition.name)]),
                "no_answer": at.unanswered[i], "model_error": at.model_error,
                "extrapolated": not at.driven[0] <= slip <= at.driven[1],
            }
            for at in self.points for i, slip in enumerate(at.slip) for condition in self.conditions
        ]  # fmt: skip
        return pd.DataFrame(rows)

    def tables(self) -> dict[str, pd.DataFrame]:
        """Bands, draws and derived quantities, and probabilities where they were asked for."""
        return {**super().tables(), **({"probabilities": self.probabilities} if self.conditions else {})}


def quantiles(values: FloatArray) -> FloatArray:
    """Quantiles ``results.CURVE_QUANTILES`` (5, ...) of the finite ones among draws (n, ...), NaN where none is."""
    return answered_quantiles(values, CURVE_QUANTILES)


def quantile_columns(values: FloatArray, scale: float, prefix: str = "") -> dict[str, float]:
    """Quantiles of values (n,) by the names of their columns; ``scale``: SI value of a field unit."""
    levels = zip(CURVE_QUANTILES, quantiles(values), strict=True)
    return {f"{prefix}q{100 * level:02.0f}": value / scale for level, value in levels}


def _derived_row(name: str, posterior: FloatArray, prior: FloatArray) -> dict[str, object]:
    """One row; empty where no draw has an answer."""
    derived = DERIVED[name]
    after, before = (values[np.isfinite(values)] / derived.scale for values in (posterior, prior))
    if not after.size or not before.size:
        return {}
    low, high = hdi(after)
    return {
        "quantity": name, "unit": derived.unit, "median": np.median(after), "mean": after.mean(), "sd": after.std(),
        "hdi90_lo": low, "hdi90_hi": high, "prior_median": np.median(before), "prior_q05": np.quantile(before, 0.05),
        "prior_q95": np.quantile(before, 0.95), "no_answer": int(len(posterior) - after.size),
    }  # fmt: skip


DRAWS = 2000
"""Posterior draws, at most, that are predicted with."""


def predict(
    result: Result,
    slip: ArrayLike,
    *,
    load: float | str | None = None,
    wheel: str | Path | Wheel | None = None,
    name: str = "",
    seed: int = 1,
    group: str | None = None,
) -> Prediction:
    """Predict sinkage, drawbar pull, moment and tractive efficiency with the draws of a result.

    Parameters
    ----------
    slip : slips on the shearing radius, in [0, 1).
    load : vertical load, N or text with a unit; by default the median load of the study's rows in the fit.
    wheel : name of one of the study's wheels (by default its first), a file of one, or another wheel.
    name : what another wheel is called.
    seed : of the noise on the readings, and of the parameters of a group that was not tested.
    group : of a joint posterior, whose parameters count; by default that of the wheel, where groups are
        wheels, else one that was not tested: its own parameters are drawn from the population.

    Raises
    ------
    StudyError : a slip or load outside the model's range, or an unknown wheel or group.
    """
    check_kind("bt.predict", result, Result)
    without_wheels(result.study, "predict")
    check_seed(seed)
    called, driven = chosen_wheel(result.study, wheel, name)
    result = result.of_group(group, wheel=called, seed=seed)
    study = result.study
    at, carried = checked_slips(slip), load_of(study, load)
    draws, index = spread(result)
    forward, outcomes, reasons = answers(study, driven, at, carried, study.prior.soil_values(draws))
    rng = default_rng(seed)
    readings = posterior(study).drive(forward, outcomes, draws, name_of(study, driven, called), rng).values
    efficiency = tractive_efficiency(outcomes["drawbar_pull"], outcomes["resistance_moment"], forward.conditions)
    rows = study.observations.used().slip
    return Prediction(
        title=study.title, name=called, wheel=driven, load=carried, slip=at,
        modelled=np.concatenate([outcomes.values, efficiency[:, :, None]], axis=2),
        readings=np.concatenate([readings, np.full((*readings.shape[:2], 1), np.nan)], axis=2),
        reasons=reasons, index=index,
        driven=(float(rows.min()), float(rows.max())), derived=_derived(study, driven, carried, draws),
        derived_prior=_derived(study, driven, carried, result.values("prior")[:DRAWS]),
        remarks=tuple(_remarks(study, driven, carried, result.basis)), model_error=bool(study.errors.discrepancy),
    )  # fmt: skip


def answers(
    study: Study, driven: Wheel, slip: FloatArray, load: float, soil: FloatArray
) -> tuple[Forward, Outcomes, IntArray]:
    """A wheel under a load (N) at slips (k,), its outcomes for soils (n, p), and why there is none, (n, k)."""
    forward = Forward(study.model, Drive.LOAD, Conditions.of(driven, slip), np.full(len(slip), load))
    blocks = [forward.row(i)(soil) for i in range(len(slip))]
    outcomes = replace(blocks[0], values=np.concatenate([block.values for block in blocks], axis=1))
    return forward, outcomes, np.column_stack([block.status for block in blocks])


def spread(result: Result, most: int = DRAWS) -> tuple[FloatArray, IntArray]:
    """At most ``most`` evenly spaced posterior draws (n, d), and chain and draw of each (n, 2)."""
    draws = result.values()
    take = np.arange(0, len(draws), max(1, -(-len(draws) // most)))
    chain, draw = np.divmod(take, result.draws["posterior"].sizes["draw"])
    return draws[take], np.column_stack([chain, draw])


def name_of(study: Study, driven: Wheel, called: str) -> str | None:
    """Name of a wheel of the study, of several alike the one called so or the first; None for another one."""
    alike = [name for name, wheel in study.wheels.items() if wheel == driven]
    return called if called in alike else next(iter(alike), None)


def _derived(study: Study, wheel: Wheel, load: float, x: FloatArray) -> dict[str, FloatArray]:
    return derive_for(study.model, wheel, load, study.prior.soil_values(x))


def _remarks(study: Study, wheel: Wheel, load: float, basis: str) -> Iterator[str]:
    """Sentences on where load and wheel leave what was measured."""
    if basis:
        yield basis
    ends = measured_loads(study)
    if ends and not 0.999 * ends[0] <= load <= 1.001 * ends[1]:
        named = " to ".join(dict.fromkeys(f"{end:.4g}" for end in ends))
        yield f"load {load:.4g} N is not among the measured loads, {named} N: extrapolated"
    if study.errors.discrepancy:
        yield f"{error_remark(study, wheel)}; derived quantities are those of the model alone"
    yield from wheel_remarks(study, wheel, known=bool(basis))


def error_remark(study: Study, wheel: Wheel) -> str:
    """A sentence on the model's own error where a wheel is predicted."""
    told = "as its readings tell it" if wheel in study.wheels.values() else "as stated before any reading"
    return f"the model's own error is part of it, {told}"


def wheel_remarks(study: Study, wheel: Wheel, *, known: bool = False) -> Iterator[str]:
    """Sentences on where a wheel leaves those that were measured; ``known``: its parameters allow for it."""
    if wheel not in study.wheels.values() and not known:
        yield say.plain("other_wheel", study.wheels)
    widths = {measured.width for measured in study.wheels.values()}
    if wheel.width not in widths and not study.prior.uses_moduli:
        named = ", ".join(f"{1e3 * width:g} mm" for width in sorted(widths))
        yield say.plain("width", named, wheel.width)


def slips_of(texts: Sequence[str]) -> list[float]:
    """Slips from texts such as ``0.1,0.3``; StudyError where one is not a number."""
    slips = []
    for part in (part.strip() for text in texts for part in text.split(",")):
        try:
            slips.append(float(part))
        except ValueError:
            raise StudyError(f"'slip' must be numbers with commas, e.g. 0.1,0.3 (got {part!r})") from None
    return slips


def forecast(
    result: Result,
    *,
    slips: Sequence[float] = (),
    loads: Sequence[str] = (),
    wheels: Sequence[str] = (),
    slip_reference: str = "shearing",
    group: str | None = None,
    probabilities: Sequence[str] = (),
) -> Forecast:
    """Predict every wheel under every load.

    Parameters
    ----------
    group : of a joint posterior, whose parameters count; by default as for :func:`predict`.
    slips : asked for; by default those that were driven.
    loads : texts with units; by default the median load of the study.
    wheels : names or files; by default the study's first wheel.
    slip_reference : radius behind ``slips``: ``rim`` r, ``tip`` r + h, ``shearing`` r_s.
    probabilities : conditions whose probability is asked for, such as ``drawbar_pull > 20 N``.
    """
    without_wheels(result.study, "predict")
    dimensions = {name: channel.dimension for name, channel in PREDICTED.items()}
    conditions = tuple(Condition.read(text, dimensions) for text in probabilities)
    cases: list[Case] = []
    for name, wheel in chosen_wheels(result.study, wheels or (None,)).items():
        asked = _on_shearing_radius(slips, wheel, slip_reference)
        asked = asked if asked.size else np.unique(result.study.observations.used().slip)
        driven = driven_range(result.study)  # bands of the plot hold all that were driven or asked for
        low, high = min(driven[0], asked.min()), max(driven[-1], asked.max())
        grid = np.linspace(low, high, len(driven))
        for load in loads or (None,):
            slip = np.union1d(grid, asked)
            whole = predict(result, slip, load=load, wheel=wheel, name=name, group=group)
            cases.append((whole.at(grid), whole.at(asked)))
    return Forecast(tuple(cases), conditions)


def _on_shearing_radius(slips: Sequence[float], wheel: Wheel, reference: str) -> FloatArray:
    radii = {"rim": wheel.radius, "tip": wheel.radius + wheel.lug_height}
    if not len(slips):
        return np.empty(0)
    values = checked_slips(slips)
    if reference in radii:
        converted = convert_slip(values, radii[reference], float(wheel.shearing_radius()))
        return checked_slips(np.asarray(converted))
    if reference != "shearing":
        raise StudyError(f"'slip_reference' must be rim, tip or shearing (got {reference!r})")
    return values
