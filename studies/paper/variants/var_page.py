"""The tables of the README, made from the stored files."""

from __future__ import annotations

from collections.abc import Mapping

import pandas as pd
from paper_statements import statement_rows
from readme import markdown, minus

Kept = Mapping[str, pd.DataFrame]
SYMBOLS = {"c": "c, kPa", "phi": "φ, deg", "K": "K, mm", "error": "error of M_DR, %"}


def blocks(kept: Kept, found: pd.DataFrame) -> dict[str, str]:
    """Every table by the name of its comment."""
    tables = {
        "statements": statement_rows(found),
        "table-11": table_11(kept),
        "tables-12-13": tables_12_13(kept),
        "load": load(kept),
        "comparison": comparison(kept),
    }
    return {name: minus(block) for name, block in tables.items()}


def table_11(kept: Kept) -> str:
    """Constant exponent: printed, ours, errors."""
    rows = [
        [
            row["data"], f"{row['printed_Ks']:.2f}", f"{row['Ks']:.2f}", f"{row['printed_n']:.3f}",
            f"{row['n']:.3f}", f"{row['n'] - row['printed_n']:+.3f}", f"{row['error']:.2f}",
            f"{row['error_bounded']:.0f}", f"{row['error_with_slip']:.2f}",
        ]
        for row in kept["table-11"].to_dict("records")
    ]  # fmt: skip
    head = [
        "readings",
        "K_s printed",
        "ours",
        "n printed",
        "ours",
        "difference",
        "error, n free, %",
        "n ≥ 0, %",
        "(5), %",
    ]
    return markdown(head, rows, "|rrrrrrrr")


def tables_12_13(kept: Kept) -> str:
    """R_j = r and R_j = R: printed / ours (difference)."""
    rows = []
    for (number, data), some in kept["tables-12-13"].groupby(["table", "data"], sort=False):
        at = some.set_index("quantity")
        cells = [
            f"{at.loc[n, 'printed']:.4g} / {at.loc[n, 'ours']:.3g} ({at.loc[n, 'ours'] - at.loc[n, 'printed']:+.2g})"
            for n in SYMBOLS
        ]
        last = at.iloc[0]
        rows.append(
            [str(number), str(data), *cells,
             f"{last['error_of_printed']:.1f}", f"{last['error_of_reference']:.2f}"]
        )  # fmt: skip
    head = ["table", "readings", *SYMBOLS.values(), "printed values on ours, %", "with (13), %"]
    return markdown(head, rows, "||rrrrrr")


def load(kept: Kept) -> str:
    """Load-driven fits of every variant."""
    rows = []
    for (data, variant), some in kept["load-fits"].groupby(["data", "variant"], sort=False):
        at = some.set_index("model")
        cells = [
            " / ".join(f"{at.loc[m, f'error_{n}']:.1f}" for n in ("sinkage", "drawbar_pull", "resistance_moment"))
            + f", χ² {at.loc[m, 'chi2']:.1f}"
            for m in ("M1", "M2")
        ]
        rows.append([str(data), str(variant), *cells])
    return markdown(["readings", "variant", "M1: z / F_DP / M_DR, %", "M2"], rows)


def comparison(kept: Kept) -> str:
    """Evidence and leave-one-out, differences to the paper's model."""
    rows = [
        [
            f"{row['data']}, {row['kind'].split(',')[0]}", row["model"], row["variant"],
            f"{row['log_z']:.2f} ±"
            f" {row['log_z_error']:.2f}", f"{row['log_z_less']:+.2f}", f"{row['elpd']:.1f}",
            f"{row['elpd_less']:+.1f} ±"
            f" {row['difference_se']:.1f}", "yes" if row["distinguishable"] else "no",
        ]
        for row in kept["comparison"].to_dict("records")
    ]  # fmt: skip
    head = ["readings", "model", "variant", "log evidence", "less (5), (13)", "elpd", "less (5), (13)", "told apart"]
    return markdown(head, rows, "|||rrrr|")
