"""The index of the source paper: every table and figure in a line, from the studies' ``statements.csv``.

Run it with ``python studies/paper/run.py`` after other studies; it rewrites the tables in its README. It
picks up every ``statements.csv`` below ``studies``, and the older ``index.csv`` of Section 4 by a reader.
"""

from __future__ import annotations

import re
import sys
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

HERE = Path(__file__).parent
STUDIES = HERE.parent
SECTION_4 = "paper/sensitivity"
sys.path.append(str(STUDIES / "support"))

from paper_statements import COLUMNS, FILE, read  # noqa: E402
from readme import filled, mark, markdown, minus  # noqa: E402

TITLES = {
    "Table 2": "soil parameters by conventional tests",
    "Table 4": "share of F_Nτ in the normal force",
    "Table 5": "the soil G1",
    "Table 6": "influence of the bearing parameters",
    "Table 7": "influence of the shearing parameters",
    "Table 8": "influence of the contact angles",
    "Table 9": "influence of the parameter groups in words",
    "Table 10": "parameters by IM1",
    "Table 11": "constant sinkage exponent",
    "Table 12": "R_j = r",
    "Table 13": "R_j = R",
    "Table 14": "parameters by IM3",
    "Table 15": "fit errors and times of IM3",
    "Table 16": "four-wheeled rover on Toyoura sand",
    "Fig. 5": "parts of normal force and pull over slip",
    "Fig. 6": "share of k_c in K_s",
    "Fig. 7": "bearing parameters: curves",
    "Fig. 8": "bearing parameters: stresses",
    "Fig. 9": "shearing parameters: curves",
    "Fig. 10": "contact angles: curves",
    "Fig. 11": "contact angles: stresses",
    "Fig. 12": "convergence of IM1",
    "Fig. 16": "F_N with a constant exponent",
    "Fig. 17": "parameters of the three methods",
    "Fig. 18": "errors and times of the three methods",
    "Fig. 20": "rover on flat ground",
    "Fig. 21": "rover on slopes",
    "Eq. (42)": "load effect",
    "Section 3.2": "conventional soil tests",
    "Section 4.1": "stresses",
    "CMU": "grouser wheel on dry sand, held out: slips, static insertion",
}
"""What each table or figure is about, in the order of the index; others follow under their own names."""
WANTED = (
    *(f"Table {n}" for n in (2, 4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15, 16)),
    *(f"Fig. {n}" for n in (5, 6, 7, 8, 9, 10, 11, 12, 16, 17, 18)),
    "Eq. (42)", "Section 3.2", "CMU",
)  # fmt: skip
"""What the index is to hold."""
LETTERS = re.compile(r"\([a-z](?:, *[a-z])*\)")
TOKENS = re.compile(r"\b(table|fig|section|eq|cmu)|(\(\d+\)|\d+(?:\.\d+)*)|\b(to)\b|(–)", re.IGNORECASE)
KINDS = {"table": "Table", "fig": "Fig.", "section": "Section", "eq": "Eq."}
SEVERAL = ("reproduced", "differs", "cannot be checked")
"""Verdicts; the last one is not counted."""
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
class Line:
    """A table or figure of the paper as one study found it.

    Attributes
    ----------
    place : e.g. ``Table 10``.
    study : folder of the study below ``studies``.
    statements : its statements on the place, in the study's order.
    """

    place: str
    study: str
    statements: pd.DataFrame

    @property
    def off(self) -> pd.DataFrame:
        """Statements that were not reproduced."""
        return self.statements[self.statements["verdict"] == "differs"]

    @property
    def shown(self) -> dict[str, str]:
        """The statement that stands for the place: the first one, where the study puts its numbers."""
        return {str(name): str(value) for name, value in self.statements.iloc[0].items()}

    def cells(self) -> list[str]:
        """The line of the index."""
        counts = self.statements["verdict"].value_counts()
        good, count = counts.get("reproduced", 0), counts.get("reproduced", 0) + len(self.off)
        verdict = "cannot be checked" if not count else "reproduced" if self.off.empty else "differs"
        tally = f"{mark(verdict)}, {good} of {count}" if count else verdict
        first = self.shown
        why = "; ".join(dict.fromkeys(each for each in self.off["why"] if each))
        return [
            self.place, TITLES.get(self.place, ""), _said(first), first["ours"], _value(first["difference"]),
            tally, why, _link(self.study), f"`python studies/remake.py {self.study}`",
        ]  # fmt: skip


def _link(study: str) -> str:
    """The folder of a study, from that of the index."""
    here = f"{HERE.name}/"
    return f"[{study}]({study.removeprefix(here) if study.startswith(here) else f'../{study}'})"


def _said(first: dict[str, str]) -> str:
    """What is printed: the value with what it is, where the value alone would say nothing."""
    printed, statement = _value(first["printed"]), first["statement"]
    if not printed or statement.startswith(printed):
        return statement
    return f"{statement}: {printed}" if len(printed) < 40 else printed


def _value(text: str) -> str:
    """A cell's text; nothing for the dash that stands for nothing."""
    return "" if text.strip() in ("-", "–", "−") else text


def places(text: str) -> list[str]:
    """Tables, figures and equations that a text names, else its sections, else the text itself.

    ``Fig. 5(b, c)`` is ``Fig. 5``, ``Figs 20, 21`` are two, ``Tables 6 to 8`` three, ``(42)`` is an equation.
    """
    names: list[str] = []
    kind, through = "", False
    for word, number, to, dash in TOKENS.findall(LETTERS.sub("", text)):
        if word.lower() == "cmu":
            names.append("CMU")
        elif word:
            kind = KINDS[word.lower()]
        elif number.startswith("("):
            names.append(f"Eq. {number}")
        elif number and kind:
            first = int(names[-1].split()[1]) + 1 if through and number.isdigit() else number
            between = range(int(first), int(number)) if through else ()
            names += [f"{kind} {each}" for each in (*between, number)]
        through = bool(to or dash) and bool(names) and names[-1].split()[-1].isdigit()
    firm = [name for name in names if not name.startswith("Section")]
    return list(dict.fromkeys(firm or names)) or [text]


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


def lines(tables: dict[str, pd.DataFrame]) -> list[Line]:
    """One line per place and study, in the order of ``TITLES``."""
    made = []
    for study, table in tables.items():
        named = [(place, i) for i, text in enumerate(table["table_or_figure"]) for place in places(text)]
        for place in dict.fromkeys(place for place, _ in named):
            chosen = [i for name, i in named if name == place]
            made.append(Line(place, study, table.iloc[chosen][list(COLUMNS)]))
    order = list(TITLES)
    return sorted(made, key=lambda line: order.index(line.place) if line.place in order else len(order))


def blocks(tables: dict[str, pd.DataFrame]) -> dict[str, str]:
    """The tables of the README."""
    index = lines(tables)
    head = ["where", "what", "printed", "ours", "difference", "verdict", "why it differs", "study", "remade by"]
    rows = [
        [_link(study), *(f"{(t['verdict'] == word).sum()}" for word in SEVERAL), f"`python studies/remake.py {study}`"]
        for study, t in tables.items()
    ]
    missing = [name for name in WANTED if name not in {line.place for line in index}]
    made = {
        "studies": markdown(["study", *SEVERAL, "remade by"], rows, "|rrr|"),
        "index": markdown(head, [line.cells() for line in index]),
        "missing": "Not yet in a study: " + ", ".join(missing) + "." if missing else "Nothing is missing.",
    }
    return {name: minus(block) for name, block in made.items()}


def page(text: str) -> str:
    """The README with its tables made anew."""
    return filled(text, blocks(found()))


def main() -> None:
    """Rewrite the tables of the README."""
    readme = HERE / "README.md"
    text = page(readme.read_text(encoding="utf-8"))
    readme.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
