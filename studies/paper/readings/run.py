"""Wh31's unpublished readings, had back from the printed errors of Tables 5 to 8, and the tests that follow.

Run it with ``python studies/paper/readings/run.py``; it rewrites the CSV and PNG files of this folder and the tables
in its README. With one of the names ``fits`` and ``page`` it does that part.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.random import SeedSequence, default_rng

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "support")]

import paper_statements  # noqa: E402
import recover  # noqa: E402
from paper_statements import Statement  # noqa: E402
from readme import filled, markdown, minus  # noqa: E402
from recover import NAMES, PRINTED, SECTION_4, Recovered, errors  # noqa: E402
from sensitivity.groups import GROUPS, soil_array  # noqa: E402
from sensitivity.responses import OUTCOMES, respond  # noqa: E402

from bayesterra.models import M1, SOIL_FIELDS  # noqa: E402

SETTINGS: dict[str, dict[str, object]] = {
    "slip on r_s, 80 N, K = 12 mm": {},
    "slip on r, amended to r_s": {"slips": recover.slips_on_r()},
    "K of G1 25 mm (Table 5)": {"K": 0.025},
    **{f"{load} N": {"load": float(load)} for load in (70, 78, 82, 90)},
}
"""What Section 4 leaves open; the first is what is used everywhere else."""
BASE = next(iter(SETTINGS))
PARTICLES = 6000
SYMBOLS = {"sinkage": "z, mm", "drawbar_pull": "F_DP, N", "resistance_moment": "M_DR, N m"}
TABLES = ("readings", "settings", "errors", "g17")


def fits() -> dict[str, pd.DataFrame]:
    """Every table."""
    rows: list[dict[str, object]] = []
    kept: dict[str, Recovered] = {}
    curve = recover.predictions()[0]
    streams = iter(SeedSequence(1).spawn(len(SETTINGS) * len(OUTCOMES)))
    for name, setting in SETTINGS.items():
        predicted = recover.predictions(**setting)  # type: ignore[arg-type]
        for i, channel in enumerate(OUTCOMES):
            found = recover.recover(
                predicted[..., i], PRINTED[:, i], curve[:, i], default_rng(next(streams)), particles=PARTICLES
            )
            kept.setdefault(channel, found)
            at = {"setting": name, "channel": channel, "misfit": found.misfit.min()}
            rows.append({**at, "b": np.median(found.scale), "log_z": found.log_z})
    return {"readings": _readings(kept), "settings": pd.DataFrame(rows), "errors": _errors(kept), "g17": _g17(kept)}


def _readings(kept: dict[str, Recovered]) -> pd.DataFrame:
    rows = []
    curve = recover.predictions()[0]
    for i, (channel, found) in enumerate(kept.items()):
        low, middle, high = np.quantile(found.readings, (0.05, 0.5, 0.95), axis=0)
        for j, slip in enumerate(SECTION_4.slips):
            values = {"best": found.best[j], "low": low[j], "median": middle[j], "high": high[j], "G1": curve[j, i]}
            width = 100 * (high[j] - low[j]) / np.abs(found.best).max()
            rows.append({"channel": channel, "slip": slip, **values, "width_percent": width})
    return pd.DataFrame(rows)


def _errors(kept: dict[str, Recovered]) -> pd.DataFrame:
    """Printed errors beside those of the best readings."""
    predicted = recover.predictions()
    rows = []
    for i, (channel, found) in enumerate(kept.items()):
        ours = errors(found.best[None], predicted[..., i])[0]
        rows += [
            {"group": name, "channel": channel, "printed": p, "ours": o}
            for name, p, o in zip(NAMES, PRINTED[:, i], ours, strict=True)
        ]
    return pd.DataFrame(rows)


def _g17(kept: dict[str, Recovered]) -> pd.DataFrame:
    """Probability of the c1 behind the three errors printed for G17, and those errors with the best readings."""
    values = np.arange(0.20, 0.601, 0.01)
    soils = np.repeat(soil_array([GROUPS["G17"]]), len(values), axis=0)
    soils[:, SOIL_FIELDS.index("c1")] = values
    predicted = respond(M1(), soils, SECTION_4).values * recover.UNITS
    printed = 100 * np.array(GROUPS["G17"].printed_errors)
    log_p = np.zeros(len(values))
    table: dict[str, object] = {"c1": values}
    for i, (channel, found) in enumerate(kept.items()):
        away = np.abs(errors(found.readings, predicted[..., i]) - printed[i]) / found.scale[:, None]
        log_p += np.log(np.mean(np.exp(-away) / found.scale[:, None], axis=0))
        table[channel] = errors(found.best[None], predicted[..., i])[0]
    p = np.exp(log_p - log_p.max())
    return pd.DataFrame({**table, "probability": p / p.sum()})


def stored() -> dict[str, pd.DataFrame]:
    """The result files of this folder by name."""
    return {name: pd.read_csv(HERE / f"{name}.csv") for name in TABLES}


def blocks(kept: dict[str, pd.DataFrame]) -> dict[str, str]:
    """The tables of the README."""
    rows = [
        [SYMBOLS[channel], *(f"{x['best']:.2f} ({x['low']:.2f} to {x['high']:.2f})" for x in some.to_dict("records"))]
        for channel, some in kept["readings"].groupby("channel", sort=False)
    ]
    slips = [f"s = {slip:g}" for slip in SECTION_4.slips]
    first = kept["settings"].set_index(["setting", "channel"])
    tests = []
    for name in kept["settings"]["setting"].unique():
        cells = [f"{first.loc[(name, c), 'misfit']:.2f}" for c in OUTCOMES]
        loss = sum(first.loc[(name, c), "log_z"] - first.loc[(BASE, c), "log_z"] for c in OUTCOMES)
        tests.append([name, *cells, f"{loss:+.0f}"])
    g17 = kept["g17"].set_index(kept["g17"]["c1"].round(2))
    printed = 100 * np.array(GROUPS["G17"].printed_errors)
    some = [
        [f"{c1:.1f}", *(f"{g17.loc[c1, c]:.2f}" for c in OUTCOMES), f"{g17.loc[c1, 'probability']:.1g}"]
        for c1 in (0.3, 0.4, 0.5)
    ]
    names = [SYMBOLS[c].split(",")[0] for c in OUTCOMES]
    return {
        "readings": minus(markdown(["", *slips], rows, "|rrrrrr")),
        "settings": minus(markdown(["setting", *names, "log evidence, all three"], tests, "|rrrr")),
        "g17": minus(
            markdown(
                ["c1", *names, "probability"], [["printed", *(f"{p:.2f}" for p in printed), ""], *some], "|rrrr"
            )
        ),
    }  # fmt: skip


def statements(kept: dict[str, pd.DataFrame]) -> list[Statement]:
    """Tables 6 to 8: errors of the readings that were had back, and what G17 must be."""
    errors_of = kept["errors"].assign(off=lambda x: (x["ours"] - x["printed"]).abs())
    errors_of["table"] = [GROUPS[name].table for name in errors_of["group"]]
    made = []
    for table in (6, 7, 8):
        some = errors_of.query("table == @table")
        made.append(
            Statement(
                f"Table {table}",
                f"{len(some)} errors of Table {table} (against six readings per channel had back from"
                " all tables; within 1.1 points, with mean misfits of 0.3)",
                span(some["printed"]) + " %",
                span(some["ours"]) + " %",
                f"mean {some['off'].mean():.2f}, at most {some['off'].max():.2f} points;"
                f" {(some['off'] < 0.1).sum()} within 0.1",
                bool(some["off"].max() < 1.1),
            )
        )
    g17 = kept["g17"]
    best, low, high = g17["c1"][g17["probability"].idxmax()], *_interval(g17)
    at = g17.set_index(g17["c1"].round(2))
    made.append(
        Statement(
            "Table 8",
            "G17 has c1 = 0.4 (c1 that its three errors tell)",
            "0.4; 10.34, 16.62, 3.88 %",
            f"{best:.2f}, 90 % {low:.2f} to {high:.2f}; with 0.3 "
            + ", ".join(f"{at.loc[0.3, c]:.2f}" for c in OUTCOMES)
            + ", with 0.4 "
            + ", ".join(f"{at.loc[0.4, c]:.2f}" for c in OUTCOMES)
            + " %",
            f"{best - 0.4:+.2f}",
            bool(low <= 0.4 <= high),
            "the errors are those of c1 = 0.3: a misprint",
        )
    )
    return made


def span(values: pd.Series) -> str:
    """Lowest and highest."""
    return f"{values.min():.1f} to {values.max():.1f}"


def _interval(table: pd.DataFrame) -> tuple[float, float]:
    """Central 90 % of c1."""
    below = np.cumsum(table["probability"].to_numpy())
    return float(table["c1"][int(np.argmax(below >= 0.05))]), float(table["c1"][int(np.argmax(below >= 0.95))])


def write_page() -> None:
    """Statements, figure and README from the stored tables."""
    from matplotlib.figure import Figure

    kept = stored()
    paper_statements.write(statements(kept), HERE)
    figure = Figure(figsize=(9, 3), layout="constrained")
    for axes, (channel, some) in zip(
        figure.subplots(1, 3), kept["readings"].groupby("channel", sort=False), strict=True
    ):
        axes.plot(some["slip"], some["G1"], color="0.5", label="G1 by M1")
        away = np.abs(some[["low", "high"]].to_numpy().T - some["best"].to_numpy())
        axes.errorbar(some["slip"], some["best"], away, fmt="o", color="#0072B2", capsize=3, label="had back, 90 %")
        axes.set(xlabel="slip", ylabel=SYMBOLS[str(channel)])
    axes.legend(frameon=False, fontsize="small")
    figure.savefig(HERE / "readings.png", dpi=144, facecolor="white")
    readme = HERE / "README.md"
    readme.write_text(filled(readme.read_text(encoding="utf-8"), blocks(kept)), encoding="utf-8")


def main(parts: list[str]) -> None:
    """Remake the parts named, by default all."""
    for part in parts or ["fits", "page"]:
        if part == "page":
            write_page()
            continue
        for name, table in fits().items():
            table.to_csv(HERE / f"{name}.csv", index=False, float_format="%.5g")


if __name__ == "__main__":
    main(sys.argv[1:])
