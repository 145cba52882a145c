"""What the paper says of conventional tests beside what the stored tables of this folder say."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pandas as pd

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "support"))

from paper_statements import Statement, table_of  # noqa: E402

COVERED = 0.9
SYMBOLS = {"kc": "k_c", "kphi": "k_φ", "n": "n"}


def statements() -> pd.DataFrame:
    """All statements, in the columns that every study shares."""
    table = table_of([*_printed_values(), _two_radii(), _one_radius(), _inserted_wheel()])
    return pd.concat([table, pd.DataFrame([_shear_test()], columns=table.columns)], ignore_index=True)


def _printed_values() -> Iterator[Statement]:
    """Each of Table 2's plate parameters beside what readings simulated from them leave."""
    for row in pd.read_csv(HERE / "table2.csv").head(3).to_dict("records"):
        unit = "" if row["unit"] == "-" else f" {row['unit']}"
        shift = (row["median"] - row["truth"]) / row["sd"]
        yield Statement(
            "Table 2",
            f"{SYMBOLS[row['parameter']]} by two plates of radii 35 and 50 mm, 20 to 300 N (readings "
            "simulated from the printed values; three tests of each and their scatter are assumed)",
            f"{row['truth']:g}{unit}",
            f"{_plain(row['median'])} ± {_plain(row['sd'])}{unit}, "
            f"90 % {_plain(row['hdi90_lo'])} to {_plain(row['hdi90_hi'])}",
            f"{shift:+.1f} sd",
            row["hdi90_lo"] <= row["truth"] <= row["hdi90_hi"],
        )


def _plain(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 10 else f"{value:.2f}"


def _two_radii() -> Statement:
    rows = _recovered(2)
    words = rows.groupby("parameter")["verdict"].value_counts()
    held = rows.groupby("parameter")["covered"].sum()
    n = rows["seed"].nunique()
    return Statement(
        "Section 3.2",
        "plates of two radii give k_c and k_φ (simulated tests; verdict, and 90 % intervals that hold them)",
        "both",
        f"determined in {words['kc', 'determined']} and {words['kphi', 'determined']} of {n}; "
        f"held in {held['kc']} and {held['kphi']}",
        "",
        bool(min(words["kc", "determined"], words["kphi", "determined"]) >= COVERED * n),
    )


def _one_radius() -> Statement:
    rows = _recovered(1)
    rows = rows[rows["parameter"].isin(["kc", "kphi"])]
    undetermined = int((rows["verdict"] == "structurally not determined").sum())
    return Statement(
        "Section 3.2",
        "plates of one radius do not, which is why two are taken (simulated tests)",
        "neither",
        f"structurally not determined in {undetermined} of {len(rows)} verdicts on k_c and k_φ; "
        "only k_c/b + k_φ is known",
        "",
        undetermined == len(rows),
    )


def _recovered(radii: int) -> pd.DataFrame:
    table = pd.read_csv(HERE / "recovery.csv")
    return table[table["radii"] == radii]


def _inserted_wheel() -> Statement:
    table = pd.read_csv(HERE / "insertion_summary.csv")
    inside, tests = table["levels_inside_90"], int(table["tests"].iloc[0])
    low, high = table["measured_over_predicted"].min(), table["measured_over_predicted"].max()
    return Statement(
        "CMU",
        "plates of a sand predict the force on a wheel pushed straight down into it (held-out check of this "
        "package; the paper has none): tests inside the 90 % of their prediction",
        f"{COVERED * tests:.0f} of {tests}",
        f"{inside.min()} to {inside.max()} of {tests}, by what b and the contact of a wheel are taken to be; "
        f"measured over predicted {low:.2f} to {high:.1f}",
        "",
        bool((inside >= COVERED * tests).all()),
        "Bekker's law does not say what b is for a wheel, nor whether the soil carries at the grousers' tips "
        "or at the rim, and two sources give two widths",
    )


def _shear_test() -> list[str]:
    rows = pd.read_csv(HERE / "posteriors.csv").query("file == 'cullinan'").set_index("parameter")
    return [
        "Section 3.2, Table 2",
        "the greatest moments of an annular plate under 30 to 180 N give c and φ",
        "0.25 kPa, 31.9°",
        f"readings were not published; the Cullinan tests have one normal stress: c and φ {rows.loc['c', 'verdict']}",
        "",
        "cannot be checked",
        "",
    ]
