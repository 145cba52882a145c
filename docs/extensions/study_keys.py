"""Every key of the study file as tables, made from the schema when the site is built: ``{study-keys}``.

Kind, default, limits and meaning are those of the JSON schema, which ``bayesterra schema`` prints; units are
those of the checks. Tables that have a reader of their own ([noise], [priors], …) are described by the classes
that hold them, beside what the template of ``bayesterra init`` says of them.
"""

import dataclasses
import inspect
import json
import re
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any, get_args, get_type_hints

from docutils import nodes
from pydantic import BeforeValidator
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

import bayesterra.study
from bayesterra.stats.laws import Law
from bayesterra.study import entries, schema
from bayesterra.study.groups import Pooling, Population
from bayesterra.study.model_errors import Discrepancy, Ripple, SlipError
from bayesterra.study.noise import Noise
from bayesterra.study.priors import Source

Row = tuple[str, str, str, str]
"""Key, kind and unit, default, meaning."""
TEMPLATE = Path(bayesterra.study.__file__).with_name("template.toml")

_OPEN: dict[str, list[tuple[str, type | None]]] = {
    "noise": [("noise.<channel>", Noise)],
    "discrepancy": [("discrepancy.<channel>", Discrepancy)],
    "ripple": [("ripple.<channel>", Ripple)],
    "slip": [("slip", SlipError)],
    "priors": [("priors", entries.StatedPriors), ("priors.from", Source), ("priors.<parameter>", Law)],
    "pooling": [("pooling", Pooling), ("pooling.hierarchical.<parameter>", Population)],
}
"""Classes that hold the tables with readers of their own."""
_KEYS = {"law": "estimate", "size": "sd", "channel": "", "arguments": "", "shape": "loc, scale, …"}
_KEYS |= {"entries": "<parameter>", "chosen": "set", "sources": "from", "mixtures": "mixture"}
_KEYS |= {"reference": "reference_sinkage"}
"""Key of the file for an attribute of such a class; empty where the attribute is no key."""


_QUANTITIES = ("sd", "floor", "resolution", "lower", "upper", "shape")
"""Attributes of such classes that a study file gives with the unit of their channel or parameter."""


def _kind(shape: dict[str, Any]) -> str:
    """Kind of a value in words, from its JSON schema."""
    if "$ref" in shape:
        return "table"
    if "enum" in shape:
        return ", ".join(f"``{json.dumps(each, ensure_ascii=False)}``" for each in shape["enum"])
    if "anyOf" in shape:
        kinds = [_kind(each) for each in shape["anyOf"] if each.get("type") != "null"]
        return "number or text" if kinds == ["text", "number"] else " or ".join(dict.fromkeys(kinds))
    if shape.get("type") == "array":
        return f"list of {_kind(shape['items'])}" if "items" in shape else "list"
    names = {"string": "text", "number": "number", "integer": "whole number", "boolean": "true, false"}
    return names.get(shape.get("type", ""), "table")


def _limits(shape: dict[str, Any]) -> str:
    least, most, above = (shape.get(key) for key in ("minimum", "maximum", "exclusiveMinimum"))
    above = shape.get("gt") if above is None else above
    words = [f"at least {least:,}".replace(",", " ") if least is not None else ""]
    words += [f"at most {most:,}".replace(",", " ") if most is not None else ""]
    words += [f"above {above:g}" if above is not None else ""]
    words += [f"a multiple of {shape['multipleOf']}" if "multipleOf" in shape else ""]
    return ", ".join(word for word in words if word)


def _default(key: str, shape: dict[str, Any], required: list[str]) -> str:
    """Default as a study file would have it."""
    if key in required:
        return "required"
    value = shape.get("default")
    if value in (None, "", {}) or isinstance(value, dict):
        return "–"
    return f"``{json.dumps(value, ensure_ascii=False)}``"


def unit(of: type, key: str) -> str:
    """Unit of a key: that of the check by which its quantity is read; "" for what has none."""
    hint = get_type_hints(of, include_extras=True)[key]
    todo = [hint]
    while todo:
        each = todo.pop()
        if isinstance(each, BeforeValidator):
            reader = each.func
            if isinstance(reader, partial) and reader.func in (schema._quantity, schema._range):
                return str(reader.args[0])
            if reader is schema._load_range:
                return "N"
        todo += [*get_args(each), *getattr(each, "__metadata__", ())]
    return ""


def _shape_rows(shape: dict[str, Any], of: type) -> list[Row]:
    rows = []
    for key in (name for name in of.__dataclass_fields__ if name in shape["properties"]):
        value = shape["properties"][key]
        measured = unit(of, key)
        kind = f"text with a unit of {measured}" if measured else _kind(value)
        limits = _limits(value)
        rows.append(
            (
                f"``{key}``",
                f"{kind}, {limits}" if limits else kind,
                _default(key, value, shape.get("required", [])),
                value.get("description", ""),
            )
        )
    return rows


def _described(of: type) -> dict[str, str]:
    """Meaning of every attribute that a class's docstring lists."""
    found: dict[str, str] = {}
    names: list[str] = []
    for line in inspect.cleandoc(of.__doc__ or "").splitlines():
        entry = re.fullmatch(r"([\w, ]+) : (.*)", line)
        if entry:
            names = entry[1].split(", ")
            found |= dict.fromkeys(names, entry[2])
        elif line.startswith("    ") and names:
            found |= {name: f"{found[name]} {line.strip()}" for name in names}
        else:
            names = []
    return found


def _kind_of(field: "dataclasses.Field[Any]") -> str:
    """Kind of a value in words, from the type of the attribute that holds it."""
    if field.name in _QUANTITIES:
        return "text with a unit"
    if field.name == "size":
        return "text with a unit, or ``{ estimate = { dist = … } }``"
    for word, kind in (("Law", "``{ dist = … }``"), ("Mapping", "table"), ("tuple", "list"), ("float", "number")):
        if word in str(field.type):
            return kind
    return "text"


def _class_rows(of: type) -> list[Row]:
    """Keys of a table that a class holds, by its docstring and its fields' types and defaults."""
    words = _described(of)
    rows = []
    for field in dataclasses.fields(of):
        key = _KEYS.get(field.name, field.name)
        if not key or (field.name not in words and of is not SlipError):
            continue
        default = "–" if field.default in (dataclasses.MISSING, None, "", ()) else f"``{field.default}``"
        default = "none" if default in ("``inf``", "``-inf``") else default
        meaning = words.get(field.name, "standard deviation of the error")
        rows.append((f"``{key}``", _kind_of(field), default, meaning[:1].upper() + meaning[1:]))
    return rows


def template_of(table: str) -> str:
    """Part of the template of ``bayesterra init`` that stands under the heading of a table."""
    text = TEMPLATE.read_text(encoding="utf-8")
    found = re.search(rf"^(?:# )?\[{re.escape(table)}\].*?(?=^(?:# )?\[(?!\[)|\Z)", text, re.M | re.S)
    return found[0].rstrip() + "\n" if found else ""


def tables() -> Iterator[tuple[str, str, list[Row], str]]:
    """Heading, meaning, rows and template of every table of a study file."""
    content = json.loads(schema.json_schema())
    parts = content["$defs"]
    yield "", "", _shape_rows(content, schema.StudyContent), ""
    for key in schema.StudyContent.__dataclass_fields__:
        value = content["properties"][key]
        meaning = value.get("description", "")
        found = re.search(r'"#/\$defs/(\w+)"', json.dumps({k: v for k, v in value.items() if k != "default"}))
        name = found[1] if found else ""
        heading = f"{key}.<name>" if "additionalProperties" in value and name else key
        if name in parts:
            yield heading, meaning, _shape_rows(parts[name], getattr(schema, name)), template_of(key)
        for number, (place, of) in enumerate(_OPEN.get(key, ())):
            yield place, meaning if not number else "", _class_rows(of), "" if number else template_of(key)


def markdown() -> str:
    """The whole reference as Markdown."""
    lines: list[str] = []
    for heading, meaning, rows, template in tables():
        lines += [f"## `[{heading}]`" if heading else "## Before the first table", "", meaning, ""]
        titles = ("key", "kind and unit", "default", "meaning")
        lines += [":::{table}", ":class: study-keys", ":align: left", ""]
        lines += [f"| {' | '.join(titles)} |", "|---|---|---|---|"]
        lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
        lines += [":::", ""]
        if template:
            lines += ["The template says:", "", "```toml", template.rstrip(), "```", ""]
    return "\n".join(lines)


class StudyKeys(SphinxDirective):
    """Reference of the study file in place of the directive."""

    def run(self) -> list[nodes.Node]:
        """Parse the tables where the directive stands; the page is made again when they change."""
        for module in (schema, entries):
            self.env.note_dependency(module.__file__)
        self.env.note_dependency(str(TEMPLATE))
        return self.parse_text_to_nodes(markdown(), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the directive."""
    app.add_directive("study-keys", StudyKeys)
    return {"parallel_read_safe": True}
