"""A four-wheeled rover by statics: Table 16's parameters, and the posterior of one measured wheel.

Run it with ``python studies/rover/run.py`` (all), ``... printed`` or ``... posterior``; it rewrites the files
of this folder and the tables in its README. A few minutes, most for the posterior of ``studies/hit-wh32``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

import bayesterra as bt
from bayesterra.prediction.page import rover_outlook
from bayesterra.report.figures import white_png

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE), str(HERE.parent / "support")]

from readme import filled  # noqa: E402
from rover_drives import MODELS, drive, el_dorado, geometry_table, others, printed_table  # noqa: E402
from rover_page import blocks, figure  # noqa: E402
from rover_statements import statements  # noqa: E402

ASKED_SLOPES = ("0 deg", "3 deg", "6 deg", "9 deg", "12 deg", "15 deg", "18 deg")
ASKED_TOWS = ("0 N", "35 N", "70 N")


def make_printed() -> None:
    """Everything that rests on Table 16."""
    rover = el_dorado()
    rovers = others(rover)
    drives = [drive(rover, model, row) for row in ("slope", "flat") for model in MODELS]
    write("printed-parameters", printed_table(drives))
    write("assumed-rovers", geometry_table([rover, *rovers]))
    write("statements", statements(rover, rovers))
    (HERE / "printed-parameters.png").write_bytes(figure(rover, rovers))


def make_posterior() -> None:
    """The posterior of wheel Wh32 pushed through a small rover."""
    result = bt.run(bt.load_study(HERE.parent / "hit-wh32"), seed=1)
    sheet = bt.predict_rover(result, HERE / "small-rover.toml", slopes=ASKED_SLOPES, tows=ASKED_TOWS)
    write("parameters", result.summary[["parameter", "unit", "median", "hdi90_lo", "hdi90_hi"]])
    write("bands", sheet.table)
    write("greatest", sheet.greatest_table)
    write("climb", sheet.climb_table)
    (HERE / "notes.txt").write_text("\n".join(sheet.notes) + "\n", encoding="utf-8")
    (HERE / "posterior.png").write_bytes(white_png(rover_outlook(sheet), 130))


def write(name: str, table: pd.DataFrame) -> None:
    """A table of this folder, five digits."""
    table.to_csv(HERE / f"{name}.csv", index=False, float_format="%.5g")


PARTS = {"printed": make_printed, "posterior": make_posterior}


def main(names: list[str]) -> None:
    """Make the parts named, or all, and fill the README."""
    for name in names or list(PARTS):
        PARTS[name]()
    readme = HERE / "README.md"
    text = readme.read_text(encoding="utf-8")
    readme.write_text(filled(text, blocks(HERE)), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
