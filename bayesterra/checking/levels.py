"""Levels left out of every run: slips, loads, wheels and runs that a fit to the others predicts.

The posterior without a level comes from the draws of the run, by their weights or by a sampling of its own,
see :mod:`bayesterra.checking.loo`; ``holdout`` makes each fit anew. Beside the model a polynomial over slip,
which knows no terramechanics, predicts the same readings.

Readings of one level miss together, so that a level counts once: with the share of its readings that lie in
their 90 % intervals. The least probable count decides, times the number of counts (Bonferroni).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator
from scipy.stats import binom

from bayesterra.arrays import FloatArray, IntArray, spaced
from bayesterra.checking.folds import WAYS, Fold, Scorer, folds_of
from bayesterra.checking.holdout_scores import skills
from bayesterra.checking.loo import Level, Without
from bayesterra.errors import enumerated
from bayesterra.likelihood.joint import Whole
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import likelihood_of
from bayesterra.study.study import Study

CURVE = "polynomial"
DRAWS, ROWS = 300, 120
"""Draws that a predictive law is made of, and rows that are scored, evenly spaced among more."""
BAD, DOUBTFUL = 0.004, 0.02
"""Probabilities of as few readings inside, all counts together, below which a prediction has these grades."""
COVERED = 0.9
WORSE = 3.0
"""Standard errors by which the polynomial must score better for a model that is worse than a curve."""


def ways(study: Study) -> dict[str, tuple[Fold, ...]]:
    """Levels to leave out: of slip, load, wheel and each column of labels, where there are two or more.

    Two ways that part the rows alike count once.
    """
    found, seen = dict[str, tuple[Fold, ...]](), list[set[bytes]]()
    labels = study.observations.labels
    for by in (*(way for way in WAYS if way != "row"), *labels):
        folds = folds_of(study, labels.get(by, by))
        parts = {fold.left.tobytes() for fold in folds}
        if len(folds) > 1 and parts not in seen:
            seen.append(parts)
            found[by] = tuple(folds)
    return found


def places(study: Study, fold: Fold) -> Level:
    """Places of the rows of a level among those in the fit."""
    return tuple(np.flatnonzero(fold.left[study.observations.use]).tolist())


def parts_of(study: Study, leaving: Mapping[str, tuple[Fold, ...]]) -> dict[str, IntArray]:
    """Number of the level of every row in the fit, by way; slips aside."""
    used = study.observations.use
    return {by: np.argmax([fold.left[used] for fold in folds], axis=0) for by, folds in leaving.items() if by != "slip"}


def rests(study: Study, leaving: Mapping[str, tuple[Fold, ...]]) -> dict[Level, Likelihood]:
    """The likelihood of all other rows, by level."""
    rows, folds = study.observations, [fold for each in leaving.values() for fold in each]
    return {places(study, f): likelihood_of(study, rows.take(rows.use & ~f.left)) for f in folds}


def predicted(
    study: Study,
    posterior: Whole,
    leaving: Mapping[str, tuple[Fold, ...]],
    without: Mapping[Level, Without],
    rng: Generator,
) -> list[dict[str, Any]]:
    """Rows of the table of :class:`bayesterra.checking.holdout.Holdout`, with ``by`` and ``reliable``."""
    records, used = list[dict[str, Any]](), np.flatnonzero(study.observations.use)
    scored = np.zeros(len(study.observations), dtype=np.bool_)
    scored[used[:: -(-len(used) // ROWS)]] = True
    for by, folds in leaving.items():
        for fold in folds:
            found, scorer = without[places(study, fold)], Scorer(study, fold, scored)
            own, _ = scorer.predicted(posterior, spaced(found.x, DRAWS), rng, banded=False)
            extra = {"by": by, "reliable": found.reliable}
            records += [{**extra, **row} for row in (*own, *scorer.baseline(CURVE, folds))]
    return records


@dataclass(frozen=True)
class Count:
    """Readings of one channel in levels of one kind that the fit had not seen."""

    by: str  # kind of level
    channel: str
    readings: int  # their number
    inside: int  # how many lie in their 90 % intervals
    levels: int  # number of levels
    few: float  # probability that so few of the levels are inside
    many: float  # probability that so many are
    crps: float  # mean score of the model, in the field unit
    curve: float  # that of a polynomial over slip
    worse: bool  # True where the polynomial's is surely the better one


def counts(records: Sequence[Mapping[str, Any]], model: str) -> tuple[Count, ...]:
    """Counts of all channels, in the order of the records."""
    table, found = pd.DataFrame(records), []
    for by in table["by"].unique() if len(table) else ():
        own = table[table["by"] == by]
        against = skills(own, model)
        for channel, rows in own[own["predictor"] == model].groupby("channel", sort=False):
            shares = rows.groupby("level")["covered90"].mean()
            n, inside = len(shares), float(shares.sum())
            beside = against[(against["channel"] == channel) & (against["part"] == "all")].to_dict("records")
            curve = own[(own["predictor"] == CURVE) & (own["channel"] == channel)]["crps"].mean()
            found.append(
                Count(
                    by, str(channel), len(rows), int(rows["covered90"].sum()), n,
                    float(binom.cdf(np.floor(inside + 1e-9), n, COVERED)),
                    float(binom.sf(np.ceil(inside - 1e-9) - 1, n, COVERED)),
                    float(rows["crps"].mean()), float(curve),
                    any(row["difference"] > WORSE * row["difference_se"] for row in beside),
                )
            )  # fmt: skip
    return tuple(found)


def scope(study: Study) -> str:
    """Wheels, slips and loads of the rows in the fit, and soil tests, in words."""
    tests = [f"{len(test.readings.tests)} {test.kind} tests" for test in study.soil_tests.values()]
    return enumerated([*([_driven(study)] if study.wheels else []), *tests])


def _read(study: Study) -> Study:
    """The study with the rows in the fit that have a reading."""
    rows = study.observations
    read = [~np.isnan(rows.values[name]) for name in study.noise]
    return study.with_use(rows.use & np.any(read, axis=0)) if read else study


def _driven(study: Study) -> str:
    rows = _read(study).observations.used()
    wheels = list(dict.fromkeys(rows.wheel))
    text = f"wheel{'s' if len(wheels) > 1 else ''} {enumerated(wheels)} at {_range('slip', rows.slip, '')}"
    loads = rows.carried[~np.isnan(rows.carried)]
    return f"{text} under {_range('', loads, ' N')}" if len(loads) else text


def _range(name: str, values: FloatArray, unit: str) -> str:
    low, high = f"{values.min():.3g}", f"{values.max():.3g}"
    plural = "" if low == high or not name else "s"
    return f"{name}{plural} {low}{f' to {high}' if low != high else ''}{unit}".strip()


def untested(study: Study) -> list[str]:
    """A clause on what readings of one level only cannot test."""
    if not study.wheels:
        return ["wheels were not tested"]
    ones = [by for by in ("slip", "load", "wheel") if len(folds_of(_read(study), by)) < 2]
    return [f"other {enumerated([f'{by}s' for by in ones])} were not tested"] if ones else []
