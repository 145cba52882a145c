"""Export of a result: figures and tables of its page, a text on methods, references, draws, and soils for simulators.

Soils for simulators are an ensemble of parameter files for Chrono's SCM terrain, beside the error of that projection.
SCM (Krenn and Hirzinger 2009, deformable soil under a mesh) presses by (k_c/b + k_φ) zⁿ at every node and shears by
Janosi and Hanamoto. Its exponent knows no slip, so that of a wheel is taken at a stated slip. A rigid wheel on it is
the integral model whose stress is greatest at the bottom and nothing behind: θm = θ2 = 0, without lugs.
"""

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from html import unescape
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup

from bayesterra.arrays import FloatArray
from bayesterra.checking.levels import scope
from bayesterra.errors import ResultError, counted
from bayesterra.likelihood.forward import Forward, reference_load, soil_at
from bayesterra.models import M1, Conditions, Wheel
from bayesterra.models.forces import DRAWBAR_PULL, SINKAGE
from bayesterra.parameters import CHANNELS, PARAMETERS, SoilColumns, whole_and_part
from bayesterra.prediction.prediction import spread
from bayesterra.report.blocks import Cell, Gallery, Overview, Table, Text
from bayesterra.report.sections import render
from bayesterra.runtime.tables import Record, csv_text
from bayesterra.stats.laws import Law
from bayesterra.study.drive import Drive
from bayesterra.study.result import SI_UNITS, AnalysisResult, Result

KINDS = {"figures": ("svg", "pdf", "png"), "tables": ("latex", "csv"), "to": ("csv", "json", "chrono-scm")}
"""Options, and the formats that each may name."""
_LETTERS = (
    "αalpha βbeta γgamma δdelta ηeta θtheta κkappa λlambda μmu νnu ρrho σsigma τtau φvarphi χchi ψpsi ωomega ΔDelta"
    " ΣSigma ±pm ×times ≤le ≥ge ∞infty †dagger ▼blacktriangledown ▲blacktriangle ✓checkmark ·cdot √surd"
)
_LATEX = {
    **{sign: rf"\{sign}" for sign in "&%$#_{}"}, "\\": r"\textbackslash{}", "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}", "–": "--", "’": "'", "\u00a0": "~", "\u202f": r"\,", "²": "$^2$", "³": "$^3$",
    "<": "$<$", ">": "$>$",
    "−": "$-$", "°": r"$^\circ$", **{word[0]: rf"$\{word[1:]}$" for word in _LETTERS.split()},
}  # fmt: skip
_TAG = re.compile(r"<(sub|sup)>(.*?)</\1>|<[^>]*>", re.DOTALL)


@dataclass(frozen=True, kw_only=True, repr=False)
class Export(AnalysisResult):
    """Files of a result for a manuscript, numbered as its page is."""

    MARK = "export.json"
    RECORD = Record.having(title=str, kind=str, captions=dict[str, str])
    PAGE = ""
    CALLED = "Folder"

    result: Result  # of ``run``, of one soil or of groups
    asked: Mapping[str, Sequence[str]] = field(default_factory=dict)  # formats by option, of :data:`KINDS`
    methods: bool = False  # whether to write ``methods.txt``, what was done, in words
    bibtex: bool = False  # whether to write ``references.bib``, what those words cite
    slips: tuple[float, ...] = ()  # at which soils for simulators take the exponent, see :func:`chrono_scm`

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
    whole = {name: whole_and_part(name)[0] for name in result.names}
    units = {name: SI_UNITS.get(of, PARAMETERS[of].dimension or "1") for name, of in whole.items() if of in PARAMETERS}
    return json.dumps({"title": result.study.title, "kind": result.study.kind, "units": units, "draws": draws}) + "\n"


def references() -> str:
    """What :func:`methods_text` cites, for BibTeX."""
    return render(None, "references.bib")


def methods_text(result: Result) -> str:
    """What was done and what came out, in words for a manuscript."""
    from bayesterra.likelihood.page import errors_text, noise_text, stated_law
    from bayesterra.pooling.page import joined_laws

    study, rows = result.study, result.study.observations.used()
    entries = study.prior.entries
    laws = {name: stated_law(name, entry) for name, entry in entries.items()}
    free = [name for name in entries if isinstance(entries[name], Law)]
    text = render(
        {
            "result": result, "study": study, "record": result.record, "scope": scope(study),
            "readings": sum(int((~np.isnan(rows.values[name])).sum()) for name in study.noise)
            + sum(len(test.readings) for test in study.soil_tests.values()), "rows": len(rows),
            "noise": "; ".join(
                f"{CHANNELS[name].symbol} {noise_text(study, name, f' {CHANNELS[name].unit}')}" for name in study.noise
            ),
            "errors": text_of(errors_text(study)), "joined": text_of(joined_laws(study)),
            "roles": {role: ", ".join(PARAMETERS[name].symbol for name in getattr(study.pooling, role, ()))
                      for role in ("shared", "separate", "hierarchical")},
            "free": counted(len(result.names), "parameter"), "priors": _named(laws, free),
            "fixed": _named(laws, [name for name in entries if name not in free]),
        },
        "methods.txt",
    )  # fmt: skip
    return unescape(text)


def _named(laws: Mapping[str, Markup], names: Sequence[str]) -> str:
    return "; ".join(f"{PARAMETERS[name].symbol} {text_of(laws[name])}" for name in names)


SOILS = 100
"""Draws that become files, for every slip."""
STIFFEST, DAMPING = 4e8, 3e4
"""Elastic stiffness (Pa/m), which must exceed k_φ, and damping (Pa s/m), as in Chrono's own examples."""
_OUTCOMES = {"sinkage": SINKAGE, "drawbar_pull": DRAWBAR_PULL}
_BOTTOM = 1e-9  # θm/θ1 of a stress that is greatest at the bottom


def chrono_scm(result: Result, slips: Sequence[float] = ()) -> dict[str, str]:
    """Files for Chrono's SCM terrain by name, one a draw.

    Each holds an object ``Soil parameters`` as Chrono's terrain node for co-simulation reads it, its eight numbers
    in the order of ``SCMTerrain::SetSoilParameters``: SI, friction in degrees.

    Parameters
    ----------
    result : of ``run``, of one soil or of groups, whose every group has files.
    slips : at which the exponent is taken; by default the least, the middle and the greatest of those in the fit.

    Raises
    ------
    ResultError : the posterior lacks what SCM needs, or a slip lies outside [0, 1).
    """
    _check(slips)
    files: dict[str, str] = {}
    for place, (group, one) in enumerate(result.by_group().items(), 1):
        draws, places = spread(one, SOILS)
        soils = _soils(one, draws)
        for slip in slips or _levels(one):
            name = "-".join(["scm", *[f"group-{place}"] * bool(group), *[f"slip-{slip:g}"] * bool(one.study.wheels)])
            for number, (row, of) in enumerate(zip(_rows(soils, slip), places, strict=True), 1):
                origin = {"title": one.study.title, "kind": one.study.kind, "group": group, "slip": slip}
                origin |= dict(zip(("chain", "draw"), map(int, of), strict=True))
                files[f"{name}-{number:03d}.json"] = json.dumps(
                    {"Soil parameters": row, "bayesterra": origin}, indent=1
                )
    return files


def _check(slips: Sequence[float]) -> None:
    if wrong := next((slip for slip in slips if not 0 <= slip < 1), None):
        raise ResultError(f"'slip' must lie in [0, 1) (got {wrong:g})")


def _levels(result: Result) -> tuple[float, ...]:
    """Least, middle and greatest slip of the readings in the fit; 0 without a wheel."""
    slip = result.study.observations.used().slip
    return tuple(dict.fromkeys(float(each) for each in np.quantile(slip, [0, 0.5, 1]))) if len(slip) else (0.0,)


def _soils(result: Result, draws: FloatArray) -> dict[str, FloatArray]:
    """What SCM needs of draws (n, d) by name, each (n,)."""
    prior = result.study.prior

    def column(*names: str) -> FloatArray:
        for name in names:
            if name in prior.entries:
                return prior.column(name, draws)
        raise ResultError(
            f"chrono-scm needs {' or '.join(names)}, which this posterior lacks: add a soil test that tells it"
        )

    moduli = {"kc": column("kc"), "kphi": column("kphi")} if "kphi" in prior.entries else {}
    soils = moduli or {"kc": np.zeros(len(draws)), "kphi": column("Ks", "kphi")}
    soils |= {"n": column("n0", "n"), **{name: column(name) for name in ("c", "phi", "K")}}
    return {**soils, "n1": prior.column("n1", draws) if "n1" in prior.entries else np.zeros(len(draws))}


def _rows(soils: Mapping[str, FloatArray], slip: float) -> Iterator[dict[str, float]]:
    """Each draw in Chrono's words."""
    for i in range(len(soils["n"])):
        value = {name: float(column[i]) for name, column in soils.items()}
        yield {
            "Bekker Kphi": value["kphi"], "Bekker Kc": value["kc"],
            "Bekker n exponent": value["n"] + value["n1"] * slip, "Mohr cohesive limit": value["c"],
            "Mohr friction limit": float(np.degrees(value["phi"])), "Janosi shear coefficient": value["K"],
            "Elastic stiffness": max(STIFFEST, 20 * value["kphi"]), "Damping": DAMPING,
        }  # fmt: skip


def projection(result: Result, slips: Sequence[float] = ()) -> pd.DataFrame:
    """Error of the projection in sinkage and pull of the study's first wheel under its reference load.

    Parameters
    ----------
    slips : at which the exponent is taken, ``projected_at``; every such soil is driven at all of them.

    Returns
    -------
    Field units: medians of the model of the study and of the wheel on SCM, and of their difference 90 % of the
    draws; ``answered`` is the share of draws for which both have an answer. Empty without a wheel.

    Raises
    ------
    ResultError : as of :func:`chrono_scm`.
    """
    _check(slips)
    rows = [row for group, one in result.by_group().items() if one.study.wheels for row in _errors(group, one, slips)]
    return pd.DataFrame(rows)


def _errors(group: str, result: Result, slips: Sequence[float]) -> Iterator[dict[str, object]]:
    study, slips = result.study, slips or _levels(result)
    draws, _ = spread(result, SOILS * 10)
    wheel, driven = next(iter(study.wheels.values())), np.asarray(slips, dtype=np.float64)
    load = np.full(len(driven), reference_load(study))
    forward = Forward(study.model, Drive.LOAD, Conditions.of(wheel, driven), load)
    own = forward(study.prior.soil_values(draws), every_row=True)
    for projected in slips:
        values = on_scm(result, draws, projected, Conditions.of(Wheel(wheel.radius, wheel.width), driven), load)
        for name, place in _OUTCOMES.items():
            pairs = np.stack([own[name], values[:, :, place]]) / CHANNELS[name].scale
            for i, slip in enumerate(driven):
                model, scm = pairs[:, np.isfinite(pairs[:, :, i]).all(axis=0), i]
                ends = np.quantile(scm - model, [0.05, 0.5, 0.95]) if len(model) else np.full(3, np.nan)
                medians = (np.median(model), np.median(scm)) if len(model) else (np.nan, np.nan)
                yield {
                    **({"group": group} if group else {}), "projected_at": projected, "slip": slip, "quantity": name,
                    "unit": CHANNELS[name].unit, **dict(zip(("model", "scm"), medians, strict=True)),
                    **dict(zip(("error_05", "error_50", "error_95"), ends, strict=True)),
                    "answered": len(model) / len(draws),
                }  # fmt: skip


def errors_said(table: pd.DataFrame) -> Iterator[str]:
    """The error of every projection at its own slip in a sentence, and the worst at another slip."""
    if table.empty:
        return
    keys = ["group", "projected_at"] if "group" in table else ["projected_at"]
    for key, part in table.groupby(keys):
        *group, slip = key
        own, others = part[part["slip"] == slip], part[part["slip"] != slip]
        texts = []
        for row in own.to_dict("records"):
            named = CHANNELS[str(row["quantity"])]
            off = others[others["quantity"] == row["quantity"]]["error_50"]
            far = f", up to {off.iloc[off.abs().argmax()]:+.3g} at other slips" if len(off) else ""
            texts.append(
                f"{named.description} {row['error_50']:+.3g} {named.unit} (90 %: {row['error_05']:+.3g} to"
                f" {row['error_95']:+.3g}) of {row['model']:.3g}{far}"
            )
        where = "".join(f"{name}: " for name in group)
        yield f"{where}SCM soils projected at slip {slip:.3g} are off the model by: {'; '.join(texts)}."


def on_scm(result: Result, draws: FloatArray, slip: float, rows: Conditions, load: FloatArray) -> FloatArray:
    """Sinkage, pull and moment (n, m, 3) of a rigid wheel on SCM soils of draws, projected at a slip."""
    soil = soil_at(result.study.prior.soil_values(draws), float(rows.width[0]))
    own, zero = _soils(result, draws), np.zeros(len(draws))
    columns = (soil[:, SoilColumns.Ks], own["n"] + own["n1"] * slip, zero, own["c"], own["phi"], own["K"])
    theta = np.column_stack([*columns, zero + _BOTTOM, zero, zero])
    return M1(shear_start="rim", constant_exponent=True).response_at(theta, rows, load, every_row=True)[0]
