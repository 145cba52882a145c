"""Export of a result: figures and tables of its page as files, a text on methods, references, draws."""

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayesterra.analysis.simulators import chrono_scm, errors_said, projection
from bayesterra.checking.levels import scope
from bayesterra.errors import ResultError
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.report.blocks import Cell, Gallery, Overview, Table, Text
from bayesterra.report.sections import render
from bayesterra.runtime.tables import Record, csv_text
from bayesterra.stats.laws import Law
from bayesterra.study.result import AnalysisResult, Result

KINDS = {"figures": ("svg", "pdf", "png"), "tables": ("latex", "csv"), "to": ("csv", "json", "chrono-scm")}
"""Options, and the formats that each may name."""
_LETTERS = (
    "αalpha βbeta γgamma δdelta ηeta θtheta κkappa λlambda μmu νnu ρrho σsigma τtau φvarphi χchi ψpsi ωomega ΔDelta"
    " ΣSigma ±pm ×times ≤le ≥ge ∞infty †dagger ▼blacktriangledown ▲blacktriangle ✓checkmark ·cdot √surd"
)
_LATEX = {
    **{sign: rf"\{sign}" for sign in "&%$#_{}"}, "\\": r"\textbackslash{}", "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}", "–": "--", "’": "'", "\u00a0": "~", "\u202f": r"\,", "²": "$^2$", "³": "$^3$",
    "−": "$-$", "°": r"$^\circ$", **{word[0]: rf"$\{word[1:]}$" for word in _LETTERS.split()},
}  # fmt: skip
_TAG = re.compile(r"<(sub|sup)>(.*?)</\1>|<[^>]*>", re.DOTALL)


@dataclass(frozen=True, kw_only=True, repr=False)
class Export(AnalysisResult):
    """Files of a result for a manuscript, numbered as its page is.

    Attributes
    ----------
    result : of ``run``, of one soil or of groups.
    asked : formats by option, of :data:`KINDS`.
    methods : whether to write ``methods.txt``, what was done, in words.
    bibtex : whether to write ``references.bib``, what those words cite.
    slips : at which soils for simulators take the exponent, see :func:`chrono_scm`.
    """

    MARK = "export.json"
    RECORD = Record.having(title=str, kind=str, captions=dict[str, str])
    PAGE = ""
    CALLED = "Folder"

    result: Result
    asked: Mapping[str, Sequence[str]] = field(default_factory=dict)
    methods: bool = False
    bibtex: bool = False
    slips: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.slips and not self._simulated:
            raise ResultError("'--slip' goes with '--to chrono-scm'")
        for option, kinds in self.asked.items():
            for kind in kinds:
                if kind not in KINDS[option]:
                    raise ResultError(f"'--{option}' must be of {', '.join(KINDS[option])} (got {kind!r})")

    @cached_property
    def numbered(self) -> Mapping[str, Table | Gallery]:
        """Tables and figures of the page in their order, by the names of their files."""
        blocks = (block for section in self.result.page().numbered for block in section.blocks)
        return {
            f"{'table' if block.kind == 'table' else 'figure'}-{block.number:02d}": block
            for block in blocks
            if not isinstance(block, Text) and block.number
        }

    def tables(self) -> Mapping[str, pd.DataFrame]:
        """Error of soils for simulators; other CSV files stand in :meth:`figures`."""
        return {} if self._projection.empty else {"projection": self._projection}

    def figures(self) -> Mapping[str, bytes]:
        """Every file that was asked for, by its name."""
        from bayesterra.report.figures import pdf, svg, white_png

        drawing = {"svg": svg, "pdf": pdf, "png": white_png}
        contents: dict[str, bytes | str] = {}
        for name, block in self.numbered.items():
            if isinstance(block, Table):
                makers = {"latex": ("tex", latex), "csv": ("csv", _as_csv)}
                for kind in self.asked.get("tables", ()):
                    contents[f"{name}.{makers[kind][0]}"] = makers[kind][1](block)
                continue
            for letter, picture in zip("abcdefghijklmnopqrstuvwxyz", block.pictures, strict=False):
                part = name + letter * (len(block.pictures) > 1)
                for kind in self.asked.get("figures", ()):
                    contents[f"{part}.{kind}"] = drawing[kind](picture.drawn)
        contents |= {"methods.txt": methods_text(self.result)} if self.methods else {}
        contents |= {"references.bib": references()} if self.bibtex else {}
        draws = {"csv": lambda: csv_text(self.result.to_dataframe()), "json": lambda: _as_json(self.result)}
        contents |= {f"draws.{kind}": draws[kind]() for kind in self.asked.get("to", ()) if kind in draws}
        contents |= chrono_scm(self.result, self.slips) if self._simulated else {}
        return {name: made.encode() if isinstance(made, str) else made for name, made in contents.items()}

    @property
    def _simulated(self) -> bool:
        return "chrono-scm" in self.asked.get("to", ())

    @cached_property
    def _projection(self) -> pd.DataFrame:
        return projection(self.result, self.slips) if self._simulated else pd.DataFrame()

    def to_record(self) -> dict[str, Any]:
        """Title, kind of the data and captions."""
        captions = {name: text_of(block.caption) for name, block in self.numbered.items()}
        return {"title": self.result.study.title, "kind": self.result.study.kind, "captions": captions}

    def overview(self) -> Overview:
        """What was written, in a line."""
        asked = [f"{option} as {', '.join(kinds)}" for option, kinds in self.asked.items() if kinds]
        asked += ["methods.txt"] * self.methods + ["references.bib"] * self.bibtex
        said = f"{self.result.study.title} ({self.result.study.kind} data): {'; '.join(asked)}."
        return (Text(said), *map(Text, errors_said(self._projection)))

    def place(self, folder: Path) -> str:
        """Line on where it was saved."""
        return f"{self.CALLED}: {folder}, captions in {folder / self.MARK}"


def text_of(cell: Cell) -> str:
    """A cell without its marks: subscripts after an underscore."""
    if not isinstance(cell, Markup):
        return cell
    return unescape(_TAG.sub(lambda tag: f"{'_' if tag[1] == 'sub' else '^'}{tag[2]}" if tag[1] else "", str(cell)))


def _plain(text: str) -> str:
    return "".join(_LATEX.get(letter, letter) for letter in text)


def _tex(cell: Cell) -> str:
    """A cell in LaTeX."""
    if not isinstance(cell, Markup):
        return _plain(cell)
    text, parts, at = str(cell), list[str](), 0
    for tag in _TAG.finditer(text):
        parts.append(_plain(unescape(text[at : tag.start()])))
        if tag[1]:
            place = "subscript" if tag[1] == "sub" else "superscript"
            parts.append(rf"\text{place}{{{_plain(unescape(tag[2]))}}}")
        at = tag.end()
    return "".join([*parts, _plain(unescape(text[at:]))])


def latex(table: Table) -> str:
    """A table for LaTeX with the package booktabs, its caption and a label."""

    def line(cells: Sequence[Cell]) -> str:
        return " & ".join(map(_tex, cells)) + r" \\"

    head = [line(table.header), r"\midrule"] if any(table.header) else []
    return "\n".join(
        [
            r"\begin{table}", r"\centering", rf"\caption{{{_tex(table.caption)}}}", rf"\label{{tab:{table.number}}}",
            rf"\begin{{tabular}}{{{table.align}}}", r"\toprule", *head, *map(line, table.rows), r"\bottomrule",
            r"\end{tabular}", r"\end{table}", "",
        ]
    )  # fmt: skip


def _as_csv(table: Table) -> str:
    heads = [text_of(cell) or f"column {i + 1}" for i, cell in enumerate(table.header)]
    rows = [[text_of(cell) for cell in row] for row in table.rows]
    return csv_text(pd.DataFrame(rows, columns=pd.Index(heads)))


def _as_json(result: Result) -> str:
    """Draws by parameter with their units, SI and radians."""
    table = result.to_dataframe()
    draws = {name: table[name].tolist() for name in table.columns}
    units = {name: PARAMETERS[name].dimension or "1" for name in result.names if name in PARAMETERS}
    return json.dumps({"title": result.study.title, "kind": result.study.kind, "units": units, "draws": draws}) + "\n"


def references() -> str:
    """What :func:`methods_text` cites, for BibTeX."""
    return render(None, "references.bib")


def methods_text(result: Result) -> str:
    """What was done and what came out, in words for a manuscript."""
    from bayesterra.likelihood.page import noise_text, stated_law

    study, rows = result.study, result.study.observations.used()
    entries = study.prior.entries
    laws = {name: stated_law(name, entry) for name, entry in entries.items()}
    free = [name for name in entries if isinstance(entries[name], Law)]
    text = render(
        {
            "result": result, "study": study, "record": result.record, "scope": scope(study),
            "readings": sum(int((~np.isnan(rows.values[name])).sum()) for name in study.noise), "rows": len(rows),
            "noise": "; ".join(
                f"{CHANNELS[name].symbol} {noise_text(of)}{f' {CHANNELS[name].unit}' * (of.sd is not None)}"
                for name, of in study.noise.items()
            ),
            "free": len(result.names), "priors": _named(laws, free),
            "fixed": _named(laws, [name for name in entries if name not in free]),
        },
        "methods.txt",
    )  # fmt: skip
    return unescape(text)


def _named(laws: Mapping[str, Markup], names: Sequence[str]) -> str:
    return "; ".join(f"{PARAMETERS[name].symbol} {text_of(laws[name])}" for name in names)
