"""Scores by channel, with errors that know that rows of one level are not independent."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pandas as pd
from numpy.random import Generator, default_rng

from bayesterra.arrays import FloatArray, IntArray

PARTS = ("all", "inner", "end")
"""All rows; those at slips between the training rows' (interpolated); those beyond (extrapolated)."""
RESAMPLED = 4000
SCORES = ("crps", "log_score", "covered50", "covered90")


def clustered(values: FloatArray, level: IntArray) -> tuple[float, float]:
    """Mean of values (n,) and its standard error from the spread between levels (n,).

    √(G / (G − 1) Σ_g (Σ_{i in g} (v_i − v̄))²) / n with G levels (Liang and Zeger 1986); NaN with one level.
    """
    if not len(values):
        return float("nan"), float("nan")
    mean, n = float(values.mean()), len(values)
    names, of = np.unique(level, return_inverse=True)
    if len(names) < 2:
        return mean, float("nan")
    sums = np.bincount(of, weights=values - mean)
    return mean, float(np.sqrt(len(names) / (len(names) - 1) * (sums**2).sum()) / n)


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """Mean scores and coverages with standard errors, by predictor, channel and part.

    Rows without a predictive law have no score and count as not covered; ``unscored`` is their number.
    """
    found = []
    for predictor, channel, part, rows in _parts(table):
        record = {
            "predictor": predictor,
            "channel": channel,
            "unit": rows["unit"].iloc[0],
            "part": part,
            "rows": len(rows),
            "levels": rows["level"].nunique(),
            "unscored": int(rows["crps"].isna().sum()),
        }
        for score in SCORES:
            scored = rows[rows[score].notna()]
            level = pd.factorize(scored["level"])[0]
            record[score], record[f"{score}_se"] = clustered(scored[score].to_numpy(np.float64), level)
        found.append(record)
    return pd.DataFrame(found)


def _parts(table: pd.DataFrame) -> Iterator[tuple[str, str, str, pd.DataFrame]]:
    for predictor in table["predictor"].unique():
        for channel in table["channel"].unique():
            rows = table[(table["predictor"] == predictor) & (table["channel"] == channel)]
            for part in PARTS:
                chosen = rows if part == "all" else rows[rows["extrapolated"] == (part == "end")]
                if len(chosen):
                    yield predictor, channel, part, chosen


def skills(table: pd.DataFrame, model: str, seed: int = 1) -> pd.DataFrame:
    """How much smaller the model's mean CRPS is than a baseline's: 1 − CRPS / CRPS(baseline).

    Only rows that both have a law for. ``skill_lo``, ``skill_hi``: central 90 % when levels are drawn again
    with replacement, which needs two levels or more; ``difference`` of the mean CRPS with its standard error
    by level, negative where the model is better. ``levels_won``: levels in which the model's is the smaller.
    """
    found = []
    keys = ["row", "channel"]
    own = table[table["predictor"] == model].set_index(keys)
    for baseline in (name for name in table["predictor"].unique() if name != model):
        other = table[table["predictor"] == baseline].set_index(keys)["crps"].rename("other")
        pairs = own.join(other).dropna(subset=["crps", "other"]).reset_index()
        for channel in pairs["channel"].unique():
            for part in PARTS:
                rows = pairs[pairs["channel"] == channel]
                rows = rows if part == "all" else rows[rows["extrapolated"] == (part == "end")]
                if len(rows):
                    head = {"model": model, "baseline": baseline, "channel": channel, "part": part}
                    found.append({**head, **_skill(rows, default_rng(seed))})
    return pd.DataFrame(found)


def _skill(rows: pd.DataFrame, rng: Generator) -> dict[str, float]:
    level = pd.factorize(rows["level"])[0]
    ours, other = (rows[name].to_numpy(np.float64) for name in ("crps", "other"))
    sums = np.array([np.bincount(level, weights=values) for values in (ours, other)])
    groups = sums.shape[1]
    difference, error = clustered(ours - other, level)
    low = high = float("nan")
    if groups > 1:
        chosen = rng.integers(groups, size=(RESAMPLED, groups))
        resampled = sums[:, chosen].sum(axis=2)
        low, high = np.quantile(1 - resampled[0] / resampled[1], [0.05, 0.95])
    return {
        "rows": len(rows),
        "levels": groups,
        "skill": float(1 - ours.sum() / other.sum()),
        "skill_lo": float(low),
        "skill_hi": float(high),
        "difference": difference,
        "difference_se": error,
        "levels_won": int((sums[0] < sums[1]).sum()),
    }
