"""What a run leaves: labelled draws, tables, and a record of how they were made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.likelihood import Likelihood
from bayesterra.netcdf import labelled_tree
from bayesterra.parameters import CHANNELS, MODEL_PARAMETERS, PARAMETERS
from bayesterra.posteriors import Posterior
from bayesterra.predictive import Curves, RowPredictions
from bayesterra.study import Study

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
        """Whether every check of the sampling passed."""
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
    shape, flat = chains.shape[:2], chains.reshape(-1, chains.shape[2])
    pointwise = posterior.log_terms(flat)
    apart = posterior.likelihood.rows_apart
    total = pointwise.sum(axis=(1, 2)) if apart else posterior.log_rows(flat)[0]
    log_density = posterior.log_prior(flat) + total
    laws, use = posterior.prior.laws, study.observations.use
    predicted = {name: predictions_dataset(study, rows) for name, rows in predictions.items()}
    groups = {
        "posterior": parameter_dataset(posterior.names, chains),
        "sample_stats": labelled_dataset(
            {
                "lp": (("chain", "draw"), log_density.reshape(shape)),
                **{name: (("chain", "draw"), values) for name, values in labels.items()},
            }
        ),
        "log_prior": labelled_dataset(
            {
                name: (("chain", "draw"), law.log_density(chains[:, :, i]))
                for i, (name, law) in enumerate(laws.items())
            }
        ),
        "log_likelihood": _rows(posterior.likelihood, pointwise.reshape(*shape, *pointwise.shape[1:])),
        "prior": parameter_dataset(posterior.names, prior[None]),
        **{name: of_rows(dataset, use) for name, dataset in predicted.items()},
        "observed_data": of_rows(observed_dataset(study), use),
        "constant_data": of_rows(conditions_dataset(study), use),
        **({"curves": curves} if curves is not None else {}),
    }
    if not use.all():
        groups["predictions"] = of_rows(predicted["posterior_predictive"], ~use)
        groups["predictions_constant_data"] = left_out_dataset(study)
    return labelled_tree(groups)


def of_rows(dataset: xr.Dataset, chosen: BoolArray) -> xr.Dataset:
    """Some rows of a dataset that has all rows of the table."""
    return dataset.isel(row=np.flatnonzero(chosen))


def _rows(likelihood: Likelihood, pointwise: FloatArray) -> xr.Dataset:
    """Log likelihood of the rows in the fit, per term; NaN where nothing was measured.

    A term is a channel, or ``readings`` where a latent load joins the readings of a row.
    """
    silent: BoolArray = np.isnan(likelihood.measured)
    if likelihood.terms != likelihood.channels:
        silent = np.asarray(silent.all(axis=1, keepdims=True))
    values = np.where(silent, np.nan, pointwise)
    dims = ("chain", "draw", "row")
    dataset = labelled_dataset({name: (dims, values[..., i]) for i, name in enumerate(likelihood.terms)})
    return dataset.assign_coords(row=list(likelihood.observations.rows))


def predictions_dataset(study: Study, rows: RowPredictions) -> xr.Dataset:
    """Readings with noise of all rows; a single chain unless the caller says otherwise."""
    chains = len(rows.readings) if rows.readings.ndim == 4 else 1
    readings = rows.readings.reshape(chains, -1, *rows.readings.shape[-2:])
    dims = ("chain", "draw", "row")
    dataset = labelled_dataset({name: (dims, readings[..., i]) for i, name in enumerate(rows.channels)})
    return dataset.assign_coords(row=list(study.observations.rows))


def observed_dataset(study: Study) -> xr.Dataset:
    """The readings of all rows of the table."""
    values = study.observations.values
    dataset = labelled_dataset({name: (("row",), values[name]) for name in study.noise}, kind=study.kind)
    return dataset.assign_coords(row=list(study.observations.rows))


def conditions_dataset(study: Study) -> xr.Dataset:
    """What the rows were driven under."""
    observations = study.observations
    variables: dict[str, tuple[tuple[str, ...], Any]] = {
        "slip": (("row",), observations.slip),
        "load": (("row",), observations.load),
        "use": (("row",), observations.use.astype(np.int8)),
        "wheel": (("row",), np.array(observations.wheel, dtype=object)),
    }
    if study.drive == "sinkage":
        variables["sinkage"] = (("row",), observations.values["sinkage"])
    return labelled_dataset(variables).assign_coords(row=list(observations.rows))


def left_out_dataset(study: Study) -> xr.Dataset:
    """Conditions and readings of the rows that are not in the fit."""
    both = conditions_dataset(study).merge(observed_dataset(study))
    return of_rows(both.assign_attrs(kind=study.kind), ~study.observations.use)


def curves_dataset(curves: tuple[Curves, ...]) -> xr.Dataset:
    """Quantiles over the draws of every wheel's curves; SI."""
    dims = ("wheel", "quantile", "point", "outcome")
    with np.errstate(all="ignore"):
        stacks = {
            name: np.stack([_quantiles(getattr(curve, name)) for curve in curves])
            for name in ("modelled", "readings")
        }
    dataset = labelled_dataset(
        {
            **{name: (dims, values) for name, values in stacks.items()},
            "slip": (("wheel", "point"), np.stack([curve.slip for curve in curves])),
            "given": (("wheel", "point"), np.stack([curve.given for curve in curves])),
        }
    )
    return dataset.assign_coords(
        wheel=[curve.wheel for curve in curves],
        quantile=list(CURVE_QUANTILES),
        outcome=list(curves[0].outcomes),
    )


def _quantiles(values: FloatArray) -> FloatArray:
    """Quantiles over draws (n, g, k) of the draws that have an answer, (quantiles, g, k)."""
    filled = np.moveaxis(values, 0, -1)
    result = np.full((len(CURVE_QUANTILES), *filled.shape[:-1]), np.nan)
    for index in np.ndindex(filled.shape[:-1]):
        answered = filled[index][np.isfinite(filled[index])]
        if answered.size:
            result[(slice(None), *index)] = np.quantile(answered, CURVE_QUANTILES)
    return result


def soil_columns(names: tuple[str, ...]) -> list[str]:
    """Those of ``names`` that are parameters of a model."""
    return [name for name in names if name in MODEL_PARAMETERS]


def field_values(name: str, values: FloatArray) -> FloatArray:
    """SI values of a parameter or channel in its field unit."""
    known = PARAMETERS.get(name) or CHANNELS[name]
    return values / known.scale
