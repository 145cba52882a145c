"""A study: measurements, wheels, model, noise and prior, checked and in SI units; the input of everything."""

from collections.abc import Mapping
from copy import copy
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayesterra.arrays import BoolArray, FloatArray, frozen
from bayesterra.errors import StudyError, check_keys, check_kind, checked_path, errors_in, known
from bayesterra.models import ForwardModel, OwnModel, Wheel, WheelSoilModel
from bayesterra.parameters import LOAD_EFFECT, PARAMETERS
from bayesterra.study import assembly, entries, schema
from bayesterra.study.canonical import fingerprint
from bayesterra.study.drive import Drive
from bayesterra.study.groups import Pooling, values_of_group
from bayesterra.study.model_errors import ModelErrors, check_groups
from bayesterra.study.noise import Noise
from bayesterra.study.observations import Observations, observations, read_table
from bayesterra.study.own import allowing_code, own_model
from bayesterra.study.plausibility import Repeats, implausible, repeats, silent
from bayesterra.study.priors import Prior
from bayesterra.study.schema import LeastSquaresOptions, Reference, SamplingOptions
from bayesterra.study.soil_tests import SoilTest, soil_test

if TYPE_CHECKING:
    from bayesterra.study.previous import PosteriorPrior


STUDY_FILE = "study.toml"
SOIL_TEST_FILE = "soiltest.toml"
SOIL_TEST_KEYS = ("test", "title", "soil", "data", "noise", "priors", "published", "truth", "sampling")
"""Keys and tables of such a file."""
EFFECTIVE = {"target_ess": 2000}
"""Sampling options of such a file, where it has none."""


@dataclass(frozen=True, init=False, eq=False)
class Study:
    """Everything that a posterior and the fits beside it depend on.

    Parameters
    ----------
    data : table of measurements, units in the column names, e.g. ``sinkage [mm]``; empty cells NaN.
    wheels : by name, :class:`bayesterra.models.Wheel` or a table of its dimensions; neither these nor data where
        there are soil tests alone.
    slip_reference : the radius behind the slip column: ``rim`` r, ``tip`` r + h, ``shearing`` r_s.
    sinkage_reference : the zero of the sinkage column: ``rim`` or ``tip`` of the lugs.
    kind : ``measured``, ``digitised`` or ``simulated``.
    source : where the measurements come from.
    path : the study file, where there is one.
    prior_only : readings may be missing altogether; outcomes that have noise are yet to be measured.
    **tables : all other keys and tables of a study file, :class:`bayesterra.study.schema.StudyContent`. Numbers
        are SI values, text has its unit; models, laws and noises may be given as objects.

    Attributes
    ----------
    observations : all rows, in use or not. ``load`` and ``values`` hold what the drive conditions on: with
        drive ``load`` the load of every row, with ``sinkage`` the sinkage.
    load_range : N, the flat prior of every row's load with drive ``both``; else None.
    noise : noise of every outcome that is measured, in the order of ``parameters.OUTCOMES``.
    errors : discrepancy and ripple of the measured outcomes, and errors of the slip readings.
    prior : laws and fixed values of soil parameters and estimated noise.
    taken : joint laws that the prior holds from earlier results, and how well they stand for those.
    soil_tests : plates and shear tests of the same soil by name.
    pooling : the role of every free parameter where there is a [pooling] table; else None.
    notes : what was filled in, left out or not used; one sentence each.
    warnings : readings that no wheel makes; one sentence each, with rows and mend.

    Raises
    ------
    StudyError : one line that names what is wrong, where, and what was expected.
    """

    title: str
    soil: str
    date: str
    kind: str
    source: str
    model: ForwardModel
    drive: Drive
    load_range: tuple[float, float] | None
    pooling: Pooling | None
    wheels: Mapping[str, Wheel]
    observations: Observations
    noise: Mapping[str, Noise]
    errors: ModelErrors
    prior: Prior
    soil_tests: Mapping[str, SoilTest]
    taken: "tuple[PosteriorPrior, ...]"
    least_squares: LeastSquaresOptions
    published: Reference | None
    truth: Reference | None
    sampling: SamplingOptions
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    path: Path | None

    def __init__(
        self,
        data: pd.DataFrame | None = None,
        wheels: Mapping[str, Wheel | Mapping[str, Any]] | None = None,
        *,
        slip_reference: str = "",
        sinkage_reference: str = "rim",
        kind: str = "measured",
        source: str = "",
        path: Path | None = None,
        prior_only: bool = False,
        **tables: Any,
    ) -> None:
        if data is not None or not tables.get("soil_tests"):
            check_kind("bt.Study", data, pd.DataFrame)
        described = {
            "file": tables.pop("file", "the table of measurements"),
            "slip_reference": slip_reference,
            "sinkage_reference": sinkage_reference,
            "kind": kind,
            "source": source,
        }
        content = {**_with_model_name(tables), **({} if data is None else {"wheels": wheels, "data": described})}
        attributes = _parts(data, schema.checked(content, bare=True), expected=prior_only)
        for name, value in {**attributes, "path": path}.items():
            object.__setattr__(self, name, value)

    def __repr__(self) -> str:
        """Name the study in a line."""
        driven = f"{self.model.name}, drive {self.drive}, {len(self.observations)} rows"
        parts = [driven] * bool(self.wheels) + [f"{test.kind} tests {name}" for name, test in self.soil_tests.items()]
        return f"<Study {self.title!r}: {', '.join(parts)}>"

    @property
    def described(self) -> dict[str, str]:
        """Texts on what was driven and when, by their keys; "" where they are left out."""
        return {name: getattr(self, name) for name in _DESCRIBED}

    @property
    def middle_load(self) -> float:
        """Middle (N) of the range of latent loads; NaN where loads are given."""
        return float(np.mean(self.load_range)) if self.load_range else np.nan

    @property
    def references(self) -> dict[str, Reference]:
        """Published and true values, those of them that are stated."""
        stated = {"published": self.published, "truth": self.truth}
        return {name: reference for name, reference in stated.items() if reference is not None}

    def with_data(self, values: Mapping[str, FloatArray]) -> "Study":
        """The same study with other outcomes: simulated ones, say.

        Parameters
        ----------
        values : SI values (m,) by channel, one per row of ``observations``; other channels stay.
        """
        for name, column in values.items():
            if name not in self.observations.values or np.shape(column) != (len(self.observations),):
                raise ValueError(f"'{name}' must be a measured channel of {len(self.observations)} rows")
        merged = {**self.observations.values, **{name: frozen(column) for name, column in values.items()}}
        return self.with_rows(replace(self.observations, values=merged))

    def with_stresses(self, stresses: Mapping[str, FloatArray]) -> "Study":
        """The same study with other answers (m,) of the soil in its soil tests, by name: simulated ones, say."""
        return self.having(
            soil_tests={name: test.with_stress(stresses[name]) for name, test in self.soil_tests.items()}
        )

    def with_use(self, use: BoolArray) -> "Study":
        """The same study with the rows in the fit where ``use`` (m,) holds, and no others."""
        return self.with_rows(replace(self.observations, use=frozen(np.asarray(use), np.bool_)))

    def with_rows(self, rows: Observations) -> "Study":
        """The same study with other rows, which hold what its drive conditions on and the same channels."""
        return self.having(observations=rows)

    @property
    def repeats(self) -> dict[str, Repeats]:
        """Scatter of readings under one load and slip by channel, where such differ by their noise alone."""
        return repeats(self.observations, self.noise) if _repeatable(self.drive, self.errors) else {}

    @property
    def noise_stated(self) -> bool:
        """True where the noise of some reading in the fit is stated, not estimated."""
        given = self.observations.used().given_sd
        return any(n.law is None or not np.isnan(given[name]).all() for name, n in self.noise.items())

    def with_noise(self, factor: float) -> "Study":
        """The same study with all stated noise times ``factor``; estimated noise as it is."""
        given = {name: frozen(factor * sd) for name, sd in self.observations.given_sd.items()}
        noise = {name: each.scaled(factor) for name, each in self.noise.items()}
        return self.having(noise=noise, observations=replace(self.observations, given_sd=given))

    def having(self, **attributes: Any) -> "Study":
        """The same study with other attributes, which are taken as they are."""
        other = copy(self)
        for name, value in attributes.items():
            object.__setattr__(other, name, value)
        return other

    def of_group(self, group: str | None) -> "Study":
        """The study without groups, of the rows and wheels of one of them; of all rows for None."""
        stated = {
            name: replace(reference, values=values_of_group(reference.values, group))
            for name, reference in self.references.items()
        }
        if group is None or self.pooling is None:
            return self.having(pooling=None, **stated)
        rows = self.observations.take(np.array(self.observations.label(self.pooling.by)) == group)
        wheels = {name: wheel for name, wheel in self.wheels.items() if name in rows.wheel}
        return self.having(pooling=None, wheels=wheels, observations=replace(rows, notes=()), **stated)

    def by_group(self) -> "dict[str, Study]":
        """Each group of rows in the fit as a study of its own; the study itself, without a name, if none."""
        if self.pooling is None:
            return {"": self}
        names = dict.fromkeys(self.observations.used().label(self.pooling.by))
        return {name: self.of_group(name) for name in names}

    @property
    def fingerprint(self) -> dict[str, str]:
        """SHA-256 of what the results depend on: ``study`` (all but text and sampling options), ``data``."""
        return fingerprint(self)


def load_study(
    path: str | Path, *, prior_only: bool = False, table: pd.DataFrame | None = None, allow_code: bool = False
) -> Study:
    """Read a study file, or the ``study.toml`` of a folder, and its measurements.

    Parameters
    ----------
    prior_only : the table needs no readings: it says what is going to be measured.
    table : in place of the file of measurements.
    allow_code : run the code that the file names as its model.

    Raises
    ------
    StudyError : one line that begins with the file and names what is wrong and what was expected.
    """
    path = checked_path("bt.load_study", path, "a study file or its folder")
    path = path / STUDY_FILE if path.is_dir() else path
    with errors_in(path), allowing_code(allow_code):
        content = schema.checked(schema.read_toml(path), bare=False)
        tables = {field.name: getattr(content, field.name) for field in fields(content)}
        tables["priors"] = content.priors.beside(path)
        tables["soil_tests"] = {name: _read_test(path.parent, test) for name, test in content.soil_tests.items()}
        if tables.pop("data") is None or content.data is None:
            tables.pop("wheels")
            return Study(path=path, prior_only=prior_only, **tables)
        described = asdict(content.data)
        form = {key: described.pop(key) for key in ("sheet", "decimal")}
        described["file"] = str(path.parent / content.data.file) if table is None else "the rows"
        with errors_in(described["file"]):
            table = read_table(described["file"], **form) if table is None else table
        return Study(table, path=path, prior_only=prior_only, **described, **tables)


def _read_test(folder: Path, test: schema.SoilTestTable) -> schema.SoilTestTable:
    """A series of soil tests with its readings."""
    if not test.file:
        return test
    with errors_in(folder / test.file):
        return replace(test, file=str(folder / test.file), table=read_table(folder / test.file))


def load_soil_test(path: str | Path) -> Study:
    """Read a soil-test file, or a folder that holds ``soiltest.toml``, and its table.

    Raises
    ------
    StudyError : naming file, table, key or column, what must hold and the value got.
    """
    path = checked_path("bt.load_soil_test", path, "a soil-test file")
    path = path / SOIL_TEST_FILE if path.is_dir() else path
    with errors_in(path):
        return soil_test_study(schema.read_toml(path), folder=path.parent)


def soil_test_study(tables: Mapping[str, Any], *, table: pd.DataFrame | None = None, folder: Path = Path()) -> Study:
    """A study of one series of tests from the tables of a soil-test file.

    Parameters
    ----------
    table : readings, units in the headers; numbers in ``tables`` are then SI values. Else the file that [data]
        names in ``folder`` is read.

    Raises
    ------
    StudyError : naming table, key or column, what must hold and the value got.
    """
    check_keys(tables, SOIL_TEST_KEYS)
    kind = str(tables.get("test"))
    data = entries.table(tables.get("data", {}), "data")
    series = {**data, "test": tables.get("test"), "noise": tables.get("noise", {})}
    rest = {key: value for key, value in tables.items() if key not in ("test", "data", "noise")}
    sampling = tables.get("sampling", {})
    whole = {**rest, "sampling": {**EFFECTIVE, **sampling} if isinstance(sampling, Mapping) else sampling}
    try:
        if kind not in entries.SCATTER:
            raise StudyError(f"'test' must be 'plate' or 'shear' (got {tables.get('test')!r})")
        content = schema.checked({**whole, "soil_tests": {kind: series}}, bare=table is not None)
        stated = content.soil_tests[kind]
        if table is None and stated.file:
            with errors_in(folder / stated.file):
                table = read_table(folder / stated.file)
        parts = {field.name: getattr(content, field.name) for field in fields(content)}
        del parts["data"], parts["wheels"]
        return Study(**{**parts, "soil_tests": {kind: replace(stated, table=table)}})
    except StudyError as error:  # in the words of the file
        said = str(error).replace(f"[soil_tests.{kind}] noise: ", "[noise] ").replace(f"[soil_tests.{kind}", "[data")
        raise type(error)(said) from error


def without_wheels(study: Study, command: str) -> None:
    """StudyError where a command that is about wheels gets a study that has none."""
    if not study.wheels:
        raise StudyError(
            f"'{command}' is about wheels, and this study has soil tests only: add [data] and [wheels], or take their"
            " posterior into a study of a wheel by [[priors.from]]"
        )


def _with_model_name(tables: dict[str, Any]) -> dict[str, Any]:
    """Take a model object of the paper apart into its name and options; another is a law of forces."""
    model = tables.get("model")
    if isinstance(model, WheelSoilModel):
        return {"model_options": model.options, **tables, "model": model.name}
    if model is None or isinstance(model, str | Mapping | OwnModel):
        return tables
    return {**tables, "model": own_model(model)}


def _parts(data: pd.DataFrame | None, content: schema.StudyContent, *, expected: bool) -> dict[str, Any]:
    """Build every attribute of a study from its checked tables."""
    drive, tests = Drive(content.drive), {name: soil_test(name, test) for name, test in content.soil_tests.items()}
    _check_tables(content)
    constant, driven = content.model_options.constant_exponent, content.data is not None
    soil = assembly.soil_prior(content.priors, content.model, constant_exponent=constant, wheels=driven)
    wheels, notes = assembly.resolved_wheels(content.wheels, soil.entries.get("phi")) if driven else ({}, [])
    soil = assembly.with_soil_tests(soil, content.priors, tests, wheels=driven)
    rows = Observations.none()
    if data is not None and content.data is not None:
        with errors_in(content.data.file):
            zeros = {key: getattr(content.data, key) for key in ("slip_reference", "sinkage_reference")}
            rows, row_notes = assembly.conditioned(observations(data, wheels, **zeros), drive, expected=expected)
        rows, notes = assembly.awaited(rows, content.noise, drive) if expected else rows, notes + row_notes
    model, model_notes = assembly.forward_model(content.model, content.model_options, rows)
    noise, loads = dict[str, Noise](), None
    errors = ModelErrors(content.discrepancy, content.ripple, content.slip)
    notes = [*soil.notes, *model_notes, *notes, *rows.notes]
    if driven:
        noise, noise_notes = assembly.outcome_noise(rows, content.noise, drive, expected=expected)
        errors, error_notes = assembly.errors_of_outcomes(errors, noise, rows, drive)
        rows, limit_notes = assembly.check_limits(rows, noise, drive)
        loads, load_notes = assembly.load_range(rows, noise, content.load_range, drive)
        notes += [*noise_notes, *error_notes, *limit_notes, *load_notes, *([] if expected else silent(rows, noise))]
    reads = tuple(name for name in model.parameters if name not in LOAD_EFFECT)
    prior = assembly.full_prior(soil, noise, errors, wheels, reads)
    pooling = None if content.pooling is None else content.pooling.checked(prior.laws)
    own = [*filter(lambda name: name not in PARAMETERS, prior.entries)]
    if pooling is not None:
        check_groups(errors, pooling.by)
        own += pooling.own_names(dict.fromkeys(rows.label(pooling.by)))
    for where, reference in (("published", content.published), ("truth", content.truth)):
        for name in reference.values if reference else ():
            known("parameter", name, (*PARAMETERS, *own), f"[{where}] ")
    notes += [note for test in tests.values() for note in test.notes]
    used, count = rows.used(), sum(len(test.readings) for test in tests.values())
    count += sum(int(np.sum(~np.isnan(used.values[name]))) for name in noise)
    if count < len(prior.names):
        notes.append(f"{count} readings for {len(prior.names)} free parameters: the prior fills in the rest")
    notes += _group_notes(rows, pooling, prior)
    origin = content.data or next(iter(tests.values())).stated
    return {
        **{name: getattr(content, name) for name in _KEPT},
        **{"drive": drive, "kind": origin.kind, "source": origin.source, "model": model, "wheels": wheels},
        **{"observations": rows, "noise": noise, "errors": errors, "prior": prior, "load_range": loads},
        "pooling": pooling,
        "soil_tests": tests,
        "taken": soil.taken,
        "warnings": implausible(rows, wheels, noise if _repeatable(drive, errors) else {}) if driven else (),
        "notes": tuple(notes),
    }


def _check_tables(content: schema.StudyContent) -> None:
    """StudyError where tables are missing, or do not go together."""
    if content.data is None and not content.soil_tests:
        raise StudyError("needs 'data'")
    of_wheels = ("wheels", "noise", "discrepancy", "ripple", "slip", "load_range", "pooling")
    idle = [name for name in of_wheels if getattr(content, name)]
    if content.data is None and idle:
        raise StudyError(f"'{idle[0]}' is about wheels: it needs [data], their measurements")
    if content.soil_tests and content.pooling is not None:
        raise StudyError(
            "[pooling] does not go with [soil_tests]: run the tests alone, and take their posterior by [[priors.from]]"
        )


def _repeatable(drive: Drive, errors: ModelErrors) -> bool:
    """True where readings under one load and slip differ by their noise alone."""
    return not (drive.reads_force or errors.ripple or errors.slip)


_DESCRIBED = ("soil", "date")
_KEPT = ("title", *_DESCRIBED, "least_squares", "published", "truth", "sampling")


def _group_notes(rows: Observations, pooling: Pooling | None, prior: Prior) -> list[str]:
    """Notes on the groups, on what takes them one by one, and on mixtures that populations straighten."""
    if pooling is None:
        return []
    groups = ", ".join(dict.fromkeys(rows.used().label(pooling.by)))
    mixtures = [
        f"the mixture of {names} is taken by its correlations where one of these is hierarchical: "
        + (", ".join(among) or "only in comparisons of what groups share")
        for names in prior.mixtures
        for among in [[name for name in names.split(", ") if name in pooling.hierarchical]]
    ]
    return [f"groups by {pooling.by}: {groups}; least squares and 'follow' take them one by one", *mixtures]
