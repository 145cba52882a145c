"""Whether intervals for left-out slips hold what they promise: statements for the index of the paper."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pandas as pd

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from paper_statements import Statement, table_of  # noqa: E402

LEVEL = 0.9
STANDARD_ERRORS = 2.0
"""A coverage counts as the promised one within so many of its standard errors, or where it is higher."""
CHANNELS = {"sinkage": "sinkage", "drawbar_pull": "drawbar pull"}
GEOMETRIES = {"cmu-grouser": "narrower geometry", "cmu-grouser-wide": "wider geometry"}


def statements() -> pd.DataFrame:
    """Coverage and skill of M1 on the CMU set, in the columns that every study shares."""
    return table_of(list(_found()))


def _found() -> Iterator[Statement]:
    summary, skills = (pd.read_csv(HERE / f"{name}.csv") for name in ("summary", "skills"))
    for study, geometry in GEOMETRIES.items():
        for channel, words in CHANNELS.items():
            rows = summary[(summary["study"] == study) & (summary["channel"] == channel)]
            yield _covered(rows[rows["part"] == "all"].set_index("predictor"), f"{words}, {geometry}")
            better = skills[(skills["study"] == study) & (skills["channel"] == channel)]
            yield _better(better[better["part"] == "all"], f"{words}, {geometry}")


def _covered(rows: pd.DataFrame, what: str) -> Statement:
    model, baseline = rows.loc["M1"], rows.loc["polynomial"]
    n, share, error = int(model["rows"]), model["covered90"], model["covered90_se"]
    holds = bool(share >= LEVEL - STANDARD_ERRORS * error)
    why = (
        "the error of the model is taken for information on the soil; wheels this deep are no longer steady "
        "above slip 0.5"
    )
    return Statement(
        "CMU",
        f"M1 without a slip level predicts it (own check, {what}): left-out readings in the 90 % interval",
        f"{100 * LEVEL:.0f} %",
        f"{share * n:.0f} of {n} (polynomial {baseline['covered90'] * n:.0f}); mean CRPS {model['crps']:.2f} "
        f"{model['unit']} (polynomial {baseline['crps']:.2f})",
        f"{100 * (share - LEVEL):+.0f} ± {100 * error:.0f} points",
        holds,
        "" if holds else why,
    )


def _better(rows: pd.DataFrame, what: str) -> Statement:
    found = rows[(rows["model"] == "M1") & (rows["baseline"] == "polynomial")].iloc[0]
    holds = bool(found["skill_lo"] > 0)
    why = "six levels cannot tell, or there is nothing to gain: a smooth curve of six levels is easily drawn"
    return Statement(
        "CMU",
        f"M1 predicts a left-out slip level better than a polynomial does (own check, {what})",
        "skill above 0",
        f"{100 * found['skill']:.0f} % (90 % {100 * found['skill_lo']:.0f} to {100 * found['skill_hi']:.0f})",
        "",
        holds,
        "" if holds else why,
    )
