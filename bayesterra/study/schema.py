"""The shape of a study: which tables and keys there are, of which kind, and what is wrong with others.

Checked values are SI. The same tables describe study files, where every dimensional value is text with a
unit, and calls from Python, where numbers are SI values (``bare`` in the validation context).
"""

import datetime
import json
import re
import tomllib
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import asdict, is_dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import pandas as pd
from pydantic import (
    AfterValidator,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainValidator,
    StrictBool,
    StrictInt,
    StrictStr,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    model_validator,
)
from pydantic.dataclasses import dataclass
from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import ArgsKwargs, ErrorDetails

from bayesterra.errors import StudyError, checked_name, checked_text, did_you_mean, errors_in, known, suggestion
from bayesterra.models import MODELS, OwnModel
from bayesterra.parameters import MODEL_PARAMETERS, PARAMETERS, whole_and_part
from bayesterra.runtime.reading import MOST_TOML, check_depth, read_text, reason
from bayesterra.study import entries
from bayesterra.study.entries import StatedPriors
from bayesterra.study.groups import Pooling, pooling_table
from bayesterra.study.model_errors import Discrepancy, Ripple, SlipError, discrepancies, ripples, slip_error
from bayesterra.study.noise import Noise
from bayesterra.study.own import installed_models, loaded_model
from bayesterra.study.units import quantity

T = TypeVar("T")
_CONFIG = ConfigDict(extra="forbid", arbitrary_types_allowed=True, use_attribute_docstrings=True)


def bare_numbers(info: ValidationInfo) -> bool:
    """True where numbers are SI values: they are unless a file is read."""
    return info.context is None or bool(info.context.get("bare"))


def _quantity(dimension: str, value: object, info: ValidationInfo) -> float | None:
    return None if value is None else quantity(value, dimension, str(info.field_name), bare=bare_numbers(info))


def _parameters(names: tuple[str, ...], value: object, info: ValidationInfo) -> dict[str, float]:
    items = entries.table(value, str(info.field_name)).items()
    return {n: entries.parameter_value(n, item, names, bare=bare_numbers(info)) for n, item in items}


def _stated(value: object, info: ValidationInfo) -> dict[str, float]:
    """Values of parameters, of groups too: ``K[Wh11]``, whose names a study with groups checks."""
    items = entries.table(value, str(info.field_name)).items()
    for name, _ in items:
        known("parameter", whole_and_part(name)[0], PARAMETERS)
    return {n: entries.parameter_value(n, item, (n,), bare=bare_numbers(info)) for n, item in items}


def gathered(own: tuple[str, ...], value: object) -> object:
    """Gather what stands in a table beside its ``own`` keys under ``values``."""
    if not isinstance(value, Mapping) or "values" in value:
        return value
    values = {key: item for key, item in value.items() if key not in own}
    return {**{key: value[key] for key in own if key in value}, "values": values}


def _plain(value: object) -> object:
    """Let objects made in Python pass as tables."""
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value


def _load_range(value: object, info: ValidationInfo) -> tuple[float, float] | None:
    if value is None:
        return None
    low, high = _two(value, "load_range", "N", 'two loads, e.g. ["10 N", "40 N"]', bare=bare_numbers(info))
    if not 0 < low < high:
        raise StudyError(f"'load_range' must rise and be above 0 (got {low:g} N and {high:g} N)")
    return low, high


def _two(value: object, name: str, dimension: str, what: str, *, bare: bool = False) -> tuple[float, float]:
    if not isinstance(value, list | tuple) or len(value) != 2:
        raise StudyError(f"'{name}' must be {what} (got {value!r})")
    first, second = (quantity(item, dimension, name, bare=bare) for item in value)
    return first, second


def _model(value: object, info: ValidationInfo) -> str | OwnModel:
    """Name of a model of Ding et al. 2015, or one's own model."""
    if isinstance(value, OwnModel) or (isinstance(value, str) and value in MODELS):
        return value
    if isinstance(value, Mapping):
        return loaded_model(value, bare=bare_numbers(info))
    if isinstance(value, str) and value in installed_models():
        return loaded_model({"use": value}, bare=bare_numbers(info))
    *others, last = (f"'{name}'" for name in (*MODELS, *installed_models()))
    raise StudyError(f"'model' must be {', '.join(others)} or {last} (got {_shortened(value)})")


def _named(value: object) -> object:
    """Wheels, whose names stand in tables, plots and files."""
    if isinstance(value, Mapping):
        for name in value:
            checked_name(str(name), "the name of a wheel")
    return value


def _series(value: object) -> object:
    """Soil tests, whose names end the names of their parameters."""
    for name in value if isinstance(value, Mapping) else ():
        if not re.fullmatch(r"[A-Za-z][\w-]*", str(name)) or name in ("mean", "spread"):
            raise StudyError(f"the name of a soil test must be a word other than mean and spread (got {name!r:.40})")
    return value


def _measure(dimension: str) -> BeforeValidator:
    """A quantity of a dimension, which JSON schemas show as text with a unit."""
    words = f"text with a unit of {dimension}, a number from Python" if dimension else "a number, or text with % or so"
    return BeforeValidator(
        partial(_quantity, dimension), json_schema_input_type=Annotated[str | float, Field(description=words)]
    )


_MODELS = (
    f"Model of Ding et al. 2015: {'; '.join(f'``{n}`` {kind.equations}' for n, kind in MODELS.items())}."
    ' Another by a table [model]: ``use = "module:Class"`` or the name of an installed one, and what makes it.'
)
_Open, _Values = dict[str, Any], dict[str, str | float]


def _entries(reader: Callable[..., Any]) -> PlainValidator:
    """A table that has a reader of its own."""
    return PlainValidator(lambda value, info: reader(value, bare=bare_numbers(info)), json_schema_input_type=_Open)


Text = Annotated[StrictStr, AfterValidator(lambda text, info: checked_text(text, str(info.field_name)))]
Length = Annotated[float, _measure("m")]
Force = Annotated[float, _measure("N")]
Mass = Annotated[float, _measure("kg")]
Acceleration = Annotated[float, _measure("m/s^2")]
Number = Annotated[float, _measure("")]
SoilValues = Annotated[
    dict[str, float], BeforeValidator(partial(_parameters, MODEL_PARAMETERS), json_schema_input_type=_Values)
]
AnyValues = Annotated[dict[str, float], BeforeValidator(_stated, json_schema_input_type=_Values)]
Method = Literal["IM1", "IM2", "IM3", "joint"]


@dataclass(frozen=True, config=_CONFIG)
class Table:
    """A table of a study: strict types, and no other keys than its own."""

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, content: Any) -> Any:
        """Name unknown keys before anything else, as a mistyped key is also a missing one."""
        keys = list(cls.__dataclass_fields__)
        for key in content if isinstance(content, Mapping) else ():
            if key not in keys:
                hint = suggestion(str(key), keys) or _home(str(key)) or did_you_mean(str(key), keys)
                raise StudyError(f"unknown key '{key}'{hint}")
        return content


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class DataTable(Table):
    """Place of the measurements, and what their table leaves open."""

    file: Text
    """Table of measurements, a path relative to the study file: CSV, or Excel with the extra ``excel``."""
    sheet: Text = ""
    """Sheet of an Excel workbook that has several."""
    decimal: Literal[",", "."] | None = None
    """Sign that separates decimals, where cells such as ``1,234`` leave it open."""
    slip_reference: Literal["rim", "tip", "shearing"]
    """Radius behind the slip column: ``rim`` r, ``tip`` r + h, or ``shearing`` r_s."""
    sinkage_reference: Literal["rim", "tip"] = "rim"
    """Zero of the sinkage column: the rim, or the ``tip`` of the lugs, when h is subtracted."""
    kind: Literal["measured", "simulated", "digitised"] = "measured"
    """Origin of the readings, said on every page that shows them."""
    source: Text = ""
    """Source of the readings: publication, table, transcriber."""


def _range(dimension: str, value: object, info: ValidationInfo) -> tuple[float, float] | None:
    name = str(info.field_name)
    if value is None:
        return None
    low, high = _two(value, name, dimension, "two quantities, lowest and highest", bare=bare_numbers(info))
    if not 0 <= low < high:
        raise StudyError(f"'{name}' must rise and begin at 0 or above (got {low:g} and {high:g} {dimension})")
    return low, high


def _frame(value: object, *, bare: bool) -> object:
    """A table of readings that Python gives in place of a file."""
    if not isinstance(value, pd.DataFrame | None):
        raise StudyError(f"unknown key 'table' (readings stand in 'file'; got {_shortened(value)})")
    return value


def _ranged(dimension: str) -> BeforeValidator:
    return BeforeValidator(partial(_range, dimension), json_schema_input_type=list[str])


Range = tuple[float, float] | None
_POOLING = BeforeValidator(lambda by, info: pooling_table(by, bare=bare_numbers(info)), json_schema_input_type=_Open)
_TWO_SLIPS = BeforeValidator(partial(_two, name="transition_slips", dimension="", what="two slips, e.g. [0.15, 0.5]"))


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class SoilTestTable(Table):
    """A series of plate or shear tests, as :class:`bayesterra.study.soil_tests.SoilTest`."""

    test: Literal["plate", "shear"]
    """Kind of the tests."""
    file: Text = ""
    """Readings, one row each, a path relative to the study file; from Python ``table`` in its place."""
    table: Annotated[Any, _entries(_frame)] = None
    """Readings as a DataFrame, from Python alone."""
    kind: Literal["measured", "simulated", "digitised"] = "measured"
    """Origin of the readings."""
    source: Text = ""
    """Source of the readings."""
    pressure_range: Annotated[Range, _ranged("Pa")] = None
    """Lowest and highest pressure; readings of plates outside are left out."""
    displacement_range: Annotated[Range, _ranged("m")] = None
    """Least and greatest displacement; readings of shear tests outside are left out."""
    spacing: Annotated[Number, Field(ge=0)] = 0.05
    """Step in log sinkage (displacement): of readings of one test that are closer the first is used."""
    tie: dict[str, StrictStr] = Field(default_factory=dict)
    """Parameter of the study by parameter of the test, where the two have other names."""
    noise: Annotated[dict[str, Any], _entries(entries.scatter)] = Field(default_factory=dict)
    """Scatter of the tests: laws of unknown parameters, values of fixed ones, and ``independent``."""


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class WheelTable(Table):
    """A wheel, as :class:`bayesterra.models.Wheel`."""

    radius: Length
    """Radius r without lugs."""
    width: Length
    """Width b."""
    lug_height: Length = 0.0
    """Height h of the lugs; 0 for a smooth wheel."""
    lug_count: Annotated[StrictInt, Field(le=100_000)] = 0
    """Number n_L of lugs."""
    shearing_radius_coefficient: Annotated[float | None, _measure("")] = None
    """λ_s of Ding et al. 2015, (1), from 0 to 1; left out: from (2), once, at the prior median of phi."""


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class ModelOptions(Table):
    """Options of the wheel-soil model, as :class:`bayesterra.models.M2L`."""

    transition_slips: Annotated[tuple[float, float], _TWO_SLIPS] = (0.15, 0.5)
    """Slips s_j1 and s_j2 of Ding et al. 2015, (13), between which shearing moves from the lug tips to the rim."""
    shear_start: Literal["transition", "rim", "tip"] = "transition"
    """Radius R_j at which shearing starts: Ding et al. 2015, (13), or held at the ``rim`` or the ``tip``."""
    constant_exponent: StrictBool = False
    """Sinkage exponent without slip: N = n0, and n1 is held at 0."""
    mean_load: Annotated[float | None, _measure("N")] = None
    """Mean load per wheel of the vehicle, for M2L; left out: that of the rows."""


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class LeastSquaresOptions(Table):
    """Options of the least-squares fits; soil parameters by name, SI units."""

    hold: SoilValues = Field(default_factory=dict)
    """Parameters held at a value."""
    start: SoilValues = Field(default_factory=dict)
    """Start values in place of the method's own."""
    lower: SoilValues = Field(default_factory=dict)
    """Lower bounds in place of the method's own."""
    upper: SoilValues = Field(default_factory=dict)
    """Upper bounds in place of the method's own."""
    delta: Annotated[Number, Field(gt=0)] = 0.002
    """Change of c1 and c2 below which the passes of IM1 end."""
    methods: tuple[Method, ...] = ("IM1", "IM2", "IM3", "joint")
    """Fits to make."""
    solvers: Annotated[tuple[Literal["converged", "lsqcurvefit"], ...], Field(min_length=1)] = ("converged",)
    """Solvers of IM1, IM2 and IM3: ``converged``, and the paper's, whose result hangs on its start."""


MANY_DRAWS = 10_000
"""Effective draws asked for beyond which ensembles have twice the walkers."""


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class SamplingOptions(Table):
    """End of the sampling, and number of walkers: by default 64 an ensemble, 128 for many draws."""

    target_ess: Annotated[int, Field(ge=100, le=10_000_000, strict=True)] = 4000
    """Effective sample size to reach."""
    ensembles: Annotated[int, Field(ge=4, le=256, strict=True)] = 4
    """Independent ensembles, which are the chains of ``draws.nc``."""
    walkers: Annotated[int, Field(ge=32, le=100_000, multiple_of=2, strict=True)] = 64
    """Walkers of an ensemble; 128 unless stated where more than 10 000 draws are asked for."""
    max_steps: Annotated[int, Field(ge=1, le=100_000_000, strict=True)] = 20000
    """Steps after which an ensemble ends, converged or not."""

    @model_validator(mode="before")
    @classmethod
    def _more_for_many(cls, content: Any) -> Any:
        """The options, with more walkers for many draws: twice the walkers cost less than twice the steps."""
        options = content.kwargs if isinstance(content, ArgsKwargs) else content
        if not isinstance(options, Mapping) or "walkers" in options:
            return content
        asked = options.get("target_ess")
        if not isinstance(asked, int) or asked <= MANY_DRAWS:
            return content
        more = {**options, "walkers": 128}
        return ArgsKwargs(content.args, more) if isinstance(content, ArgsKwargs) else more


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class Reference(Table):
    """Published or true parameter values, SI units, and where they come from."""

    source: Text = ""
    values: AnyValues = Field(default_factory=dict)


StatedValues = Annotated[
    Reference | None,
    BeforeValidator(partial(gathered, ("source",))),
    BeforeValidator(_plain, json_schema_input_type=_Values),
]


@dataclass(frozen=True, kw_only=True, config=_CONFIG)
class StudyContent(Table):
    """All tables of a study; the same in files and in Python."""

    title: Text = ""
    """Title of the study, on every page."""
    soil: Text = ""
    """Name of the soil."""
    date: Annotated[Text, BeforeValidator(lambda day: day.isoformat() if isinstance(day, datetime.date) else day)] = ""
    """Day of the test."""
    model: Annotated[Any, PlainValidator(_model, json_schema_input_type=str | _Open), Field(description=_MODELS)] = "M1"
    drive: Literal["load", "sinkage", "both"] = "load"
    """Quantity known of a row beside its slip: the load, the sinkage, or ``both`` read with errors."""
    load_range: Annotated[Range, BeforeValidator(_load_range, json_schema_input_type=list[str])] = None
    """Ends of the flat prior of every true load in the drive ``both``; left out: six sd beyond the readings."""
    pooling: Annotated[Pooling | None, _POOLING] = None
    """Parameters that groups of rows share, and those that each has for itself."""
    data: DataTable | None = None
    """Place of the measurements; left out where there are soil tests alone."""
    wheels: Annotated[dict[str, Annotated[WheelTable, BeforeValidator(_plain)]], BeforeValidator(_named)] = Field(
        default_factory=dict
    )
    """Wheels by name, which the column ``wheel`` of the measurements uses where there are several."""
    soil_tests: Annotated[dict[str, SoilTestTable], BeforeValidator(_series)] = Field(default_factory=dict)
    """Plates and shear tests of the same soil, by a name with which their own parameters end."""
    model_options: Annotated[ModelOptions, BeforeValidator(_plain)] = ModelOptions()
    """Options of the model."""
    noise: Annotated[dict[str, Noise], _entries(entries.noise)] = Field(default_factory=dict)
    """Noise of each measured channel."""
    discrepancy: Annotated[dict[str, Discrepancy], _entries(discrepancies)] = Field(default_factory=dict)
    """Smooth error of the model over slip, by channel."""
    ripple: Annotated[dict[str, Ripple], _entries(ripples)] = Field(default_factory=dict)
    """Noise of a channel that hangs together along a sweep."""
    slip: Annotated[SlipError | None, _entries(slip_error)] = None
    """Error of the slip readings; left out: slips are exact."""
    priors: Annotated[StatedPriors, _entries(entries.priors)] = StatedPriors()
    """Prior of each parameter: a law, a fixed value, a tie, a set, or an earlier result."""
    least_squares: Annotated[LeastSquaresOptions, BeforeValidator(_plain)] = LeastSquaresOptions()
    """Options of the least-squares fits."""
    published: StatedValues = None
    """Published values to show beside the results, and their ``source``."""
    truth: StatedValues = None
    """True values of simulated data, likewise."""
    sampling: Annotated[SamplingOptions, BeforeValidator(_plain)] = SamplingOptions()
    """End of the sampling."""


def checked(tables: Mapping[str, Any], *, bare: bool) -> StudyContent:
    """Check the tables of a study and convert them to SI; StudyError names table, key, what must hold and what was got.

    Parameters
    ----------
    tables : by name, as in a study file.
    bare : take numbers as SI values, as calls from Python do; else every dimensional value needs a unit.
    """
    return checked_by(_ADAPTER, tables, bare=bare)


def checked_by(adapter: TypeAdapter[T], tables: Mapping[str, Any], *, bare: bool) -> T:
    """Check tables of another shape in the same way."""
    try:
        return adapter.validate_python(dict(tables), context={"bare": bare})
    except ValidationError as error:
        raise StudyError(one_line(error.errors()[0])) from error


def read_toml(path: Path, kind: str = "study") -> dict[str, Any]:
    """Read a TOML file of a kind; StudyError where that cannot be done."""
    try:
        text = read_text(path, MOST_TOML)
        if any(part.count(".") > LONGEST_KEY for part in re.split(r"[\n=,{}\[\]]", text)):
            raise StudyError("must be TOML: a key has too many parts")
        content = tomllib.loads(text)
        check_depth(content)
        return content
    except FileNotFoundError as error:
        raise StudyError(f"no such {kind} file") from error
    except OSError as error:
        raise StudyError(f"cannot be read ({reason(error)})") from error
    except RecursionError:
        raise StudyError("must be TOML: it is nested too deeply") from None
    except UnicodeDecodeError as error:
        raise StudyError(f"must be UTF-8 text (byte {error.start} is not)") from error
    except ValueError as error:  # TOMLDecodeError, and numbers of thousands of digits
        raise StudyError(f"must be TOML: {error}") from error


def know_model(folder: Path) -> None:
    """Make the parameters of a saved study known before its record and draws are read.

    StudyError where its model is code that is not allowed, or cannot be loaded.
    """
    stated: object = None
    with suppress(StudyError):  # a folder without a sound study says so itself
        stated = read_toml(folder / "study.toml").get("model")
    if isinstance(stated, Mapping):
        with errors_in(folder / "study.toml"):
            loaded_model(stated)


LONGEST_KEY = 500
"""Dots, at most, between two signs: with many more the time that TOML needs grows as their square."""
_ADAPTER = TypeAdapter(StudyContent)

_HOMES: dict[str, Any] = {
    "data": DataTable,
    "wheels.<name>": WheelTable,
    "soil_tests.<name>": SoilTestTable,
    "model_options": ModelOptions,
    "least_squares": LeastSquaresOptions,
    "sampling": SamplingOptions,
}


def _home(key: str) -> str:
    """Right place of a key that stands in the wrong table, as it does after a header too early."""
    if key in StudyContent.__dataclass_fields__ and key not in (*_HOMES, "wheels", "soil_tests"):
        return " (it belongs at the top, before the first table)"
    homes = (table for table, shape in _HOMES.items() if key in shape.__dataclass_fields__)
    return next((f" (it belongs in [{table}])" for table in homes), "")


def one_line(error: ErrorDetails) -> str:
    """The fault and its place in one line, from the first of pydantic's errors."""
    *path, key = [str(part) for part in error["loc"]] or [""]
    if error["type"] == "missing":
        return f"{_heading(path)}needs '{key}'"
    if error["type"] == "value_error":  # our own checks name the key themselves
        text = str(error["ctx"]["error"])
        whole = isinstance(error["input"], Mapping) and key and not text.startswith(f"'{key}'")
        return f"{_heading([*path, key] if whole else path)}{text}"
    must = error["msg"].replace("Input should be", "must be", 1)
    must = "must be a table" if error["type"] in ("dict_type", "dataclass_type") else must
    return f"{_heading(path)}'{key}' {must} (got {_shortened(error['input'])})"


def _shortened(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _heading(path: list[str]) -> str:
    table = ".".join(path).removesuffix(".values")
    return f"[{table}] " if table else ""


def json_schema() -> str:
    """JSON schema of study files, by which editors complete and check keys."""
    return json.dumps({"$schema": GenerateJsonSchema.schema_dialect, **_ADAPTER.json_schema()}, indent=1)
