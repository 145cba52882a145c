"""Draft: tables of a study as a form fills them in, and the study file that they make."""

from __future__ import annotations

import datetime
import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesterra.errors import BayesterraError, StudyError
from bayesterra.models import MODELS
from bayesterra.parameters import CHANNELS, OUTCOMES, PARAMETERS
from bayesterra.runtime.folders import write_bytes, write_text
from bayesterra.runtime.reading import MEGABYTE, MOST_TABLE, read_bytes, read_text
from bayesterra.study.canonical import assignments
from bayesterra.study.entries import prior_entry, prior_set
from bayesterra.study.observations import read_table
from bayesterra.study.own import OURS
from bayesterra.study.priors import Entry
from bayesterra.study.schema import read_toml
from bayesterra.study.soil_tests import EXAMPLES
from bayesterra.study.study import STUDY_FILE
from bayesterra.study.units import known_column
from bayesterra.ui.fields import fields
from bayesterra.ui.folder import checked_entry

SETS = ("paper-box", "planetary")
LAWS: Mapping[str, tuple[str, ...]] = {
    "uniform": ("lower", "upper"),
    "loguniform": ("lower", "upper"),
    "norm": ("loc", "scale", "lower", "upper"),
    "halfnorm": ("scale", "lower", "upper"),
    "lognorm": ("s", "scale", "lower", "upper"),
}
"""Laws that the form knows, and their arguments; others stand in the text of the study."""
NOISES: Mapping[str, tuple[str, ...]] = {
    "estimate": ("scale", "lower"),
    "sd": ("sd",),
    "fraction": ("fraction", "floor"),
}
TYPICAL = {
    "sinkage": ("1 mm", "0.1 mm"), "drawbar_pull": ("2 N", "0.2 N"), "normal_force": ("2 N", "0.2 N"),
    "resistance_moment": ("0.3 N m", "0.03 N m"),
}  # fmt: skip
"""Scale and lower end of an estimated noise, as in the template of ``bayesterra init``."""
TESTED: Mapping[str, tuple[str, ...]] = {"plate": ("kc", "kphi", "n"), "shear": ("c", "phi", "K")}
"""Parameters that soil tests read."""
ROLES = ("shared", "separate", "hierarchical")
GROUPINGS = ("wheel", "site", "run")
KEPT = "as in the text"
Form = Mapping[str, str]


@dataclass
class Draft:
    """A study in the making: a folder with its table and its study file, and what that holds."""

    folder: Path
    content: dict[str, Any]

    @classmethod
    def at(cls, folder: Path) -> Draft:
        """The draft in a folder; StudyError where its text is no study file."""
        return cls(folder, _plain(read_toml(folder / STUDY_FILE)))

    @classmethod
    def begun(cls, folder: Path, file: str, table: bytes, kind: str = "wheel") -> Draft:
        """A draft from a table: of wheel tests with a wheel for each that it names, else of plate or shear tests."""
        name = checked_entry(file)
        draft = cls(folder, {"title": Path(name).stem})
        if kind != "wheel":
            draft.attach(name, table, kind)
            return draft
        write_bytes(folder / name, table)
        columns, wheels = _understood(folder / name)
        noise = {channel: _estimated(channel) for channel in columns if channel in OUTCOMES[:1] + OUTCOMES[2:]}
        if not noise and {"load", "normal_force"} <= set(columns):
            noise = {"normal_force": _estimated("normal_force")}
        draft.content |= {
            "model": "M1", "drive": "load", "data": {"file": name, "slip_reference": "shearing"},
            "wheels": {each: {} for each in wheels}, "noise": noise, "priors": {"set": SETS[0]},
        }  # fmt: skip
        draft.save()
        return draft

    @classmethod
    def copied(cls, path: Path, folder: Path) -> Draft:
        """A draft with the study at a path, its tables beside it; results of it stay where they are."""
        draft = cls(folder, _plain(read_toml(path / STUDY_FILE if path.is_dir() else path)))
        beside = path if path.is_dir() else path.parent
        for table in draft.readings():
            source, name = beside / str(table["file"]), Path(str(table["file"])).name
            write_bytes(folder / checked_entry(name), read_bytes(source, MOST_TABLE))
            table["file"] = name
        for each in draft.earlier():
            each["result"] = str((beside / each["result"]).resolve())
        draft.save()
        return draft

    def readings(self) -> list[dict[str, Any]]:
        """Tables of the study that name a file of readings."""
        tables = [self._table("data"), *self._table("soil_tests").values()]
        return [table for table in tables if isinstance(table, dict) and table.get("file")]

    def earlier(self) -> list[dict[str, Any]]:
        """Tables that take a prior from an earlier result."""
        sources = self._table("priors").get("from", [])
        sources = sources if isinstance(sources, list) else [sources]
        return [each for each in sources if isinstance(each, dict) and isinstance(each.get("result"), str)]

    def add(self, what: str) -> None:
        """Add a wheel, to be filled in."""
        if what == "wheel":
            wheels, number = self.content.setdefault("wheels", {}), 1
            while f"Wheel{number}" in wheels:
                number += 1
            wheels[f"Wheel{number}"] = {}
            self.save()

    def save(self) -> None:
        """Write the study file."""
        write_text(self.folder / STUDY_FILE, toml_text(self.content))

    def rewrite(self, text: str) -> None:
        """Take another text of the study file; StudyError where it is none, and then it stays as it was."""
        trial = self.folder / "typed.toml"
        write_text(trial, text)
        self.content = _plain(read_toml(trial))
        self.save()

    @property
    def text(self) -> str:
        """The study file."""
        return read_text(self.folder / STUDY_FILE, 4 * MEGABYTE)

    def files(self) -> dict[str, bytes]:
        """All files of the study by name: the table, those of soil tests, and the study file."""
        names = [checked_entry(str(table["file"])) for table in self.readings()]
        contents = {name: read_bytes(self.folder / name, MOST_TABLE) for name in names}
        return {**contents, STUDY_FILE: toml_text(self.content).encode()}

    def attach(self, name: str, table: bytes, kind: str) -> None:
        """Add a series of soil tests with its readings."""
        file = checked_entry(name)
        if file in self.files():
            raise StudyError(f"the study has a file '{file}' already: give this one another name")
        if kind not in ("plate", "shear"):
            raise StudyError(f"the tests must be plate or shear tests (got {kind!r:.20})")
        write_bytes(self.folder / file, table)
        tests = self.content.setdefault("soil_tests", {})
        series = "plates" if kind == "plate" else "ring"
        number = 1
        while (called := series if number == 1 else f"{series}{number}") in tests:
            number += 1
        tests[called] = {"test": kind, "file": file}
        names = TESTED[kind]
        if kind == "plate" and "data" in self.content:  # the wheel's exponent at zero slip is that of the plates
            tests[called]["tie"] = {"n": "n0"}
            names = names[:2]
        elif "data" in self.content:
            names = ()  # the wheel has laws of c, phi and K
        priors = self.content.setdefault("priors", {})
        if names and "data" in self.content:
            priors.pop("Ks", None)
        priors |= {name: tomllib.loads(f"law = {EXAMPLES[name]}")["law"] for name in names if name not in priors}
        tests[called]["noise"] = {"scatter": {"dist": "halfnorm", "scale": 0.5, "lower": 0.005}}
        self.save()

    def fill(self, form: Form) -> None:
        """Take what a form holds into the tables; what it does not show stays as it is."""
        _put_all(self.content, "", "", form)
        for key in ("model", "drive"):
            if form.get(key) not in (None, KEPT):
                self.content[key] = form[key]
        for table in ("data", "model_options", "sampling"):
            if any(key.startswith(f"{table}/") for key in form):
                self._fill(table, form)
        self._fill_wheels(form)
        self._fill_noise(form)
        self._fill_priors(form)
        self._fill_pooling(form)
        self._fill_tests(form)
        self.save()

    def _fill(self, table: str, form: Form) -> None:
        tables = self.content.setdefault(table, {})
        _put_all(tables, table, f"{table}/", form)
        if not tables:
            del self.content[table]

    def _fill_wheels(self, form: Form) -> None:
        numbers = [number for number in range(100) if f"wheels/{number}/name" in form]
        if not numbers:
            return
        wheels: dict[str, Any] = {}
        for number in numbers:
            name = form[f"wheels/{number}/name"].strip()
            if not name:
                continue
            table = {field.key: field.value(form.get(f"wheels/{number}/{field.key}", "")) for field in fields("wheels")}
            wheels[name] = {key: value for key, value in table.items() if value is not None}
        self.content["wheels"] = wheels

    def _fill_noise(self, form: Form) -> None:
        for channel in OUTCOMES:
            kind = form.get(f"noise/{channel}/form")
            if kind is None or kind == KEPT:
                continue
            noise = self.content.setdefault("noise", {})
            noise.pop(channel, None)
            typed = {
                key: form.get(f"noise/{channel}/{key}", "").strip()
                for key in ("scale", "lower", "sd", "fraction", "floor")
            }
            if kind == "estimate":
                law = {"dist": "halfnorm", **{key: typed[key] for key in ("scale", "lower") if typed[key]}}
                noise[channel] = {"estimate": law}
            elif kind == "sd" and typed["sd"]:
                noise[channel] = typed["sd"]
            elif kind == "fraction":
                noise[channel] = {"fraction": _as_number(typed["fraction"]), "floor": typed["floor"]}

    def _fill_priors(self, form: Form) -> None:
        if "priors/set" not in form:
            return
        priors = self.content.setdefault("priors", {})
        _put(priors, "set", form["priors/set"] or None)
        for name in self.parameters:
            kind = form.get(f"priors/{name}/form")
            if kind is None or kind == KEPT:
                continue
            priors.pop(name, None)
            typed = {
                key: form.get(f"priors/{name}/{key}", "").strip()
                for key in ("loc", "scale", "s", "lower", "upper", "value", "source")
            }
            if kind in LAWS:
                law = {key: _as_number(typed[key]) for key in (*LAWS[kind], "source") if typed[key]}
                priors[name] = {"dist": kind, **law}
            elif kind in ("fixed", "tied") and typed["value"]:
                priors[name] = typed["value"] if kind == "tied" else _as_number(typed["value"])

    def _fill_pooling(self, form: Form) -> None:
        by = form.get("pooling/by")
        if by is None:
            return
        before = self.content.pop("pooling", None)
        if by not in GROUPINGS:
            return
        old = before.get("hierarchical", {}) if isinstance(before, dict) else {}
        old = old if isinstance(old, dict) else {}
        roles = {name: form.get(f"pooling/{name}", "shared") for name in self.parameters}
        pooling: dict[str, Any] = {"by": by}
        if separate := [name for name, role in roles.items() if role == "separate"]:
            pooling["separate"] = separate
        if hierarchical := [name for name, role in roles.items() if role == "hierarchical"]:
            pooling["hierarchical"] = {name: old.get(name, {}) for name in hierarchical}
        self.content["pooling"] = pooling

    def _fill_tests(self, form: Form) -> None:
        tests = self._table("soil_tests")
        for name, table in list(tests.items()):
            if form.get(f"soil_tests/{name}/remove") == "true":
                del tests[name]
            elif f"soil_tests/{name}/test" in form and isinstance(table, dict):
                _put_all(table, "soil_tests", f"soil_tests/{name}/", form)
        if not tests:
            self.content.pop("soil_tests", None)

    @property
    def models(self) -> tuple[str, ...]:
        """Models that a form can name."""
        return (*MODELS, *OURS)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Parameters of the soil that have a prior in the form, in the package's order."""
        model, priors = self.content.get("model", "M1"), self._table("priors")
        driven = isinstance(model, str) and model in MODELS and "data" in self.content
        names = list(MODELS[model].parameters) if driven else []
        if "kc" in priors or "kphi" in priors:
            names = [each for name in names for each in (("kc", "kphi") if name == "Ks" else (name,))]
        own = [name for name in priors if name in PARAMETERS and name not in names]
        return (*names, *own)

    def _table(self, name: str) -> dict[str, Any]:
        table = self.content.get(name)
        return table if isinstance(table, dict) else {}

    def priors(self) -> dict[str, Entry]:
        """Laws and values of the parameters as far as they are understood: the set's, and the form's own."""
        stated, chosen = self._table("priors"), self._table("priors").get("set", SETS[0])
        entries: dict[str, Entry] = {}
        if chosen in SETS:
            entries = {**prior_set(chosen), **prior_set(chosen, load_effect=True)}
        for name in self.parameters:
            if name in stated:
                entries.pop(name, None)
                try:
                    entries[name] = prior_entry(name, stated[name], bare=False)
                except BayesterraError:
                    continue
        return {name: entries[name] for name in self.parameters if name in entries}

    def wheels(self) -> list[tuple[str, dict[str, str]]]:
        """Names and texts of the wheels, for the form."""
        wheels = self._table("wheels")
        return [(name, _texts("wheels", table)) for name, table in wheels.items() if isinstance(table, dict)]

    def texts(self, table: str) -> dict[str, str]:
        """Texts of the fields of a table, for the form."""
        return _texts(table, self._table(table) if table else self.content)

    def tests(self) -> list[tuple[str, dict[str, str]]]:
        """Names and texts of the series of soil tests."""
        return [(name, _texts("soil_tests", table)) for name, table in self._table("soil_tests").items()]

    def noises(self) -> Iterator[tuple[str, str, dict[str, str]]]:
        """Channel, form and texts of the noise of each outcome."""
        noise = self._table("noise")
        for channel in OUTCOMES:
            stated = noise.get(channel)
            scale, lower = TYPICAL[channel]
            texts = {"scale": scale, "lower": lower, "sd": scale, "fraction": "0.03", "floor": lower}
            if stated is None:
                yield channel, "", texts
            elif isinstance(stated, str):
                yield channel, "sd", {**texts, "sd": stated}
            elif isinstance(stated, dict) and set(stated) == {"fraction", "floor"}:
                yield channel, "fraction", {**texts, **{key: str(value) for key, value in stated.items()}}
            elif (
                isinstance(stated, dict)
                and set(stated) == {"estimate"}
                and _is_plain(stated["estimate"], ("scale", "lower"), "halfnorm")
            ):
                yield channel, "estimate", {**texts, **{k: str(v) for k, v in stated["estimate"].items()}}
            else:
                yield channel, KEPT, texts

    def prior_form(self, name: str) -> tuple[str, dict[str, str]]:
        """Form and texts of the prior of a parameter: "" where it is that of the set."""
        stated = self._table("priors").get(name)
        if stated is None:
            return "", {}
        if isinstance(stated, str) and stated in PARAMETERS:
            return "tied", {"value": stated}
        if not isinstance(stated, dict):
            return "fixed", {"value": str(stated)}
        dist = stated.get("dist")
        if isinstance(dist, str) and dist in LAWS and _is_plain(stated, LAWS[dist], dist):
            return dist, {key: str(value) for key, value in stated.items() if key != "dist"}
        return KEPT, {}

    def role(self, name: str) -> str:
        """Role of a parameter among groups."""
        pooling = self._table("pooling")
        return next((role for role in ROLES if name in (pooling.get(role) or ())), ROLES[0])


def _understood(path: Path) -> tuple[list[str], list[str]]:
    """Channels and wheels that a table names; the usual ones where the form has to say first how it is to be read."""
    try:
        read = read_table(path)
    except StudyError as error:
        if "sheet" not in str(error) and "decimal" not in str(error):
            raise
        return list(CHANNELS), ["Wheel1"]
    columns: dict[str, str] = {}
    for header in map(str, read.columns):
        columns.setdefault(known_column(header, (*CHANNELS, "wheel"))[0], header)
    named = list(dict.fromkeys(map(str, read[columns["wheel"]]))) if "wheel" in columns else []
    return list(columns), [name for name in named[:40] if name] or ["Wheel1"]


def _texts(table: str, content: Mapping[str, Any]) -> dict[str, str]:
    return {field.key: field.shown(content.get(field.key)) for field in fields(table)}


def _is_plain(stated: object, keys: tuple[str, ...], dist: str) -> bool:
    return isinstance(stated, dict) and stated.get("dist") == dist and set(stated) <= {*keys, "dist", "source"}


def _estimated(channel: str) -> dict[str, Any]:
    scale, lower = TYPICAL[channel]
    return {"estimate": {"dist": "halfnorm", "scale": scale, "lower": lower}}


def _put_all(table: dict[str, Any], of: str, prefix: str, form: Form) -> None:
    """Take the fields of a table that a form holds."""
    for field in fields(of):
        if f"{prefix}{field.key}" in form:
            _put(table, field.key, field.value(form[f"{prefix}{field.key}"]))


def _put(table: dict[str, Any], key: str, value: Any) -> None:
    if value is None:
        table.pop(key, None)
    else:
        table[key] = value


def _as_number(typed: str) -> Any:
    try:
        return float(typed)
    except ValueError:
        return typed


def _plain(content: Any) -> Any:
    """The content of a study file with days as texts."""
    if isinstance(content, dict):
        return {key: _plain(value) for key, value in content.items()}
    if isinstance(content, list):
        return [_plain(value) for value in content]
    return content.isoformat() if isinstance(content, datetime.date | datetime.time) else content


def toml_text(content: Mapping[str, Any]) -> str:
    """Text of a study file: keys first, then its tables, wheels and soil tests each as a table of their own."""
    keys = {key: value for key, value in content.items() if not isinstance(value, dict)}
    lines = list(assignments(keys))
    for name, table in ((key, value) for key, value in content.items() if isinstance(value, dict)):
        apart = {
            key: value for key, value in table.items() if name in ("wheels", "soil_tests") and isinstance(value, dict)
        }
        rest = {key: value for key, value in table.items() if key not in apart}
        if rest or not apart:
            lines += ["", f"[{_key(name)}]", *assignments(rest)]
        for key, inner in apart.items():
            lines += ["", f"[{_key(name)}.{_key(key)}]", *assignments(inner)]
    return "\n".join(lines) + "\n"


def _key(name: str) -> str:
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)
