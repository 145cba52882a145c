"""Section 4 of Ding et al. (2015) recomputed: tables, statements about figures, Sobol indices.

Run it with ``python studies/paper/sensitivity/run.py``; it takes about a minute and rewrites the CSV and PNG
files of this folder and the tables in its README.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parents[1] / "support")]

import section4_angles as angles  # noqa: E402
import section4_figures as figures  # noqa: E402
import section4_forces as forces  # noqa: E402
import section4_page as page  # noqa: E402
import section4_soils as soils  # noqa: E402
import section4_tables as tables  # noqa: E402
from readme import filled  # noqa: E402

CHECKS = (
    forces.shares_of_normal_force,
    forces.shear_below_normal,
    forces.table_4_values,
    forces.resistance_below_thrust,
    forces.shapes_over_slip,
    forces.what_moves_the_parts,
    forces.moduli,
    soils.deformation_modulus,
    soils.error_tables,
    soils.bearing_errors,
    soils.bearing_directions,
    soils.two_bearing_parameters,
    soils.shearing_errors,
    soils.shearing_directions,
    angles.contact_errors,
    angles.given_load,
    angles.sign_of_c3,
    angles.given_sinkage,
    angles.two_contact_parameters,
    angles.words_of_table_9,
)
DRAWS = 32_768
"""Base draws of the stored Sobol indices."""


def index() -> pd.DataFrame:
    """Every statement: place, statement, reading, ours, verdict."""
    rows = [each for check in CHECKS for each in check()]
    columns = ["place", "statement", "reading", "ours"]
    table = pd.DataFrame([[getattr(row, name) for name in columns] for row in rows], columns=columns)
    return table.assign(verdict=[tables.verdict(row.holds) for row in rows])


def quick() -> dict[str, pd.DataFrame]:
    """What takes seconds: every table but the Sobol indices, by the name of its file."""
    return {
        "index": index(),
        "table-4": tables.table_4(),
        "tables-6-8": tables.tables_6_to_8(),
        "implied-sinkage": tables.implied_sinkage(),
        "c1-of-g17": tables.c1_of_g17(),
        "table-9": tables.table_9(),
    }


def main() -> None:
    """Write tables, figures and the README's tables."""
    found = quick()
    found["sobol"] = pd.concat([tables.sobol_table(box, DRAWS) for box in tables.BOXES])
    for name, table in found.items():
        table.to_csv(HERE / f"{name}.csv", index=False, float_format="%.4g")
    stored = {name: pd.read_csv(HERE / f"{name}.csv", keep_default_na=name == "sobol") for name in found}
    figures.errors(stored["tables-6-8"]).savefig(HERE / "errors.png", dpi=144, facecolor="white")
    figures.indices(stored["table-9"], stored["sobol"]).savefig(HERE / "table-9.png", dpi=144, facecolor="white")
    readme = HERE / "README.md"
    readme.write_text(filled(readme.read_text(encoding="utf-8"), page.blocks(stored)), encoding="utf-8")
    print(found["index"].to_string(columns=["place", "statement", "verdict"]))


if __name__ == "__main__":
    main()
