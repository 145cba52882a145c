"""What is done with finished results: predictions and comparisons, written as folders."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from importlib.metadata import version
from pathlib import Path
from typing import Self

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from bayesterra import predicting, report
from bayesterra.arrays import FloatArray
from bayesterra.csvfiles import csv_text
from bayesterra.errors import StudyError
from bayesterra.figures.forecast import predictions_png
from bayesterra.folders import check_free, whole_folder, write_bytes, write_text
from bayesterra.messages import check_kind, check_seed, checked_path
from bayesterra.models import Wheel
from bayesterra.models.geometry import convert_slip
from bayesterra.notebook import comparison_table, prediction_table
from bayesterra.predicting import checked_slips, driven_range, wheel_named
from bayesterra.prediction import UNANSWERED, Prediction
from bayesterra.results import Result
from bayesterra.side_by_side import Comparison, check_count, side_by_side
from bayesterra.workflow import load_single

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
    found = []
    for part in (part.strip() for text in texts for part in text.split(",")):
        try:
            found.append(float(part))
        except ValueError:
            raise StudyError(f"'slip' must be numbers with commas, e.g. 0.1,0.3 (got {part!r})") from None
    return found


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
    for name, wheel in [wheel_named(result.study, given) for given in wheels or (None,)]:
        asked = _on_shearing_radius(slips, wheel, slip_reference)
        asked = asked if asked.size else np.unique(result.study.observations.used().slip)
        grid = _grid(result, asked)
        for load in loads or (None,):
            whole = predicting.predict(result, np.union1d(grid, asked), load=load, wheel=wheel, name=name)
            cases.append((whole.at(grid), whole.at(asked)))
    return cases


def _on_shearing_radius(slips: Sequence[float], wheel: Wheel, reference: str) -> FloatArray:
    radii = {"rim": wheel.radius, "tip": wheel.radius + wheel.lug_height}
    if not len(slips):
        return np.empty(0)
    given = checked_slips(slips)
    if reference in radii:
        converted = convert_slip(given, radii[reference], float(wheel.shearing_radius()))
        return checked_slips(np.asarray(converted))
    if reference != "shearing":
        raise StudyError(f"'slip_reference' must be rim, tip or shearing (got {reference!r})")
    return given


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
        return PredictionSheet.of(predicting.predict(result, slip, load=load, wheel=wheel, seed=seed))
    name, chosen = wheel_named(result.study, None if wheel is None else str(wheel))
    return PredictionSheet.of(predicting.predict(result, slip, load=load, wheel=chosen, name=name, seed=seed))


class ComparisonPage(Comparison):
    """A comparison that shows itself in a notebook and can be saved as a folder with its page."""

    @classmethod
    def of(cls, comparison: Comparison) -> Self:
        """The same comparison, with a page to write."""
        return cls(**{field.name: getattr(comparison, field.name) for field in fields(Comparison)})

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write the page and the tables into a new folder; returns the path of the page.

        Raises
        ------
        ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
        """
        with whole_folder(Path(folder), overwrite=overwrite, mark=COMPARISON) as part:
            write_text(part / "comparison.html", report.comparison_html(self))
            write_text(part / COMPARISON, csv_text(self.parameters))
            write_text(part / "predictions.csv", csv_text(self.predictions))
            write_text(part / "evidence.csv", csv_text(self.evidences))
        return Path(folder) / "comparison.html"

    def _repr_html_(self) -> str:
        return comparison_table(self)


def compare(
    results: Mapping[str, Result] | Sequence[str | Path],
    *,
    load: float | str | None = None,
    wheel: str | Path | None = None,
) -> ComparisonPage:
    """Set results side by side: parameters, predictions under one load, evidence.

    Parameters
    ----------
    results : two to six by the names they are to go by, or their folders. Others are compared with the first.
    load : under which all predict, N or text with a unit; by default the first result's median load.
    wheel : that all drive, by its name in one of the studies or in a file; by default each drives its own.

    Raises
    ------
    ResultError : too few or too many results, or a folder that cannot be read.
    StudyError : an unknown wheel, or no load is known to compare them under.
    """
    named = _named(results)
    chosen = None if wheel is None else _common_wheel(named, str(wheel))
    return ComparisonPage.of(side_by_side(named, load=load, wheel=chosen))


def _named(results: object) -> Mapping[str, Result]:
    """The results to compare by name, read where they are folders."""
    if isinstance(results, Mapping):
        for result in results.values():
            check_kind("bt.compare", result, Result)
        return {str(name): result for name, result in results.items()}
    if not isinstance(results, list | tuple):
        got = repr(results) if isinstance(results, str) else type(results).__name__
        raise StudyError(f"bt.compare needs a list of result folders, or results by name (got {got})")
    what = "a result folder in its list (results themselves go by name: {'a': result})"
    return load_results([checked_path("bt.compare", folder, what) for folder in results])


def _common_wheel(results: Mapping[str, Result], given: str) -> tuple[str, Wheel]:
    knows = (result for result in results.values() if given in result.study.wheels)
    return wheel_named(next(knows, next(iter(results.values()))).study, given)


def load_results(folders: Sequence[Path]) -> dict[str, Result]:
    """Read result folders, by the names of the folders, made different where they are the same."""
    results: dict[str, Result] = {}
    for folder in folders:
        name = folder.resolve().name.removesuffix("-result") or str(folder)
        same = sum(known.partition(" (")[0] == name for known in results)
        results[f"{name} ({same + 1})" if same else name] = load_single(folder)
    return results


def compare_folders(
    folders: Sequence[Path],
    out: Path,
    *,
    load: str | None = None,
    wheel: str | None = None,
    overwrite: bool = False,
) -> ComparisonPage:
    """Compare result folders and write the page and its tables to ``out``; options as :func:`compare`."""
    check_count(folders)
    check_free(out, overwrite=overwrite, mark=COMPARISON)
    comparison = compare(folders, load=load, wheel=wheel)
    comparison.save(out, overwrite=overwrite)
    return comparison
