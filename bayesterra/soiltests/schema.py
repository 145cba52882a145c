"""Shape of a soil-test file; quantities are text with a unit, and what they are called."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from typing import Annotated, Any, Literal

from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    StrictBool,
    TypeAdapter,
    ValidationInfo,
    model_validator,
)
from pydantic.dataclasses import dataclass

from bayesterra.errors import StudyError, check_keys, known
from bayesterra.models.soil_tests import SOIL_TESTS
from bayesterra.parameters import OFFSET, PARAMETERS, Channel, Parameter
from bayesterra.stats.laws import Law
from bayesterra.study import entries
from bayesterra.study.schema import Number, SamplingOptions, Text, bare_numbers, checked_by, gathered
from bayesterra.study.units import quantity

KINDS = {kind: model.parameters for kind, model in SOIL_TESTS.items()}
"""Soil parameters by kind of test."""
NOISE = {"plate": ("scatter", "memory", "seating", "sinkage_offset"), "shear": ("scatter", "memory")}
"""Parameters of how tests differ from the mean curve, by kind of test."""

_ALL = (
    replace(PARAMETERS["kc"], unit="kPa m/m^n", description="cohesive modulus"),
    replace(PARAMETERS["kphi"], unit="kPa/m^n", description="frictional modulus"),
    Parameter("n", "n", r"n", "-", 1.0, "", "sinkage exponent"),
    *(PARAMETERS[name] for name in KINDS["shear"]),
    Parameter("scatter", "σ_t", r"\sigma_t", "-", 1.0, "", "scatter of log stress from test to test"),
    Parameter("memory", "ℓ", r"\ell", "-", 1.0, "", "log distance over which it lasts"),
    Parameter("seating", "σ_0", r"\sigma_0", "mm", 1e-3, "m", "scatter of the zero of sinkage"),
    replace(PARAMETERS[OFFSET], description="zero error of sinkage common to all tests"),
)
QUANTITIES: dict[str, Parameter] = {parameter.name: parameter for parameter in _ALL}
"""Everything that a soil test may estimate, in the order of its posteriors."""

COLUMNS: dict[str, Channel] = {
    channel.name: channel
    for channel in (
        Channel("plate_diameter", "2b", r"2b", "mm", 1e-3, "m", "plate diameter"),
        Channel("sinkage", "z", r"z", "mm", 1e-3, "m", "sinkage"),
        Channel("force", "F", r"F", "N", 1.0, "N", "force on the plate"),
        Channel("pressure", "p", r"p", "kPa", 1e3, "Pa", "pressure under the plate"),
        Channel("normal_stress", "σ", r"\sigma", "kPa", 1e3, "Pa", "normal stress"),
        Channel("displacement", "j", r"j", "mm", 1e-3, "m", "shear displacement"),
        Channel("shear_stress", "τ", r"\tau", "kPa", 1e3, "Pa", "shear stress"),
    )
}
"""Columns that a table of readings may have, beside ``test`` and ``use``."""
PATHS = {"plate": COLUMNS["sinkage"], "shear": COLUMNS["displacement"]}
LEVELS = {
    "plate": Channel("plate_radius", "b", r"b", "mm", 1e-3, "m", "plate radius"),
    "shear": COLUMNS["normal_stress"],
}
STRESSES = {"plate": COLUMNS["pressure"], "shear": COLUMNS["shear_stress"]}
"""Axis of a curve, what sets tests apart, and the answer of the soil, by kind of test."""

_CONFIG = ConfigDict(extra="forbid", arbitrary_types_allowed=True)
_SOIL = tuple(dict.fromkeys(name for names in KINDS.values() for name in names))
REFERENCE = "reference_sinkage"
"""Key of [priors]: laws of k_c and k_φ are those of k_c z^n and k_φ z^n at this sinkage."""
_NOISE = NOISE["plate"]


def _entry(name: str, value: object, allowed: tuple[str, ...], *, bare: bool) -> Law | float:
    if name == REFERENCE and name in allowed:
        return quantity(value, "m", name, bare=bare)
    dimension = QUANTITIES[known("parameter", name, allowed)].dimension
    if isinstance(value, Law):
        return value
    if isinstance(value, Mapping):
        return entries.law(name, entries.table(value, name), dimension, bare=bare)
    return quantity(value, dimension, name, bare=bare)


def _entries(allowed: tuple[str, ...], value: object, info: ValidationInfo) -> dict[str, Law | float]:
    items = entries.table(value, str(info.field_name)).items()
    return {name: _entry(name, item, allowed, bare=bare_numbers(info)) for name, item in items}


def _values(value: object, info: ValidationInfo) -> dict[str, float]:
    content = entries.table(value, str(info.field_name))
    values = {name: _entry(name, item, _SOIL, bare=bare_numbers(info)) for name, item in content.items()}
    if laws := [name for name, item in values.items() if isinstance(item, Law)]:
        raise StudyError(f"'{laws[0]}' must be a value (got a law)")
    return {name: float(item) for name, item in values.items() if not isinstance(item, Law)}


def _range(dimension: str, value: object, info: ValidationInfo) -> tuple[float, float] | None:
    name = str(info.field_name)
    if value is None:
        return None
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise StudyError(f"'{name}' must be two quantities, lowest and highest (got {value!r})")
    low, high = (quantity(item, dimension, name, bare=bare_numbers(info)) for item in value)
    if not 0 <= low < high:
        raise StudyError(f"'{name}' must rise and begin at 0 or above (got {value[0]} and {value[1]})")
    return low, high


Range = tuple[float, float] | None


@dataclass(frozen=True, config=_CONFIG)
class Table:
    """A table of a soil-test file: no other keys than its own."""

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, content: Any) -> Any:
        check_keys(content if isinstance(content, Mapping) else (), cls.__dataclass_fields__)
        return content


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class DataTable(Table):
    """Place of the readings, and ranges of those that are used.

    Attributes
    ----------
    pressure_range : readings of plates outside it are left out, Pa.
    displacement_range : readings of shear tests outside it are left out, m.
    spacing : of readings of one test that are closer in log sinkage (displacement) only the first is used.
    """

    file: Text
    kind: Literal["measured", "simulated", "digitised"] = "measured"
    source: Text = ""
    pressure_range: Annotated[Range, BeforeValidator(partial(_range, "Pa"))] = None
    displacement_range: Annotated[Range, BeforeValidator(partial(_range, "m"))] = None
    spacing: Annotated[Number, Field(ge=0)] = 0.05


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class NoiseTable(Table):
    """Scatter of tests: laws of unknown parameters, values of fixed ones; see ``scatter.Scatter``."""

    independent: StrictBool = False
    values: Annotated[dict[str, Law | float], PlainValidator(partial(_entries, _NOISE))] = Field(default_factory=dict)


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class ReferenceTable(Table):
    """Published or true values, SI, and where they come from."""

    source: Text = ""
    values: Annotated[dict[str, float], BeforeValidator(_values)] = Field(default_factory=dict)


Reference = Annotated[ReferenceTable | None, BeforeValidator(partial(gathered, ("source",)))]


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class Content(Table):
    """All tables of a soil-test file."""

    test: Literal["plate", "shear"]
    title: Text = ""
    soil: Text = ""
    data: DataTable
    noise: Annotated[NoiseTable, BeforeValidator(partial(gathered, ("independent",)))] = NoiseTable()
    priors: Annotated[dict[str, Law | float], PlainValidator(partial(_entries, (*_SOIL, REFERENCE)))] = Field(
        default_factory=dict
    )
    published: Reference = None
    truth: Reference = None
    sampling: SamplingOptions = SamplingOptions(target_ess=2000)


_ADAPTER = TypeAdapter(Content)


def checked(tables: Mapping[str, Any], *, bare: bool) -> Content:
    """Check the tables of a soil-test file, as :func:`bayesterra.study.schema.checked` those of a study."""
    return checked_by(_ADAPTER, tables, bare=bare)
