"""The index of the source paper: every statement of it in a row, from the studies' ``statements.csv``.

``seed-list.csv`` was made from the text of the paper, not from what the studies check: place, statement, the study and
the beginning of its row (several parted by semicolons: the worst counts), and what a difference is due to. Run it with
``python studies/paper/run.py`` after other studies; it rewrites the tables in its README.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

HERE = Path(__file__).parent
STUDIES = HERE.parent
SECTION_4 = "paper/sensitivity"
sys.path.append(str(STUDIES / "support"))

from paper_statements import FILE, VERDICTS, read  # noqa: E402
from readme import filled, mark, markdown, minus  # noqa: E402

CLASSES = {
    "print": "the print contradicts itself",
    "data": "the paper's readings are unpublished, others stand in",
    "sentence": "the paper's sentence is not right",
    "hardware": "times of another computer",
}
"""What a statement that differs is due to; those of the print and of hardware stand apart from the count."""
APART = ("print", "hardware")
OUTSIDE = "outside"
BEFORE = {"reproduced": 68, "differs": 39, "cannot be checked": 6}
"""The count before the paper's solver was known, its own checks taken off."""
WHY = {
    "F_Nτ/F_N of G1 at slip 0.6 for six wheels, 35 to 150 N": "four of eight by 0.4 to 1.0 points,"
    " as if measured"
    " sinkages had been put in (a guess)",
    "F_DPσ is lower than F_DPτ": "G14 at slip 0 pulls backwards, by 1 N",
    "F_DPτ is influenced by P_II only": "P_I and P_III act through the length of the contact",
    "K of G1 is 25 mm (Table 7: 12 mm)": "the print contradicts itself; Table 4 suits 12 mm",
    "24 errors (16) of z, F_DP, M_DR": "groups that sink deep, as if the paper's deep sinkages were 1 % deeper",
    "18 errors (16) of z, F_DP, M_DR": "G17 suits a c1 of 0.29 to 0.335, probably a misprint; G19, G20: deep sinkages",
    "P_III influences F_DP more than z and M_DR": "G20 moves z more than F_DP, in print as well",
    "with an increase in c3 z decreases and F_DP increases": "the sentence is the wrong way round;"
    " Table 8 agrees"
    " with us",
}
"""Reasons that the README of the study of Section 4 gives, by statement."""


@dataclass(frozen=True)
class Entry:
    """A statement of the paper with the rows of the study that checks it.

    Attributes
    ----------
    where, says : place and statement.
    study : folder below ``studies``, or ``outside``.
    rows : of the study's statements.
    note : what a difference is due to, or why it lies outside.
    """

    where: str
    says: str
    study: str
    rows: pd.DataFrame
    note: str

    @property
    def row(self) -> Mapping[str, str]:
        """The worst of the rows."""
        order = ("differs", "cannot be checked", "reproduced")
        at = min(range(len(self.rows)), key=lambda i: order.index(self.rows["verdict"].iloc[i]))
        return {str(name): str(value) for name, value in self.rows.iloc[at].items()}

    @property
    def verdict(self) -> str:
        """The verdict of the worst row; ``outside`` without rows."""
        return OUTSIDE if self.rows.empty else self.row["verdict"]

    def cells(self) -> list[str]:
        """The row of the index."""
        if self.rows.empty:
            return [self.where, self.says, "", "", "", OUTSIDE, self.note, ""]
        row = self.row
        word = mark(self.verdict) + (f" ({self.note})" if self.verdict == "differs" else "")
        values = (_value(row[name]) for name in ("printed", "ours", "difference"))
        return [
            self.where,
            self.says,
            *values,
            word,
            row["why"] if self.verdict != "reproduced" else "",
            _link(self.study),
        ]


def _link(study: str) -> str:
    """The folder of a study, from that of the index."""
    here = f"{HERE.name}/"
    return f"[{study}]({study.removeprefix(here) if study.startswith(here) else f'../{study}'})"


def _value(text: str) -> str:
    """A cell's text; nothing for the dash that stands for nothing."""
    return "" if text.strip() in ("-", "–", "−") else text


def of_section_4(folder: Path) -> pd.DataFrame:
    """Statements of the study of Section 4 in the common columns, with the numbers of Tables 4 and 6 to 8."""
    table = pd.read_csv(folder / "index.csv", keep_default_na=False, dtype=str)
    reading = [f"{s} ({r})" if r else s for s, r in zip(table["statement"], table["reading"], strict=True)]
    why = [WHY[s] if v == "differs" else "" for s, v in zip(table["statement"], table["verdict"], strict=True)]
    made = pd.DataFrame(
        {
            "table_or_figure": table["place"], "statement": reading, "printed": table["statement"],
            "ours": table["ours"], "difference": "", "verdict": table["verdict"], "why": why,
        }
    )  # fmt: skip
    errors = pd.read_csv(folder / "tables-6-8.csv")
    for number, some in errors.groupby("table"):
        row = made.index[(table["place"] == f"Table {number}") & table["statement"].str.contains("errors")][0]
        parts = {SYMBOLS[name]: each for name, each in some.groupby("outcome", sort=False)}
        made.loc[row, "printed"] = "errors (16): " + _spans(parts, "printed", "{:.1f}") + " %"
        made.loc[row, "ours"] = _spans(parts, "ours", "{:.1f}") + " %; inside our bounds " + made.loc[row, "ours"]
        made.loc[row, "difference"] = _spans(parts, "difference", "{:+.1f}") + " points"
    shares = pd.read_csv(folder / "table-4.csv")
    row = made.index[table["place"] == "Table 4"][0]
    for column, name in (("printed", "share_percent"), ("ours", "ours_percent")):
        made.loc[row, column] = f"{shares[name].min():.1f} to {shares[name].max():.1f} %"
    made.loc[row, "ours"] += f"; to the last digit {(shares['verdict'] == 'reproduced').sum()} of {len(shares)}"
    ends = shares["difference"]
    made.loc[row, "difference"] = f"{ends.min():+.1f} to {ends.max():+.1f} points"
    return made


SYMBOLS = {"sinkage": "z", "drawbar_pull": "F_DP", "resistance_moment": "M_DR"}


def _spans(parts: dict[str, pd.DataFrame], column: str, form: str) -> str:
    return ", ".join(
        f"{name} {form.format(each[column].min())} to {form.format(each[column].max())}" for name, each in parts.items()
    )


def found(studies: Path = STUDIES) -> dict[str, pd.DataFrame]:
    """Statements by study."""
    tables = {}
    for folder in sorted(path for path in studies.rglob("*") if path.is_dir()):
        name = folder.relative_to(studies).as_posix()
        if (folder / FILE).is_file():
            tables[name] = read(folder)
        elif name == SECTION_4:
            tables[name] = of_section_4(folder)
    return tables


def entries(tables: Mapping[str, pd.DataFrame], listed: pd.DataFrame | None = None) -> list[Entry]:
    """Every statement of the list with its rows.

    Raises
    ------
    ValueError : a statement of the list is in no study, or one that differs has no class.
    """
    listed = pd.read_csv(HERE / "seed-list.csv", keep_default_na=False) if listed is None else listed
    made = []
    for row in listed.to_dict("records"):
        if row["study"] == OUTSIDE:
            made.append(Entry(row["where"], row["says"], OUTSIDE, pd.DataFrame(), row["statement"]))
            continue
        table = tables[row["study"]]
        chosen = _chosen(table, row["statement"])
        if chosen.empty:
            raise ValueError(f"'{row['study']}' has no statement that begins with '{row['statement']}'")
        made.append(Entry(row["where"], row["says"], row["study"], chosen, row["class"]))
        if made[-1].verdict == "differs" and row["class"] not in CLASSES:
            raise ValueError(f"'{row['says']}' differs: 'class' must be one of {', '.join(CLASSES)}")
    return made


def _chosen(table: pd.DataFrame, beginnings: str) -> pd.DataFrame:
    return table[table["statement"].str.startswith(tuple(beginnings.split(";")))]


def own_checks(tables: Mapping[str, pd.DataFrame], found: list[Entry]) -> dict[str, pd.DataFrame]:
    """Rows of each study that no statement of the list stands for."""
    used = {(each.study, text) for each in found if len(each.rows) for text in each.rows["statement"]}
    return {study: table[[(study, text) not in used for text in table["statement"]]] for study, table in tables.items()}


def blocks(tables: Mapping[str, pd.DataFrame]) -> dict[str, str]:
    """The tables of the README."""
    found = entries(tables)
    counted = [
        each for each in found if each.verdict != OUTSIDE and not (each.verdict == "differs" and each.note in APART)
    ]
    now = {word: sum(each.verdict == word for each in counted) for word in VERDICTS}
    differ = {name: sum(each.verdict == "differs" and each.note == name for each in found) for name in CLASSES}
    rest = own_checks(tables, found)
    own = [
        [_link(study), *(f"{(rows['verdict'] == word).sum()}" for word in VERDICTS)]
        for study, rows in rest.items() if len(rows)
    ]  # fmt: skip
    made = {
        "count": markdown(
            ["", *VERDICTS],
            [
                ["before", *(f"{BEFORE[word]}" for word in VERDICTS)],
                [f"now, {len(counted)} statements of the paper", *(f"{now[word]}" for word in VERDICTS)],
            ],
            "|rrr",
        ),
        "classes": markdown(
            ["differs", "statements", ""],
            [[name, f"{differ[name]}", text + (" (apart from the count)" if name in APART else "")]
             for name, text in CLASSES.items()],
            "|r|",
        ),
        "index": markdown(
            ["where", "the paper says", "printed", "ours", "difference", "verdict", "why", "study"],
            [each.cells() for each in found],
        ),
        "own": markdown(["study", *VERDICTS], own, "|rrr"),
    }  # fmt: skip
    return {name: minus(block) for name, block in made.items()}


def page(text: str) -> str:
    """The README with its tables made anew."""
    return filled(text, blocks(found()))


def main() -> None:
    """Rewrite the tables of the README."""
    readme = HERE / "README.md"
    text = page(readme.read_text(encoding="utf-8"))
    readme.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
