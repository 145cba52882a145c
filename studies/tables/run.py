"""One table in many forms: what `bayesterra check` says of each, and whether the same numbers come out.

Usage: python run.py. Writes forms.csv and the table of the README beside this file.
"""

from __future__ import annotations

import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd

import bayesterra as bt
from bayesterra.errors import StudyError
from bayesterra.study.observations import Observations

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "support"))

from readme import filled, markdown  # noqa: E402
from table_forms import HEADER, ROWS, TableForm, table_forms  # noqa: E402

STUDY = """title = "One table in many forms"
[data]
file = "{file}"
{data}slip_reference = "shearing"
[wheels.Wh32]
radius = "157.35 mm"
width = "165 mm"
lug_height = "10 mm"
lug_count = 30
shearing_radius_coefficient = 0.65
[noise]
sinkage = "1 mm"
drawbar_pull = "1.5 N"
resistance_moment = "0.3 N m"
[priors]
set = "paper-box"
"""


def study_of(form: TableForm, folder: Path) -> Path:
    """A study file beside a table in one form."""
    (folder / form.file).write_bytes(form.content)
    data = "".join(f'{key} = "{value}"\n' for key, value in form.data.items())
    (folder / "study.toml").write_text(STUDY.format(file=form.file, data=data), encoding="utf-8")
    return folder / "study.toml"


def furthest(rows: Observations) -> float:
    """Largest relative distance of a number from the table's own; infinite where one is missing or too many."""
    expected = pd.DataFrame(ROWS, columns=pd.Index(HEADER), dtype=float)
    pairs = [
        (rows.slip, expected["slip"]),
        (rows.carried, expected["load [N]"]),
        (rows.values["sinkage"], 1e-3 * expected["sinkage [mm]"]),
        (rows.values["drawbar_pull"], expected["drawbar_pull [N]"]),
        (rows.values["resistance_moment"], expected["resistance_moment [N m]"]),
    ]
    far = 0.0
    for got, wanted in pairs:
        if len(got) != len(wanted) or (np.isnan(got) != np.isnan(wanted)).any():
            return np.inf
        far = max(far, float(np.nanmax(np.abs(got / wanted - 1))))
    return far


def said(form: TableForm, folder: Path) -> tuple[str, float]:
    """What check shows of the form and of renamed or foreign columns, or its one line of error; and the distance."""
    try:
        rows = bt.load_study(study_of(form, folder)).observations
    except StudyError as error:
        return str(error).replace(f"{folder}/", ""), np.nan
    other = [
        f"`{each.header.strip()}` {'is ' + each.name + ', in ' if each.name else ''}{each.remark}"
        for each in rows.headings
        if each.header.strip() not in HEADER
    ]
    return "; ".join([rows.form, *other]), furthest(rows)


def forms() -> pd.DataFrame:
    """A row for every form."""
    rows = []
    for form in table_forms():
        with TemporaryDirectory() as folder:
            words, far = said(form, Path(folder))
        rows.append({"form": form.name, "file": form.file, "taken": not np.isnan(far), "furthest": far, "says": words})
    return pd.DataFrame(rows)


def block(table: pd.DataFrame) -> str:
    """The table of the README."""
    rows = [
        (i, row["form"], row["says"].replace("|", "\\|") if row["taken"] else f"**error:** {row['says']}")
        for i, row in enumerate(table.to_dict("records"), start=1)
    ]
    return markdown(("", "form", "`check` says"), rows, "r||")


def main() -> None:
    """Make the tables anew."""
    table = forms()
    table.to_csv(HERE / "forms.csv", index=False, float_format="%.2g")
    path = HERE / "README.md"
    path.write_text(filled(path.read_text(encoding="utf-8"), {"forms": block(table)}), encoding="utf-8")


if __name__ == "__main__":
    main()
