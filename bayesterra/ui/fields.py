"""Fields of forms, made from the schema of study files: kind, unit, default and meaning of every key."""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, partial
from typing import Any, get_args, get_type_hints

from pydantic import BeforeValidator

from bayesterra.study import schema
from bayesterra.study.units import text

TABLES: Mapping[str, type[schema.Table]] = {
    "": schema.StudyContent,
    "data": schema.DataTable,
    "wheels": schema.WheelTable,
    "model_options": schema.ModelOptions,
    "sampling": schema.SamplingOptions,
    "soil_tests": schema.SoilTestTable,
}
"""Classes of the tables that have forms."""
OF_STUDY = ("title", "soil", "date")
EXAMPLES = {"m": 0.1, "N": 80.0, "Pa": 2000.0}
HIDDEN = ("file", "table")
"""Keys that the page fills in itself."""


@dataclass(frozen=True)
class Field:
    """A key of a study file in a form.

    Attributes
    ----------
    kind : ``text``, ``choice``, ``switch``, ``number``, ``count`` or ``list``.
    unit : of a quantity; its text has one.
    default : as a study file would have it; empty where there is none.
    """

    key: str
    kind: str
    meaning: str
    unit: str = ""
    default: str = ""
    choices: tuple[str, ...] = ()
    required: bool = False

    @property
    def label(self) -> str:
        """Name beside the field."""
        return self.key.replace("_", " ")

    @property
    def example(self) -> str:
        """What an empty field means, or a text that the field takes."""
        if self.default:
            return self.default
        return f"e.g. {text(EXAMPLES[self.unit], self.unit)}" if self.unit in EXAMPLES else ""

    def value(self, typed: str) -> Any:
        """What a study file holds for what was typed; None where nothing was. Text that is wrong stays as it is."""
        plain = typed.strip()
        if not plain:
            return None
        if self.kind == "switch":
            return plain == "true"
        if self.kind == "list":
            items = [item.strip() for item in plain.split(",")]
            return items if self.unit else [_as_number(item) for item in items]
        if self.kind in ("count", "number") and not self.unit:
            return _as_number(plain)
        return plain

    def shown(self, value: Any) -> str:
        """Text of a value in its field."""
        if value is None:
            return ""
        if isinstance(value, bool):
            return "true" if value else "false"
        if isinstance(value, list | tuple):
            return ", ".join(map(str, value))
        return str(value)


def _as_number(typed: str) -> Any:
    if re.fullmatch(r"[-+]?\d{1,15}", typed):
        return int(typed)
    try:
        return float(typed)
    except ValueError:
        return typed


@cache
def fields(table: str) -> tuple[Field, ...]:
    """Fields of a table; "" for the keys at the top that are texts."""
    whole, of = json.loads(schema.json_schema()), TABLES[table]
    shape = whole if not table else whole["$defs"][of.__name__]
    named = [field.name for field in dataclasses.fields(of)]
    keys = OF_STUDY if not table else [key for key in named if key in shape["properties"]]
    required = shape.get("required", [])
    made = (_field(key, shape["properties"][key], _unit(of, key), required) for key in keys if key not in HIDDEN)
    return tuple(field for field in made if field is not None)


def _field(key: str, shape: Mapping[str, Any], unit: str, required: list[str]) -> Field | None:
    kinds = [each for each in shape.get("anyOf", [shape]) if each.get("type") != "null"]
    meaning, default = str(shape.get("description", "")).replace("``", ""), shape.get("default")
    choices = next((tuple(each["enum"]) for each in kinds if "enum" in each), ())
    types = {each.get("type") for each in kinds}
    shown = "" if default in (None, "", {}, []) else _default(default, unit)
    if types & {"object"}:
        return None  # tables within: they have forms of their own, or the text of the study
    kind = "choice" if choices else "switch" if "boolean" in types else "list" if "array" in types else ""
    kind = kind or ("count" if "integer" in types else "number" if "number" in types else "text")
    return Field(key, kind, meaning, unit, shown, choices, key in required)


def _default(value: Any, unit: str) -> str:
    if isinstance(value, list):
        return ", ".join(map(str, value))
    if isinstance(value, bool):
        return "true" if value else "false"
    return str(text(value, unit)) if unit else str(value)


def _unit(of: type, key: str) -> str:
    """Unit of a key: that of the check by which its quantity is read; "" for what has none."""
    todo: list[Any] = [get_type_hints(of, include_extras=True)[key]]
    while todo:
        each = todo.pop()
        if isinstance(each, BeforeValidator) and isinstance(each.func, partial) and len(each.func.args) == 1:
            return str(each.func.args[0])
        todo += [*get_args(each), *getattr(each, "__metadata__", ())]
    return ""
