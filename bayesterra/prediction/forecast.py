"""Forecasts: predictions of wheels and loads from a result, as a folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, check_kind, check_seed
from bayesterra.models import Wheel
from bayesterra.models.geometry import convert_slip
from bayesterra.prediction import prediction
from bayesterra.prediction.prediction import UNANSWERED, Prediction
from bayesterra.runtime.folders import whole_folder, write_bytes, write_text
from bayesterra.runtime.tables import csv_text
from bayesterra.study.result import Result
from bayesterra.study.wheels import checked_slips, driven_range, wheel_named

PREDICTION, COMPARISON = "prediction.json", "comparison.csv"
"""Files by which folders of the two kinds are known."""
Case = tuple[Prediction, Prediction | None]
"""A prediction on a slip grid, and at the slips that were asked for."""


def slips_of(texts: Sequence[str]) -> list[float]:
    """Slips from texts such as ``0.1,0.3``.

    Raises
    ------
    StudyError : one is not a number.
    """
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
) -> list[Case]:
    """Predict every wheel under every load.

    Parameters
    ----------
    slips : asked for; by default those that were driven.
    loads : texts with units; by default the median load of the study.
    wheels : names or files; by default the study's first wheel.
    slip_reference : radius behind ``slips``: ``rim`` r, ``tip`` r + h, ``shearing`` r_s.
    """
    cases: list[Case] = []
    for name, wheel in [wheel_named(result.study, text) for text in wheels or (None,)]:
        asked = _on_shearing_radius(slips, wheel, slip_reference)
        asked = asked if asked.size else np.unique(result.study.observations.used().slip)
        grid = _grid(result, asked)
        for load in loads or (None,):
            whole = prediction.predict(result, np.union1d(grid, asked), load=load, wheel=wheel, name=name)
            cases.append((whole.at(grid), whole.at(asked)))
    return cases


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


def _grid(result: Result, asked: FloatArray) -> FloatArray:
    """Slips for the bands of the plot: all that were driven or asked for."""
    driven = driven_range(result.study)
    low, high = min(driven[0], asked.min()), max(driven[-1], asked.max())
    return np.linspace(low, high, len(driven))


def predict_into(folder: Path, cases: Sequence[Case], *, overwrite: bool = False) -> None:
    """Write bands, draws, derived quantities, the plot and a record of predictions into a new folder.

    Raises
    ------
    ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
    """
    from bayesterra.prediction.page import predictions_png

    points = [at or curve for curve, at in cases]
    derived = [_labelled(at.derived_table, at) for at in points]
    with whole_folder(folder, overwrite=overwrite, mark=PREDICTION) as part:
        write_text(part / "bands.csv", csv_text(pd.concat([at.table for at in points])))
        write_text(part / "draws.csv", csv_text(pd.concat([at.to_dataframe() for at in points])))
        write_text(part / "derived.csv", csv_text(pd.concat(derived)))
        write_bytes(part / "prediction.png", predictions_png(cases))
        write_text(part / PREDICTION, json.dumps(_record(points), indent=1, ensure_ascii=False) + "\n")


def _labelled(table: pd.DataFrame, at: Prediction) -> pd.DataFrame:
    table.insert(0, "wheel", at.name)
    table.insert(1, "load [N]", at.load)
    return table


def _record(points: Sequence[Prediction]) -> dict[str, object]:
    return {
        "kind": "prediction",
        "title": points[0].title,
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
            for at in points
        ],
    }


class PredictionSheet(Prediction):
    """A prediction that shows itself in a notebook and can be saved as a folder with its plot."""

    @classmethod
    def of(cls, prediction: Prediction) -> Self:
        """The same prediction, with tables to show."""
        return cls(**{field.name: getattr(prediction, field.name) for field in fields(Prediction)})

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write bands, draws, derived quantities and a plot into a new folder; returns its path.

        Raises
        ------
        ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
        """
        predict_into(Path(folder), [(self, None)], overwrite=overwrite)
        return Path(folder)

    def _repr_html_(self) -> str:
        from bayesterra.prediction.page import prediction_table

        return prediction_table(self)


def predict(
    result: Result,
    slip: ArrayLike,
    *,
    load: float | str | None = None,
    wheel: str | Path | Wheel | None = None,
    seed: int = 1,
) -> PredictionSheet:
    """Predict sinkage, drawbar pull, moment and tractive efficiency with the draws of a result.

    Parameters
    ----------
    slip : slips on the shearing radius, in [0, 1).
    load : vertical load, N or text with a unit; by default the median load of the study's rows in the fit.
    wheel : name of one of the study's wheels (by default its first), a file of one, or another wheel.
    seed : of the noise on the readings.

    Raises
    ------
    StudyError : a slip or load outside the model's range, or an unknown wheel.
    """
    check_kind("bt.predict", result, Result)
    check_seed(seed)
    if isinstance(wheel, Wheel):
        return PredictionSheet.of(prediction.predict(result, slip, load=load, wheel=wheel, seed=seed))
    name, chosen = wheel_named(result.study, None if wheel is None else str(wheel))
    return PredictionSheet.of(prediction.predict(result, slip, load=load, wheel=chosen, name=name, seed=seed))
