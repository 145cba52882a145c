"""Results of commands, and of a run: labelled draws, tables with typed rows, the record of their making."""
# ruff: noqa: UP013 (a line for each kind of entry reads better than a class)

import platform
from abc import ABC, abstractmethod
from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, NotRequired, Self, TypeVar, get_type_hints

import numpy as np
import pandas as pd
import xarray as xr
from pydantic import AfterValidator, Field
from typing_extensions import TypedDict

from bayesterra import parameters
from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.errors import StudyError
from bayesterra.report.verdicts import Failures, Verdict, sampling_verdict, with_failures
from bayesterra.runtime.checkpoints import digest
from bayesterra.runtime.folders import whole_folder, write_bytes, write_text
from bayesterra.runtime.netcdf import DRAWS, write_tree
from bayesterra.runtime.tables import Count, Number, Record, csv_text
from bayesterra.study.canonical import identity, write_study
from bayesterra.study.study import Study

if TYPE_CHECKING:
    from bayesterra.report.blocks import Overview
    from bayesterra.report.sections import VerdictPage


CURVE_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
R = TypeVar("R")


class AnalysisResult(ABC):
    """Outcome of a command, which shows itself and can be saved as a folder with its page.

    Functions ``…_page`` and ``…_overview`` show a result; their module is loaded when one of them is called.
    """

    MARK: ClassVar[str] = "run.json"  # file by which folders of this kind are known
    RECORD: ClassVar[type[Record] | None] = Record  # model of the JSON file of that name; None: the mark is a table
    PAGE: ClassVar[str] = "report.html"  # name of the page; empty where there is none
    FIGURES: ClassVar[Mapping[str, str]] = {}  # functions beside ``VIEW`` that draw it, by file; the main one first
    CALLED: ClassVar[str] = "Report"  # what the terminal calls the place where it was saved
    DIGITS: ClassVar[str | None] = "%.6g"  # format of the numbers in tables; None for all digits
    WITH_STUDY: ClassVar[bool] = False  # whether the folder holds the study
    VIEW: ClassVar[str] = ""  # module and first word of the functions that show a result of this kind
    study: Study

    @abstractmethod
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """Tables by the names of their CSV files."""

    def to_record(self) -> dict[str, Any]:
        """Content of the JSON file."""
        return {}

    def page(self) -> "VerdictPage":
        """The page, with what could not be made of it."""
        page: VerdictPage = resolve_name(f"{self.VIEW}_page")(self)
        return page

    def overview(self) -> "Overview":
        """The result in short, for a terminal and a notebook."""
        overview: Overview = resolve_name(f"{self.VIEW}_overview")(self)
        return overview

    def figures(self) -> Mapping[str, bytes]:
        """Figures by the names of their files."""
        from bayesterra.report.figures import white_png

        page = self.VIEW.partition(":")[0]
        return {name: white_png(resolve_name(f"{page}:{draw}")(self)) for name, draw in self.FIGURES.items()}

    def write_inputs(self, part: Path) -> None:
        """Write what was analysed, where a folder of this kind holds it."""
        if self.WITH_STUDY:
            write_study(self.study, part)

    def complete(self, failures: Failures) -> Self:
        """The result with what could not be made of its page in its record, where it keeps one."""
        return self

    def save(self, folder: str | Path, *, overwrite: bool = False) -> Path:
        """Write everything into a new folder, whole or not at all; returns its page, or else the folder.

        Raises
        ------
        ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
        """
        with whole_folder(Path(folder), overwrite=overwrite, mark=self.MARK) as part:
            self.write(part)
        return Path(folder) / self.PAGE

    def write(self, part: Path) -> Self:
        """Write all files into an existing folder; returns the result that they tell of."""
        page = self.page() if self.PAGE else None
        failures = Failures() if page is None else page.failures
        result = self.complete(failures)
        result.write_inputs(part)
        for name, table in result.tables().items():
            write_text(part / f"{name}.csv", csv_text(table, self.DIGITS))
        for name, figure in result.figures().items():
            write_bytes(part / name, figure)
        if self.RECORD is not None:
            self.RECORD.write(part / self.MARK, with_failures(result.to_record(), failures))
        if page is not None:
            write_text(part / self.PAGE, page.html())
        return result

    def place(self, folder: Path) -> str:
        """Line on where it was saved."""
        plots = [f"   Plot: {folder / name}" for name in self.FIGURES]
        return "".join([f"{self.CALLED}: {folder / self.PAGE}", *plots[:1]])

    def _repr_html_(self) -> str:
        from bayesterra.report.sections import notebook

        return notebook(self.overview())


@dataclass(frozen=True, kw_only=True, repr=False)
class DrawnResult(AnalysisResult):
    """Outcome of a run: labelled draws, tables and a record; see what derives from it."""

    TABLES: ClassVar[tuple[str, ...]] = ("summary",)  # fields that are its tables
    GROUP: ClassVar[str] = "posterior"  # of the draws that it is about
    DIGITS: ClassVar[str | None] = None

    draws: xr.DataTree  # with ArviZ groups; SI, radians
    summary: pd.DataFrame  # one row per parameter and derived quantity, in field units
    record: dict[str, Any]  # versions, seed, settings, fingerprints, times and the verdict with every threshold

    def __repr__(self) -> str:
        """What it is about, what may be said of it, and where to go on; ten lines at most."""
        record, data = self.record, self.draws[self.GROUP]
        sizes = " × ".join(f"{size} {dim}s" for dim, size in data.sizes.items() if dim in ("chain", "draw"))
        about = f"{type(self).__name__}: {record['title'] or 'untitled'} ({record['kind']} data)"
        verdicts = [f"  {verdict.name}: {verdict.word} ({verdict.grade})" for verdict in self.verdicts]
        tables = ", ".join(f".{name}" for name in self.TABLES)
        drawn = f"  {sizes} of {', '.join(map(str, data.data_vars))}"
        rest = f"  .draws (ArviZ groups), {tables}, .to_dataframe(), .page(), .save(folder)"
        return "\n".join([about, *([f"  {self.sentence}"] if self.sentence else []), *verdicts, drawn, rest])

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """What may be said of the result, each in a word, a grade and a sentence."""
        return (sampling_verdict(self.record),) if "verdict" in self.record else ()

    @property
    def sentence(self) -> str:
        """What may be quoted of the result; empty where nothing is said of the whole."""
        return ""

    def tables(self) -> Mapping[str, pd.DataFrame]:
        """Tables by the names of their CSV files."""
        return {name: getattr(self, name) for name in self.TABLES}

    def to_record(self) -> dict[str, Any]:
        """Content of the JSON file."""
        return self.record

    def complete(self, failures: Failures) -> Self:
        """The result with what could not be made of its page in its record."""
        return replace(self, record=with_failures(self.record, failures))

    def write_inputs(self, part: Path) -> None:
        """Write draws and study."""
        write_tree(self.draws, part / DRAWS)
        super().write_inputs(part)

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters in the order of their laws."""
        return tuple(parameters.in_order(map(str, self.draws[self.GROUP].data_vars)))

    def values(self, group: str = "") -> FloatArray:
        """Draws of all parameters (n, d), of the group ``prior`` where that is asked for; SI, radians."""
        data = self.draws[group or self.GROUP]
        return np.column_stack([data[name].to_numpy().ravel() for name in self.names])

    def column(self, name: str, group: str = "") -> FloatArray:
        """Draws (n,) of one parameter, field units."""
        return parameters.field_values(name, self.draws[group or self.GROUP][name].to_numpy().ravel())

    def to_dataframe(self) -> pd.DataFrame:
        """Draws, one row each: chain (ensemble), draw, then the parameters in SI and radians."""
        return pd.DataFrame(self.draws[self.GROUP].to_dataset().to_dataframe()).reset_index()

    @property
    def converged(self) -> bool:
        """True where every check of the sampling passed; without sampling there is none."""
        return bool(self.record.get("verdict", {}).get("converged", True))


@dataclass(frozen=True, kw_only=True, repr=False)
class Result(DrawnResult):
    """The outcome of a run of a study; everything a report shows is in here and in the folder it is saved to.

    Attributes
    ----------
    study : what was asked.
    draws : xarray DataTree with ArviZ groups (posterior, sample_stats, log_prior, log_likelihood, prior,
        prior_predictive, posterior_predictive, observed_data, constant_data) and ``curves``; SI, radians.
        Their ``row`` is one of the fit; rows left out stand in ``predictions`` and
        ``predictions_constant_data``, the latter with the readings that they have.
    least_squares : point estimates of every method and where they stand in the posterior.
    identifiability : one row per parameter: verdict, contraction, strongest coupling.
    predictive : per row and channel: reading and predictive quantiles, in field units.
    new_tests, bands : every soil test beside its prediction, and bands of new ones, as in
        :class:`bayesterra.checking.soil_tests.NewTests`; empty without.
    basis : of one group of a joint posterior: where its parameters come from, a sentence.
    """

    TABLES = ("summary", "least_squares", "identifiability", "predictive")
    WITH_STUDY = True

    study: Study
    least_squares: pd.DataFrame = field(default_factory=pd.DataFrame)
    identifiability: pd.DataFrame = field(default_factory=pd.DataFrame)
    predictive: pd.DataFrame = field(default_factory=pd.DataFrame)
    new_tests: pd.DataFrame = field(default_factory=pd.DataFrame)
    bands: pd.DataFrame = field(default_factory=pd.DataFrame)
    basis: str = ""

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups of a joint posterior."""
        return ()

    def by_group(self) -> "dict[str, Result]":
        """Result of every group by name; without groups the result itself, under no name."""
        return {group: self.of_group(group) if group else self for group in self.groups or ("",)}

    def of_group(self, group: str | None = None, *, wheel: str = "", seed: int = 1) -> "Result":
        """Result of one group of a joint posterior, see ``PooledResult``; without groups the result itself.

        Raises
        ------
        StudyError : there is no such group.
        """
        if group is not None:
            raise StudyError(f"'group' needs a result with groups, of a study with [pooling] (got {group!r})")
        return self


def labelled_dataset(variables: Mapping[str, tuple[tuple[str, ...], Any]], **attributes: Any) -> xr.Dataset:
    """Dataset of variables with their dimensions, and attributes."""
    dataset = xr.Dataset({name: (dims, values) for name, (dims, values) in variables.items()})
    sizes = {dim: size for dim, size in dataset.sizes.items() if dim not in dataset.coords}
    coordinates = {str(dim): np.arange(size) for dim, size in sizes.items()}
    return dataset.assign_coords(coordinates).assign_attrs(attributes)


SI_UNITS = {"phi": "rad", "Ks": "Pa/m^N", "kc": "Pa m/m^N", "kphi": "Pa/m^N"}
"""Units of draws that their dimension does not say in full."""


def parameter_dataset(names: tuple[str, ...], chains: FloatArray) -> xr.Dataset:
    """Label draws (chain, draw, d) by parameter; each variable says its unit, in SI."""
    dataset = labelled_dataset({name: (("chain", "draw"), chains[:, :, i]) for i, name in enumerate(names)})
    for name in names:
        parameter = parameters.PARAMETERS[name]
        unit = SI_UNITS.get(name, parameter.dimension or "1")
        dataset[name].attrs.update(units=unit, long_name=parameter.description)
    return dataset


def of_rows(dataset: xr.Dataset, chosen: BoolArray) -> xr.Dataset:
    """Some rows of a dataset that has all rows of the table."""
    return dataset.isel(row=np.flatnonzero(chosen))


def observed_dataset(study: Study) -> xr.Dataset:
    """The readings of all rows of the table."""
    values = study.observations.values
    dataset = labelled_dataset({name: (("row",), values[name]) for name in study.noise}, kind=study.kind)
    return dataset.assign_coords(row=list(study.observations.rows))


def conditions_dataset(study: Study) -> xr.Dataset:
    """Conditions under which the rows were driven."""
    observations = study.observations
    variables: dict[str, tuple[tuple[str, ...], Any]] = {
        "slip": (("row",), observations.slip),
        "load": (("row",), observations.load),
        "use": (("row",), observations.use.astype(np.int8)),
        "wheel": (("row",), np.array(observations.wheel, dtype=object)),
    }
    if study.drive.by_sinkage:
        variables["sinkage"] = (("row",), observations.values["sinkage"])
    return labelled_dataset(variables).assign_coords(row=list(observations.rows))


def left_out_dataset(study: Study) -> xr.Dataset:
    """Conditions and readings of the rows that are not in the fit."""
    both = conditions_dataset(study).merge(observed_dataset(study))
    return of_rows(both.assign_attrs(kind=study.kind), ~study.observations.use)


@dataclass(frozen=True)
class SummaryRow:
    """A row of the summary, field units."""

    mode: float
    mean: float
    median: float
    sd: float
    hdi90_lo: float
    hdi90_hi: float
    mcse_mean: float
    mcse_median: float
    mcse_sd: float
    ess_bulk: float
    ess_tail: float
    r_hat: float
    prior_mean: float
    prior_sd: float
    mode_at: str = "inside"
    hdi90_lo_half: float = float("nan")
    hdi90_hi_half: float = float("nan")
    hdi90_lo_double: float = float("nan")
    hdi90_hi_double: float = float("nan")

    def hdi_with(self, noise: str) -> tuple[float, float]:
        """The ends of the interval with ``half`` or ``double`` the stated noise; NaN where that is not known."""
        return getattr(self, f"hdi90_lo_{noise}"), getattr(self, f"hdi90_hi_{noise}")

    @property
    def hdi(self) -> tuple[float, float]:
        """The ends of the 90 % highest-density interval."""
        return self.hdi90_lo, self.hdi90_hi

    @property
    def sd_ratio(self) -> float:
        """Standard deviation over that of the prior."""
        return self.sd / self.prior_sd

    @property
    def shift(self) -> float:
        """How far the mean moved, in standard deviations of the prior."""
        return (self.mean - self.prior_mean) / self.prior_sd

    @property
    def mode_outside(self) -> bool:
        """True where the mode lies outside the interval by more than a twentieth of its width."""
        margin = 0.05 * (self.hdi90_hi - self.hdi90_lo)
        return not self.hdi90_lo - margin <= self.mode <= self.hdi90_hi + margin


@dataclass(frozen=True)
class IdentifiabilityRow:
    """A row of the identifiability table."""

    verdict: str
    contraction: float
    partner: str
    correlation: float
    bound: str
    tied_to: str
    tie: float
    multiple: float = float("nan")
    shift: float = float("nan")

    @property
    def coupled_with(self) -> str:
        """The one parameter that a coupled one hangs on; empty if it takes several, or it is not coupled."""
        return self.tied_to if self.verdict == "coupled" and abs(self.tie) >= COUPLED else ""

    @property
    def word(self) -> str:
        """The verdict as pages, notebooks and terminals show it."""
        return shown(self.verdict)


def shown(verdict: str) -> str:
    """Verdict of the identifiability table as it is shown: with its noun where it is an adverb."""
    return {"weakly": "weakly determined"}.get(verdict, verdict)


def summary_rows(result: DrawnResult) -> dict[str, SummaryRow]:
    """Rows of the summary by parameter or derived quantity, in its order."""
    return _rows(SummaryRow, result.summary)


def identifiability_rows(result: Result) -> dict[str, IdentifiabilityRow]:
    """Rows of the identifiability table by parameter, in its order."""
    table = result.identifiability
    # folders of versions that did not have these columns coupled with any parameter
    older = {"tied_to": table.get("partner"), "tie": table.get("correlation")}
    return _rows(IdentifiabilityRow, table.assign(**{name: older[name] for name in older if name not in table}))


def _rows(kind: type[R], table: pd.DataFrame) -> dict[str, R]:
    """Rows of a table by parameter; columns that it lacks have their defaults."""
    columns = {name: str if of is str else float for name, of in get_type_hints(kind).items()}
    return {
        str(row["parameter"]): kind(**{name: of(row[name]) for name, of in columns.items() if name in row})
        for row in table.to_dict("records")
    }


COUPLED = 0.8
"""Absolute correlation from which two parameters, neither of them determined, are coupled."""

PACKAGES = ("bayesterra", "numpy", "scipy", "numba", "emcee", "arviz-stats", "xarray")


def run_record(study: Study, seed: int, findings: dict[str, Any], seconds: dict[str, float]) -> dict[str, Any]:
    """Put together the content of ``run.json``: ``findings`` of the analysis, and ``seconds`` by stage."""
    return {**origin(study, seed), "settings": asdict(study.sampling), "seconds": seconds, **findings}


def versions() -> dict[str, str]:
    """Versions of Python and of the packages that numbers depend on."""
    return {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}


def origin(study: Study, seed: int) -> dict[str, Any]:
    """Origin of a run: its study and what it was run with."""
    return {
        "title": study.title, "kind": study.kind, "source": study.source,
        "made": datetime.now(UTC).isoformat(timespec="seconds"), "versions": versions(), "seed": seed,
        "notes": [*study.warnings, *study.notes], "machine": f"{platform.system()} {platform.machine()}",
        "model": study.model.name if study.wheels else "", "drive": study.drive if study.wheels else "",
        "fingerprints": {**study.fingerprint, "run": digest(identity(study, seed))},
        **({"priors_from": [prior.record() for prior in study.taken]} if study.taken else {}),
    }  # fmt: skip


def _one_of(names: Collection[str], what: str) -> AfterValidator:
    def checked(name: str) -> str:
        if name not in names and parameters.whole_and_part(name)[0] not in names:
            raise ValueError(f"must be {what}")
        return name

    return AfterValidator(checked)


ParameterName = Annotated[str, _one_of(parameters.PARAMETERS, "a parameter")]
ChannelName = Annotated[str, _one_of(parameters.CHANNELS, "a channel")]
Some = Number | None
"""A number; what is not finite stands as null."""

Fingerprints = TypedDict("Fingerprints", {"study": str, "data": str, "run": NotRequired[str]})
Settings = TypedDict("Settings", {"target_ess": Count, "ensembles": Count, "walkers": Count, "max_steps": Count})
Check = TypedDict("Check", {"name": str, "value": Some, "threshold": Number, "passed": bool, "advice": str})
SamplingVerdict = TypedDict("SamplingVerdict", {"converged": bool, "ess": Number, "r_hat": Some, "checks": list[Check]})
FailureEntry = TypedDict("FailureEntry", {"error": str, "message": str, "trace": list[str]})


class OriginRecord(Record):
    """Where a record comes from, and what could not be computed."""

    title: str
    kind: Literal["measured", "simulated", "digitised"]
    source: str
    made: str
    versions: dict[str, str]
    seed: Count
    notes: list[str]
    failures: dict[str, FailureEntry] = Field(default_factory=dict)


class PriorRecord(OriginRecord):
    """The content of ``run.json`` of a prior without readings."""

    machine: str
    model: str
    drive: str
    fingerprints: Fingerprints


class StudyRecord(PriorRecord):
    """What the records of all runs of a study hold."""

    settings: Settings
    seconds: dict[str, Number]
    verdict: SamplingVerdict
