"""The tables of the README, made from the stored files."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd
from im_statements import span, stops_of
from paper_data import NAMES, printed
from paper_statements import statement_rows
from readme import markdown, minus

Kept = Mapping[str, pd.DataFrame]
UNITS = {"Ks": "K_s, kPa/m^N", "n0": "n0", "n1": "n1", "c": "c, kPa", "phi": "φ, deg", "K": "K, mm",
         "c1": "c1", "c2": "c2"}  # fmt: skip
FREE = NAMES[1:]
MODELS = ("M1", "M2", "M3")


def blocks(kept: Kept, found: pd.DataFrame) -> dict[str, str]:
    """Every table by the name of its comment."""
    tables = {
        "statements": statement_rows(found),
        "delta": delta(kept),
        "beside": beside(kept),
        "standings": standings(kept),
        "model-errors": model_errors(kept),
        "comparison": comparison(kept),
    }
    return {name: minus(block) for name, block in tables.items()}


def delta(kept: Kept) -> str:
    """Passes and cohesion by tolerance."""
    stops = stops_of(kept)
    rows = []
    for value, some in stops.groupby("delta", sort=False):
        clean = some[some["data"] != "HIT"].set_index("data")
        true = {wheel: fits_true(wheel) for wheel in clean.index}
        away = [100 * (clean.loc[w, "c"] / true[w]["c"] - 1) for w in clean.index]
        phi = [clean.loc[w, "phi"] - true[w]["phi"] for w in clean.index]
        own = some[some["data"] == "HIT"].iloc[0]
        rows.append(
            [
                f"{value:g}", span(clean["passes"]), span(away, 2), span(phi, 2),
                f"{own['passes']:.0f}", f"{own['c']:.3f}", f"{own['phi']:.2f}",
            ]
        )  # fmt: skip
    head = ["δ", "passes", "c off, %", "φ off, deg", "HIT: passes", "c, kPa", "φ, deg"]
    return markdown(head, rows, "rrrrrrr")


def fits_true(wheel: str) -> dict[str, float]:
    """Values of Table 10."""
    return {str(name): float(value) for name, value in printed(10).loc[wheel].items()}


def beside(kept: Kept) -> str:
    """HIT and simulated Wh32: point estimates and posteriors of M1, both drives, K_s held."""
    rows = []
    for data, kind in (("HIT", "digitised"), ("Wh32", "simulated, noise")):
        some, spread = (_of(kept[name], data=data, kind=kind, Ks_held=True) for name in ("posteriors", "spreads"))
        for name in FREE:
            at = [
                _of(some, model=model, drive=drive, parameter=name).iloc[0]
                for model, drive in (*((model, "load") for model in MODELS), ("M1", "sinkage"))
            ]
            load = _of(spread, model="M1", drive="load", parameter=name).iloc[0]
            cells = [f"{row['median']:.3g} ± {row['sd']:.2g}" for row in at]
            rows.append([data, UNITS[name], *cells, f"{load['range_in_sd']:.1f}", f"{load['inside']:.0f} of 3"])
    head = ["readings", "", "M1, load", "M2, load", "M3, load", "M1, sinkage", "IM1 to IM3, sd", "inside"]
    return markdown(head, rows, "||rrrrrr")


def _of(table: pd.DataFrame, **values: object) -> pd.DataFrame:
    """The rows of a table that have these values."""
    chosen = pd.concat([table[name] == value for name, value in values.items()], axis=1).all(axis=1)
    return table[chosen]


def standings(kept: Kept) -> str:
    """Share of draws denser than each point estimate."""
    table = kept["standings"]
    keys = ["data", "drive", "Ks_held", "model"]
    rows = []
    for (data, drive, hold, model), some in table.groupby(keys, sort=False):
        at = some.set_index("method")
        cells = [_level(at.loc[name]) for name in ("IM1", "IM2", "IM3", "Table 10", "Table 14")]
        kind = "digitised" if data == "HIT" else "simulated"
        rows.append([f"{data}, {kind}", str(drive), "held" if hold else "free", str(model), *cells])
    head = ["readings", "drive", "K_s", "model", "IM1", "IM2", "IM3", "Table 10", "Table 14"]
    return markdown(head, rows, "||||rrrrr")


def _level(row: pd.Series) -> str:
    """Share of draws denser, percent, and how many parameters lie in their 90 %."""
    if isinstance(row["reason"], str) and row["reason"]:
        return "outside the prior"
    level = 100 * row["credible_level"]
    shown = "> 99.9" if level > 99.9 else f"{level:.1f}" if level > 99 else f"{level:.0f}"
    return f"{shown} ({row['inside']:.0f}/{row['of']:.0f})"


def model_errors(kept: Kept) -> str:
    """Shifts of mode and mean, by model."""
    rows = []
    keys = ["data", "Ks_held", "model"]
    for (wheel, hold, model), some in kept["model-errors"].groupby(keys, sort=False):
        at = some.set_index("parameter")
        names = [name for name in NAMES if name in at.index]
        cells = [f"{at.loc[n, 'mode']:+.1f} / {at.loc[n, 'mean']:+.1f}" if n in names else "held" for n in NAMES]
        worst = at[[f"misfit_{n}" for n in ("sinkage", "drawbar_pull", "resistance_moment")]].iloc[0].max()
        rows.append(
            [str(wheel), "held" if hold else "free", str(model), *cells, f"{worst:.2f}",
             f"{100 * at['truth_level'].iloc[0]:.1f}"]
        )  # fmt: skip
    head = ["wheel", "K_s", "model", *(n.replace("Ks", "K_s").replace("phi", "φ") for n in NAMES), "misfit", "truth"]
    return markdown(head, rows, "|||" + "r" * 10)


def comparison(kept: Kept) -> str:
    """Evidence and leave-one-out, differences to M1."""
    rows = [
        [
            f"{row['data']}, {row['kind'].split(',')[0]}", "held" if row["Ks_held"] else "free", row["model"],
            f"{row['log_z']:.2f} ± {row['log_z_error']:.2f}", f"{row['log_z_less_M1']:+.2f}",
            f"{row['elpd']:.1f} ± {row['elpd_se']:.1f}",
            f"{row['elpd_less_M1']:+.1f} ± {row['difference_se']:.1f}",
            "yes" if row["distinguishable"] else "no",
        ]
        for row in kept["comparison"].to_dict("records")
    ]  # fmt: skip
    head = ["readings", "K_s", "model", "log evidence", "less M1", "elpd", "less M1", "told apart"]
    return markdown(head, rows, "|||rrrr|")
