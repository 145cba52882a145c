"""Result of a run: labelled draws, tables with typed rows, and the record of how they were made."""

from __future__ import annotations

import platform
from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.parameters import MODEL_PARAMETERS, PARAMETERS
from bayesterra.runtime.checkpoints import digest
from bayesterra.study.canonical import identity
from bayesterra.study.study import Study

CURVE_QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)


@dataclass(frozen=True)
class Result:
    """The outcome of a run; everything a report shows is in here and in the folder it is saved to.

    Attributes
    ----------
    study : what was asked.
    draws : xarray DataTree with ArviZ groups (posterior, sample_stats, log_prior, log_likelihood, prior,
        prior_predictive, posterior_predictive, observed_data, constant_data) and ``curves``; SI, radians.
        Their ``row`` is one of the fit; rows left out stand in ``predictions`` and
        ``predictions_constant_data``, the latter with the readings that they have.
    summary : one row per parameter and derived quantity, in field units.
    least_squares : point estimates of every method and where they stand in the posterior.
    identifiability : one row per parameter: verdict, contraction, strongest coupling.
    predictive : per row and channel: reading and predictive quantiles, in field units.
    record : versions, seed, settings, fingerprints, times and the verdict with every threshold.
    """

    study: Study
    draws: xr.DataTree
    summary: pd.DataFrame
    least_squares: pd.DataFrame
    identifiability: pd.DataFrame
    predictive: pd.DataFrame
    record: dict[str, Any]

    @property
    def converged(self) -> bool:
        """True where every check of the sampling passed."""
        return bool(self.record["verdict"]["converged"])

    @property
    def names(self) -> tuple[str, ...]:
        """Free parameters in the posterior's order."""
        held = self.draws["posterior"].data_vars
        return tuple(name for name in PARAMETERS if name in held)

    def values(self, group: str = "posterior") -> FloatArray:
        """Draws of all parameters (n, d) of a group, ``posterior`` or ``prior``; SI, radians."""
        data = self.draws[group]
        return np.column_stack([data[name].to_numpy().ravel() for name in self.names])

    def to_dataframe(self) -> pd.DataFrame:
        """Posterior draws, one row each: chain (ensemble), draw, then the parameters in SI and radians."""
        return pd.DataFrame(self.draws["posterior"].to_dataset().to_dataframe()).reset_index()

    def _repr_html_(self) -> str:
        return str(self.summary.to_html(index=False, float_format=lambda value: f"{value:.4g}"))


def labelled_dataset(variables: Mapping[str, tuple[tuple[str, ...], Any]], **attributes: Any) -> xr.Dataset:
    """Dataset of variables with their dimensions, and attributes."""
    dataset = xr.Dataset({name: (dims, values) for name, (dims, values) in variables.items()})
    sizes = {dim: size for dim, size in dataset.sizes.items() if dim not in dataset.coords}
    coordinates = {str(dim): np.arange(size) for dim, size in sizes.items()}
    return dataset.assign_coords(coordinates).assign_attrs(attributes)


def parameter_dataset(names: tuple[str, ...], chains: FloatArray) -> xr.Dataset:
    """Label draws (chain, draw, d) by parameter; each variable says its unit, in SI."""
    dataset = labelled_dataset({name: (("chain", "draw"), chains[:, :, i]) for i, name in enumerate(names)})
    for name in names:
        parameter = PARAMETERS[name]
        unit = {"phi": "rad", "Ks": "Pa/m^N"}.get(name, parameter.dimension or "1")
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


def soil_columns(names: tuple[str, ...]) -> list[str]:
    """Those of ``names`` that are parameters of a model."""
    return [name for name in names if name in MODEL_PARAMETERS]


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

    @property
    def hdi(self) -> tuple[float, float]:
        """The ends of the 90 % highest-density interval."""
        return self.hdi90_lo, self.hdi90_hi


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
    multiple: float
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


def summary_rows(result: Result) -> dict[str, SummaryRow]:
    """Rows of the summary by parameter or derived quantity, in its order."""
    names = [field.name for field in fields(SummaryRow)]
    return {
        name: SummaryRow(**{key: float(row[key]) for key in names}) for name, row in _records(result.summary)
    }


def identifiability_rows(result: Result) -> dict[str, IdentifiabilityRow]:
    """Rows of the identifiability table by parameter, in its order."""
    return {
        name: IdentifiabilityRow(
            str(row["verdict"]),
            float(row["contraction"]),
            str(row["partner"]),
            float(row["correlation"]),
            str(row["bound"]),
            # folders of versions that did not have these columns coupled with any parameter
            str(row.get("tied_to", row["partner"])),
            float(row.get("tie", row["correlation"])),
            float(row.get("multiple", np.nan)),
            float(row.get("shift", np.nan)),
        )
        for name, row in _records(result.identifiability)
    }


def _records(table: pd.DataFrame) -> list[tuple[str, dict[str, float | str]]]:
    return [(str(row["parameter"]), {str(k): v for k, v in row.items()}) for row in table.to_dict("records")]


COUPLED = 0.8
"""Absolute correlation from which two parameters, neither of them determined, are coupled."""

PACKAGES = ("bayesterra", "numpy", "scipy", "numba", "emcee", "arviz-base", "arviz-stats", "xarray")


def run_record(
    study: Study, seed: int, findings: dict[str, Any], seconds: dict[str, float]
) -> dict[str, Any]:
    """Put together the content of ``run.json``.

    Parameters
    ----------
    findings : verdicts and figures of the analysis.
    seconds : wall time by stage.
    """
    return {
        **_origin(study, seed),
        "settings": {
            "target_ess": study.sampling.target_ess,
            "ensembles": study.sampling.ensembles,
            "walkers": study.sampling.walkers,
            "max_steps": study.sampling.max_steps,
        },
        "seconds": seconds,
        **findings,
    }


def prior_record(study: Study, seed: int, support: dict[str, Any]) -> dict[str, Any]:
    """Put together the content of ``run.json`` of a prior without readings; ``support``: its physical cut."""
    return {**_origin(study, seed), "prior_only": True, "prior_support": support}


def _origin(study: Study, seed: int) -> dict[str, Any]:
    """Origin of a run: its study and what it was run with."""
    return {
        "title": study.title,
        "kind": study.kind,
        "source": study.source,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
        "machine": f"{platform.system()} {platform.machine()}",
        "seed": seed,
        "model": study.model.name,
        "drive": study.drive,
        "fingerprints": {**study.fingerprint, "run": digest(identity(study, seed))},
        "notes": list(study.notes),
        **({"priors_from": [prior.record() for prior in study.taken]} if study.taken else {}),
    }
