"""IM1, IM2 and IM3 beside the paper and beside posteriors: Tables 10, 14, 15 and Figs. 12, 17, 18.

Run it with ``python studies/paper/identification/run.py``; it rewrites the CSV and PNG files of this folder
and the tables in its README. With one of the names ``fits``, ``solver``, ``posteriors`` and ``page`` it does that part.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import pandas as pd

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent), str(HERE.parents[1] / "support")]

import im_figures as figures  # noqa: E402
import im_fits as fits  # noqa: E402
import im_page as page  # noqa: E402
import im_posteriors as posteriors  # noqa: E402
import im_solver as solver  # noqa: E402
import im_statements as statements  # noqa: E402
import paper_statements  # noqa: E402
from readme import filled  # noqa: E402
from start_figure import start_figure  # noqa: E402

FITS: dict[str, Callable[[], pd.DataFrame]] = {
    "fits": fits.fits,
    "scatter": fits.scatter,
    "paths": fits.paths,
    "times": fits.times,
    "predictions": fits.predictions,
    "angles-held": fits.angles_held,
    "without-shear": fits.without_shear,
    "printed-judged": fits.printed_judged,
}
SOLVER: dict[str, Callable[[], pd.DataFrame]] = {
    "solver-fits": solver.fits,
    "solver-paths": solver.paths,
    "solver-starts": solver.starts,
    "solver-truths": solver.truths,
    "solver-angles-held": solver.angles_held,
    "solver-without-shear": solver.without_shear,
    "solver-scatter": solver.scatter,
}


def stored() -> dict[str, pd.DataFrame]:
    """The result files of this folder by name."""
    return {name: pd.read_csv(HERE / f"{name}.csv") for name in (*FITS, *SOLVER, *posteriors.TABLES)}


def write(made: Iterable[tuple[str, pd.DataFrame]]) -> None:
    """Write tables as they are made."""
    for name, table in made:
        table.to_csv(
            HERE / f"{name}.csv",
            index=False,
            float_format="%.9g" if "paths" in name or name == "solver-fits" else "%.5g",
        )


def write_page() -> None:
    """Statements, figures and the README, all from the stored tables."""
    kept = stored()
    found = paper_statements.write(statements.statements(kept), HERE)
    figures.convergence(kept["paths"]).savefig(HERE / "convergence.png", dpi=144, facecolor="white")
    figures.beside(kept["posteriors"], kept["fits"]).savefig(HERE / "beside.png", dpi=144, facecolor="white")
    start = start_figure(kept["solver-starts"], kept["posteriors"], 0.103)
    start.savefig(HERE / "start.png", dpi=144, facecolor="white")
    readme = HERE / "README.md"
    text = readme.read_text(encoding="utf-8")
    readme.write_text(filled(text, page.blocks(kept, found)), encoding="utf-8")
    print(found.to_string(columns=["table_or_figure", "statement", "verdict"]))


def main(parts: list[str]) -> None:
    """Remake the parts named, by default all."""
    for part in parts or ["fits", "solver", "posteriors", "page"]:
        {
            "fits": lambda: write((name, make()) for name, make in FITS.items()),
            "solver": lambda: write((name, make()) for name, make in SOLVER.items()),
            "posteriors": lambda: write(posteriors.answers().items()),
            "page": write_page,
        }[part]()


if __name__ == "__main__":
    main(sys.argv[1:])
