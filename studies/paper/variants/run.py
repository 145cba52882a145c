"""Constant exponent, R_j = r and R_j = R beside Tables 11 to 13 and Fig. 16, and what the load drive says.

Run it with ``python studies/paper/variants/run.py``; it rewrites the CSV and PNG files of this folder and the
tables in its README. With one of the names ``fits``, ``posteriors`` and ``page`` it does that part.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import pandas as pd

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parents[1] / "support")]

import paper_statements  # noqa: E402
import var_figures as figures  # noqa: E402
import var_fits as fits  # noqa: E402
import var_loads as loads  # noqa: E402
import var_page as page  # noqa: E402
import var_posteriors as posteriors  # noqa: E402
import var_statements as statements  # noqa: E402
from readme import filled  # noqa: E402

FITS: dict[str, Callable[[], pd.DataFrame]] = {
    "table-11": fits.table_11,
    "tables-12-13": fits.tables_12_13,
    "load-fits": fits.load_fits,
    "normal-force": loads.normal_force_over_depth,
    "below-zero": loads.below_zero,
    "solver-11-13": fits.by_the_papers_solver,
}
POSTERIORS: dict[str, Callable[[], pd.DataFrame]] = {"comparison": posteriors.comparison}


def stored() -> dict[str, pd.DataFrame]:
    """The result files of this folder by name."""
    return {name: pd.read_csv(HERE / f"{name}.csv") for name in (*FITS, *POSTERIORS)}


def write(made: dict[str, Callable[[], pd.DataFrame]]) -> None:
    """Make tables and write them."""
    for name, make in made.items():
        make().to_csv(HERE / f"{name}.csv", index=False, float_format="%.5g")


def write_page() -> None:
    """Statements, figure and the README, all from the stored tables."""
    kept = stored()
    found = paper_statements.write(statements.statements(kept), HERE)
    figures.normal_forces(kept["normal-force"]).savefig(HERE / "normal-force.png", dpi=144, facecolor="white")
    readme = HERE / "README.md"
    text = readme.read_text(encoding="utf-8")
    readme.write_text(filled(text, page.blocks(kept, found)), encoding="utf-8")
    print(found.to_string(columns=["table_or_figure", "statement", "verdict"]))


def main(parts: list[str]) -> None:
    """Remake the parts named, by default all."""
    for part in parts or ["fits", "posteriors", "page"]:
        {"fits": lambda: write(FITS), "posteriors": lambda: write(POSTERIORS), "page": write_page}[part]()


if __name__ == "__main__":
    main(sys.argv[1:])
