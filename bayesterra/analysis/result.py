"""Results of a run on one soil and of a prior: labelled draws, record, folder read back, page."""
# ruff: noqa: UP013 (a line for each kind of entry reads better than a class)

import tomllib
from collections import ChainMap
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal, NotRequired, Self

import numpy as np
import pandas as pd
import xarray as xr
from pydantic import AfterValidator, Field
from typing_extensions import TypedDict

from bayesterra.arrays import BoolArray, FloatArray, answered_quantiles
from bayesterra.checking.levels import scope, untested
from bayesterra.checking.predictive import Curves, RowPredictions, one_in
from bayesterra.checking.soil_tests import verdict_on_tests
from bayesterra.checking.validation import Validation, fit_verdict, prediction_verdict
from bayesterra.errors import ResultError
from bayesterra.identifiability.analysis import soil_verdict
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.parameters import CHANNELS, DERIVED, PARAMETERS, whole_and_part
from bayesterra.pooling.run import PooledResult
from bayesterra.report.verdicts import Verdict, failed, quotable, sampling_verdict, unknown_verdict
from bayesterra.runtime.netcdf import DRAWS, RECORD, labelled_tree, read_tree
from bayesterra.runtime.reading import MEGABYTE, check_sums, damage, read_json, read_text
from bayesterra.runtime.tables import Count, Number, read_csv
from bayesterra.study import result as base
from bayesterra.study.schema import know_model
from bayesterra.study.study import Study, load_study

Method = Literal["IM1", "IM2", "IM3", "joint", "IM1 lsqcurvefit", "IM2 lsqcurvefit", "IM3 lsqcurvefit"]
Names = list[base.ParameterName]
Values = dict[base.ParameterName, base.Some]
Sampling = TypedDict("Sampling", {
    "acceptance": Number, "steps": Count, "kept_one_step_in": Count, "tau": Values,
    "temperatures": list[Count], "proposal_efficiency": list[base.Some], "log_evidence": list[base.Some],
})  # fmt: skip
Evidence = TypedDict("Evidence", {
    "log_z": Number, "error": Number, "k_hat": base.Some, "limit": Number, "draws": Count, "reliable": bool,
    "spread": NotRequired[Number], "log_share": Number, "log_share_error": Number,
})  # fmt: skip
PriorSupport = TypedDict("PriorSupport", {"tried": Count, "shares": dict[str, Number]})
Mode = TypedDict("Mode", {"log_density": Number, "agreeing_starts": Count, "delta_chi2": NotRequired[base.Some]})
NextDrive = TypedDict("NextDrive", {
    "wheel": str, "load": Number, "slip": Number, "bits": Number, "error": Number, "same_load": Number,
    "candidates": Count,
})  # fmt: skip
OtherNoise = TypedDict("OtherNoise", {"k_hat": base.Some, "refitted": bool, "reliable": bool})
Fit = TypedDict("Fit", {
    "converged": bool, "passes": Count, "errors_percent": dict[base.ChannelName, base.Some], "held": Names,
    "at_bound": Names, "missing": Names, "notes": list[str],
})  # fmt: skip
Standing = TypedDict("Standing", {
    "credible_level": base.Some, "log_density": base.Some, "word": str, "at_bound": Names, "filled": Names,
    "values": Values,
})  # fmt: skip
Group = TypedDict("Group", {
    "scope": str, "view": str, "directions": Count, "determined": Count, "effective": base.Some,
    "cut_effective": base.Some,
})  # fmt: skip
Directions = TypedDict("Directions", {
    "determined": Count, "of": Count, "contractions": list[Number], "groups": list[Group],
    "unseen": list[str],
})  # fmt: skip
Check = TypedDict("Check", {"channel": base.ChannelName, "statistic": str, "p": Number, "calibrated": Number})
Checks = TypedDict("Checks", {
    "checks": list[Check], "overall": Number, "replicates": Count, "effective": list[Number],
})  # fmt: skip
PriorCheck = TypedDict("PriorCheck", {
    "channel": base.ChannelName, "statistic": str, "value": Number, "low": Number, "high": Number, "p": Number,
})  # fmt: skip
PriorChecks = TypedDict("PriorChecks", {"checks": list[PriorCheck], "overall": Number})
Row = TypedDict("Row", {"row": Count, "elpd": Number, "error": Number, "k": base.Some, "refitted": bool})
LeftOut = TypedDict("LeftOut", {
    "rows": list[Row], "full": list[Number], "pit": dict[base.ChannelName, list[base.Some]],
})  # fmt: skip
Reading = TypedDict("Reading", {
    "by": str, "reliable": bool, "predictor": str, "level": str, "row": Count, "wheel": str, "slip": Number,
    "channel": base.ChannelName, "unit": str, "extrapolated": bool, "observed": Number, "q05": base.Some,
    "q25": base.Some, "q50": base.Some, "q75": base.Some, "q95": base.Some, "pit": base.Some, "crps": base.Some,
    "log_score": base.Some, "covered50": bool, "covered90": bool, "no_answer": Number, "detail": str,
})  # fmt: skip
SoilTests = TypedDict("SoilTests", {"checks": dict[str, base.Some], "alarm": bool})
FAILING = {
    "evidence": ("evidence",),
    "directions": ("directions", "identifiability"),
    "predictive_checks": ("predictive_checks",),
    "prior_checks": ("prior_checks", "prior_predictive"),
    "loo": ("loo",),
}
"""Entries of a record that may be missing where its ``failures`` name one of these."""
OF_WHEELS = ("predictive_checks", "prior_checks", "loo")
"""Those that are about rows of wheels."""


def _same_length(loo: LeftOut) -> LeftOut:
    if len(loo["rows"]) != len(loo["full"]):
        raise ValueError("must have as many rows as densities")
    return loo


class RunRecord(base.StudyRecord):
    """The content of ``run.json`` of a run on one soil."""

    sampling: Sampling
    evidence: Evidence
    prior_support: PriorSupport
    mode: Mode
    fits: dict[Method, Fit]
    refused_fits: list[str]
    standings: dict[Method | Literal["mode", "conditional", "published", "truth"], Standing]
    directions: Directions
    predictive_checks: Checks
    prior_checks: PriorChecks
    loo: Annotated[LeftOut, AfterValidator(_same_length)]
    levels: list[Reading] = Field(default_factory=list)
    noise: dict[Literal["half", "double"], OtherNoise] = Field(default_factory=dict)
    next: NextDrive | None = None
    soil_tests: SoilTests | None = None

    @classmethod
    def excused(cls, content: dict[str, Any]) -> Collection[str]:
        """Entries that may be missing because they, or what they rest on, could not be computed."""
        failed = set(content.get("failures", ()))
        if not content.get("model", " "):  # no wheel: soil tests alone
            return ("evidence", "directions", *OF_WHEELS)
        return [name for name, causes in FAILING.items() if failed & set(causes)]


class RunResult(base.Result):
    """The outcome of a run on one soil."""

    RECORD = RunRecord
    VIEW = "bayesterra.analysis.page:run"

    @cached_property
    def validation(self) -> Validation:
        """Predictive checks under posterior and prior, and leave-one-out by row."""
        return Validation.from_record(self.record)

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Verdicts on sampling, fit, prediction and soil, from tables and record; none where these failed."""
        if failed(self.record, "verdicts"):
            return ()
        record, checked, rows = self.record, self.validation, self.study.observations.used()
        readings = int(sum((~np.isnan(rows.values[name])).sum() for name in self.study.noise))
        failed_ = {part: failed(record, part) for part in ("predictive_checks", "levels", "directions")}
        directions, table, tested = record.get("directions"), self.identifiability, list[Verdict]()
        if self.study.soil_tests:
            tested = [verdict_on_tests(self.new_tests, record.get("soil_tests"), failed(record, "left_out"))]
        soil = unknown_verdict("Soil", failed(record, "identifiability", "directions"))
        if directions is not None:
            conflict = checked.prior is not None and checked.prior.conflict
            soil = soil_verdict(table, directions, conflict=conflict)
        if not self.study.wheels:
            return (sampling_verdict(record), *tested, soil)
        return (
            sampling_verdict(record),
            *tested,
            fit_verdict(checked.checks, readings, len(self.names), failed_["predictive_checks"]),
            prediction_verdict(checked.levels, self.study.model.name, failed_["levels"]),
            soil,
        )

    @property
    def sentence(self) -> str:
        """What may be quoted of the result."""
        return quotable(self.verdicts, scope(self.study), untested(self.study))

    def tables(self) -> Mapping[str, pd.DataFrame]:
        """Tables by the names of their CSV files: those that the study has."""
        tables = {**super().tables(), "new_tests": self.new_tests, "bands": self.bands}
        return {name: table for name, table in tables.items() if len(table.columns)}

    @property
    def judged(self) -> Self:
        """The same with its verdicts and its sentence in the record."""
        verdicts = [verdict.record() for verdict in self.verdicts]
        return replace(self, record={**self.record, "verdicts": verdicts, "sentence": self.sentence})


@dataclass(frozen=True, kw_only=True, repr=False)
class PriorResult(base.DrawnResult):
    """Result of a study before its readings.

    Attributes
    ----------
    study : what was asked; its readings, where there are any, are not used.
    draws : xarray DataTree with the groups prior, prior_predictive, constant_data and curves; SI, radians.
    summary : one row per parameter and derived quantity, in field units, of the prior after the physical cut.
    predictive : per row and channel: quantiles of readings that the prior predicts, in field units.
    record : versions, seed, fingerprints and shares of the prior by reason of the cut.
    """

    TABLES = ("summary", "predictive")
    RECORD = base.PriorRecord
    GROUP = "prior"
    VIEW = "bayesterra.analysis.prior_page:prior"
    WITH_STUDY = True

    study: Study
    predictive: pd.DataFrame


_HELD = tomllib.loads(read_text(Path(__file__).with_name("result.toml"), MEGABYTE))
COLUMNS: Mapping[str, Mapping[str, str]] = _HELD["columns"]
"""Columns that tables must have, by kind: ``number``, ``text``, or a name of one of these."""
NAMES: Mapping[str, Collection[str]] = {
    "parameter": PARAMETERS, "quantity": ChainMap[str, Any](PARAMETERS, DERIVED), "channel": CHANNELS,
}  # fmt: skip
GROUPS: Mapping[str, Sequence[str]] = _HELD["groups"]
"""Groups of ``draws.nc``, and the dimensions of all that is in them.

Older files have all rows of the table under ``row``, and the log likelihood of those in the fit under
``used_row``.
"""


def check_tables(tables: Mapping[str, pd.DataFrame], names: Sequence[str]) -> None:
    """ValueError where a table lacks a column, or a column holds something else.

    Parameters
    ----------
    tables : of a result, by name.
    names : free parameters of its study; every table of parameters begins with them.
    """
    for name, columns in COLUMNS.items():
        for column, kind in columns.items() if name in tables else ():
            _check_column(tables[name], column, kind, f"{name}.csv")
    for name in ("summary", "identifiability"):
        if tables[name]["parameter"].tolist()[: len(names)] != list(names):
            raise ValueError(f"{name}.csv is about other parameters than the study")
        if tables[name]["parameter"].duplicated().any():
            raise ValueError(f"{name}.csv has a parameter twice")
    partners = tables["identifiability"].get("partner", pd.Series(dtype=object)).dropna()
    if not set(partners) <= set(names):
        raise ValueError("identifiability.csv names other parameters than the study")


def _check_column(table: pd.DataFrame, column: str, kind: str, place: str) -> None:
    if column not in table:
        raise ValueError(f"{place} lacks the column '{column}'")
    if list(table.columns).count(column) > 1:
        raise ValueError(f"{place} has the column '{column}' twice")
    values = table[column]
    if kind == "number":
        if not pd.api.types.is_numeric_dtype(values) or pd.api.types.is_complex_dtype(values):
            raise ValueError(f"{place}: '{column}' must hold numbers")
    elif not all(isinstance(v, str) and (kind == "text" or whole_and_part(v)[0] in NAMES[kind]) for v in values):
        raise ValueError(f"{place}: '{column}' holds what does not belong there")


def check_draws(tree: xr.DataTree, study: Study) -> None:
    """ValueError where groups, dimensions or parameters are not those of a result of this study."""
    older = "log_likelihood" in tree.children and "used_row" in tree["log_likelihood"].dims
    of_fit = {"log_likelihood": ("chain", "draw", "used_row")} if older else {}
    needed = {n: dims for n, dims in {**GROUPS, **of_fit}.items() if study.wheels or dims[-1] == "draw"}
    for group, dims in needed.items():
        if group not in tree.children:
            raise ValueError(f"draws.nc lacks the group '{group}'")
        for name, values in tree[group].data_vars.items():
            if set(values.dims) != set(dims) or values.dtype.kind not in "iuf" or not values.size:
                raise ValueError(f"draws.nc: '{group}' holds '{name}', which is of another form")
    names = set(study.prior.names)
    for group in ("posterior", "prior"):
        held = {str(name): values for name, values in tree[group].data_vars.items()}
        if set(held) != names:
            raise ValueError(f"draws.nc: '{group}' is about other parameters than the study")
        for name, values in held.items():
            if values.dims != ("chain", "draw") or not np.isfinite(values.to_numpy()).all():
                raise ValueError(f"draws.nc: '{group}' holds draws of '{name}' that are no numbers")
    if "lp" not in tree["sample_stats"].data_vars:
        raise ValueError("draws.nc lacks the log densities of its draws")
    used = int(study.observations.use.sum())
    rows = len(study.observations) if older else used
    sizes = dict.fromkeys(("observed_data", "posterior_predictive", "prior_predictive"), rows)
    for group, size in {**sizes, "log_likelihood": used}.items() if study.wheels else ():
        if tree[group].sizes[{**GROUPS, **of_fit}[group][-1]] != size:
            raise ValueError(f"draws.nc: '{group}' has other rows than the study")


def read_result(folder: Path) -> RunResult:
    """Read the result folder of a run on one soil.

    ResultError where the folder is missing, incomplete or damaged, of another kind, as a joint posterior of several
    groups is, or of another format.
    """
    if not folder.is_dir():
        raise ResultError(f"'{folder}' is not a result folder: there is no such folder")
    if missing := _missing(folder, RunResult):
        if is_pooled(folder):
            raise ResultError(
                f"'{folder}' holds a joint posterior of several groups ([pooling]): give one without groups"
            )
        if is_prior(folder):
            raise ResultError(f"'{folder}' holds a prior without readings (run --prior-only): there is no posterior")
        raise ResultError(f"'{folder}' is not a complete result folder: {', '.join(missing)} missing")
    with damage(ResultError, folder):
        content = _content(folder, RunResult)
        Validation.from_record(content["record"])
        study = content["study"]
        check_tables(content, study.prior.names)
        check_draws(content["draws"], study)
        return RunResult(**content)


def read_pooled(folder: Path) -> PooledResult:
    """Read the result folder of a study with groups.

    ResultError where it is incomplete or damaged, or of another format.
    """
    if missing := _missing(folder, PooledResult):
        raise ResultError(f"'{folder}' is not a complete result folder: {', '.join(missing)} missing")
    with damage(ResultError, folder):
        return PooledResult(**_content(folder, PooledResult))


def _files(kind: type[base.Result], folder: Path) -> tuple[str, ...]:
    """Files that a folder must hold, and tables of soil tests that it holds; few are about wheels."""
    tables, extra = (f"{name}.csv" for name in kind.TABLES), (f"{name}.csv" for name in ("new_tests", "bands"))
    held = [name for name in extra if (folder / name).is_file()]
    alone = any(folder.glob("soil-test-*.csv")) and not (folder / "measurements.csv").is_file()
    idle = ("measurements.csv", "predictive.csv") if alone else ()
    return tuple(n for n in (DRAWS, RECORD, "study.toml", "measurements.csv", *tables, *held) if n not in idle)


def _missing(folder: Path, kind: type[base.Result]) -> list[str]:
    return [name for name in _files(kind, folder) if not (folder / name).is_file()]


def _content(folder: Path, kind: type[RunResult | PooledResult]) -> dict[str, Any]:
    """Fields of a result by name, read from the files of a folder."""
    files = _files(kind, folder)
    check_sums(folder, *files)
    tables = {name.removesuffix(".csv"): read_csv(folder / name) for name in files if name.endswith(".csv")}
    tables.pop("measurements", None)
    know_model(folder)
    record, draws = kind.RECORD.read(folder / RECORD), read_tree(folder / DRAWS)
    study = load_study(folder)
    groups = [name for name in ("constant_data", "predictions_constant_data") if name in draws.children]
    # rows have the numbers of the table of the run, some of which it may have left out
    numbers = sorted(int(row) for name in groups for row in draws[name]["row"])
    if len(numbers) == len(study.observations):  # damage is said where it is checked
        study = study.having(observations=replace(study.observations, rows=tuple(numbers)))
    return {**tables, "record": record, "draws": draws, "study": study}


def is_pooled(folder: Path) -> bool:
    """True where a folder was written by a run of a study with groups."""
    return _marked(folder, "pooling")


def is_prior(folder: Path) -> bool:
    """True where a folder holds a prior without readings."""
    return _marked(folder, "prior_only")


def _marked(folder: Path, key: str) -> bool:
    """True where the record of a folder has an entry that says what kind of result it is."""
    try:
        return bool(read_json(folder / RECORD).get(key))
    except (OSError, ValueError, AttributeError):
        return False


def draws_tree(
    study: Study,
    posterior: Posterior,
    chains: FloatArray,
    labels: Mapping[str, FloatArray],
    prior: FloatArray,
    predictions: Mapping[str, RowPredictions],
    curves: xr.Dataset | None,
) -> xr.DataTree:
    """Assemble the ArviZ groups.

    Parameters
    ----------
    chains : kept draws (chain, draw, d), walker after walker.
    labels : per draw (chain, draw): ``walker`` and ``step``.
    prior : draws of the cut prior (n, d).
    predictions : by group, ``prior_predictive`` and ``posterior_predictive``; of all rows of the table.
    curves : of :func:`curves_dataset`; None where they could not be computed.
    """
    shape, flat, two = chains.shape[:2], chains.reshape(-1, chains.shape[2]), ("chain", "draw")
    laws, use, log_density = posterior.prior.laws, study.observations.use, posterior.log_before(flat)
    groups: dict[str, xr.Dataset] = {}
    if posterior.driven:
        every = one_in(len(use), len(flat))
        kept = chains[:, ::every]
        pointwise, log_density = posterior.log_terms(kept.reshape(-1, kept.shape[2])), posterior.log_density(flat)
        told = _rows(posterior.likelihood, pointwise.reshape(*kept.shape[:2], *pointwise.shape[1:]))
        predicted = {name: predictions_dataset(study, rows) for name, rows in predictions.items()}
        predicted["posterior_predictive"] = predicted["posterior_predictive"].assign_coords(draw=every * told["draw"])
        groups = {
            "log_likelihood": told.assign_coords(draw=every * told["draw"]),
            **{name: base.of_rows(dataset, use) for name, dataset in predicted.items()},
            "observed_data": base.of_rows(base.observed_dataset(study), use),
            "constant_data": base.of_rows(base.conditions_dataset(study), use),
            **({"curves": curves} if curves is not None else {}),
        }
    if not use.all():
        groups["predictions"] = base.of_rows(predicted["posterior_predictive"], ~use)
        groups["predictions_constant_data"] = base.left_out_dataset(study)
    for experiment in posterior.experiments:
        terms = experiment.log_likelihoods(flat).reshape(*shape, -1)
        dataset = base.labelled_dataset({"log_likelihood": ((*two, "test"), terms)})
        groups[f"soil_test_{experiment.test.name}"] = dataset.assign_coords(test=list(experiment.readings.tests))
    stated, stretch = posterior.prior.stated(flat), posterior.prior.log_stretch(flat)
    densities = {n: law.log_density(stated[:, i]) + stretch[:, i] for i, (n, law) in enumerate(laws.items())}
    stats = {"lp": (two, log_density.reshape(shape)), **{name: (two, values) for name, values in labels.items()}}
    whole = {
        "posterior": base.parameter_dataset(posterior.names, chains),
        "sample_stats": base.labelled_dataset(stats),
        "log_prior": base.labelled_dataset(
            {name: (two, density.reshape(shape)) for name, density in densities.items()}
        ),
        "prior": base.parameter_dataset(posterior.names, prior[None]),
    }
    return labelled_tree({**whole, **groups})


def _rows(likelihood: Likelihood, pointwise: FloatArray) -> xr.Dataset:
    """Log likelihood of the rows in the fit per term: a channel, or all ``readings``; NaN where none was read."""
    silent: BoolArray = np.isnan(likelihood.measured)
    if likelihood.terms != likelihood.channels:
        silent = np.asarray(silent.all(axis=1, keepdims=True))
    values = np.where(silent, np.nan, pointwise)
    return _by_row(likelihood.terms, values, likelihood.observations.rows)


def predictions_dataset(study: Study, rows: RowPredictions) -> xr.Dataset:
    """Readings with noise of all rows; a single chain unless the caller says otherwise."""
    chains = len(rows.readings) if rows.readings.ndim == 4 else 1
    readings = rows.readings.reshape(chains, -1, *rows.readings.shape[-2:])
    return _by_row(rows.channels, readings, study.observations.rows)


SINGLE = 50
"""Rows above which what is kept of each has single precision."""


def _by_row(names: Sequence[str], values: FloatArray, rows: Sequence[int]) -> xr.Dataset:
    """Values (chain, draw, row, names) with the numbers of the rows; of many rows to seven digits."""
    held, dims = values.astype(np.float32) if len(rows) > SINGLE else values, ("chain", "draw", "row")
    dataset = base.labelled_dataset({name: (dims, held[..., i]) for i, name in enumerate(names)})
    return dataset.assign_coords(row=list(rows))


def curves_dataset(curves: tuple[Curves, ...]) -> xr.Dataset:
    """Quantiles over the draws of every wheel's curves; SI."""
    dims = ("wheel", "quantile", "point", "outcome")
    with np.errstate(all="ignore"):
        stacks = {
            name: np.stack([answered_quantiles(getattr(curve, name), base.CURVE_QUANTILES) for curve in curves])
            for name in ("modelled", "readings")
        }
    dataset = base.labelled_dataset(
        {
            **{name: (dims, values) for name, values in stacks.items()},
            "slip": (("wheel", "point"), np.stack([curve.slip for curve in curves])),
            "given": (("wheel", "point"), np.stack([curve.given for curve in curves])),
        }
    )
    return dataset.assign_coords(
        wheel=[curve.wheel for curve in curves], quantile=list(base.CURVE_QUANTILES), outcome=list(curves[0].outcomes)
    )
