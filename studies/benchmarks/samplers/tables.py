"""The README's tables and headline, made from the stored figures."""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from readme import markdown  # noqa: E402

DRIVES = ("load", "sinkage")
CLAIMS = {
    "emcee's default move in raw parameters": 500.0,
    "the best right peer in raw parameters": 1000.0,
    "the best right peer in our coordinates": 20.0,
}
"""What ours is held against, and the ratio that was aimed at."""


def results() -> pd.DataFrame:
    """All stored rows, both drives."""
    return pd.concat([pd.read_csv(HERE / f"results-{drive}.csv") for drive in DRIVES], ignore_index=True)


def cut(table: pd.DataFrame) -> pd.Series:
    """Whether each row's sampler was stopped far from its end: of its draws nothing is said."""
    return table["note"].fillna("").str.startswith("cut")


def ratios(table: pd.DataFrame, drive: str) -> dict[str, tuple[str, float]]:
    """For every claim, the peer and how many times its effective draws per second ours (mean) makes."""
    rows = table[table["drive"] == drive]
    ours = rows[rows["sampler"] == "bayesterra"]["per_second"].mean()
    peers = rows[(rows["sampler"] != "bayesterra") & ~cut(rows)]
    always = peers.groupby(["sampler", "space"])["right"].transform("all").astype(bool)
    right = peers[always]  # with every seed
    chosen = {
        "emcee's default move in raw parameters": peers[(peers["sampler"] == "emcee") & (peers["space"] == "raw")],
        "the best right peer in raw parameters": right[right["space"] == "raw"],
        "the best right peer in our coordinates": right[right["space"] == "ours"],
    }
    found = {}
    for claim, some in chosen.items():
        if some.empty:
            found[claim] = ("none was right", float("nan"))
            continue
        best = some.loc[some["per_second"].idxmax()]
        found[claim] = (str(best["sampler"]), float(ours / best["per_second"]))
    return found


def headline(table: pd.DataFrame) -> str:
    """The ratios as a table."""
    lines = ["| ours against | aimed at | " + " | ".join(f"`{drive}`" for drive in DRIVES) + " |"]
    lines.append("|---|---:|" + "---:|" * len(DRIVES))
    found = {drive: ratios(table, drive) for drive in DRIVES}
    for claim, aim in CLAIMS.items():
        cells = []
        for drive in DRIVES:
            peer, ratio = found[drive][claim]
            cells.append(peer if ratio != ratio else f"{ratio:.3g} ({peer})")
        lines.append(f"| {claim} | {aim:g} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def every_row(table: pd.DataFrame) -> str:
    """All samplers as a table."""
    lines = [
        "| drive | sampler | parameters | CPU s | bulk | tail | per second | R-hat | worst of 32 | right |",
        "|---|---|---|---:|---:|---:|---:|---:|---:|---|",
    ]
    for row in table.fillna({"note": ""}).itertuples():
        cells = [row.drive, row.sampler, row.space]
        if pd.isna(row.per_second):
            cells += ["", "", "", "", "", "", f"no: {row.note}"]
        else:
            cells += [f"{row.cpu_seconds:.0f}", f"{row.ess_bulk:.0f}", f"{row.ess_tail:.0f}"]
            cells += [f"{row.per_second:.3g}", "" if pd.isna(row.r_hat) else f"{row.r_hat:.3f}"]
            right = "cut" if row.note.startswith("cut") else "yes" if row.right else "no"
            cells += [f"{row.worst_error:.1f}", right]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    return "\n".join(lines)


def plain(name: str) -> str:
    """A stored table as it is."""
    table = pd.read_csv(HERE / name)
    header = [column.replace("_", " ") for column in table]
    return markdown(header, table.itertuples(index=False))


def main() -> None:
    """Print all tables of the README."""
    table = results()
    print(headline(table), every_row(table), plain("cost.csv"), plain("divide.csv"), sep="\n\n")


if __name__ == "__main__":
    main()
