"""Draws of a result as a labelled tree with ArviZ groups."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import xarray as xr

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.checking.predictive import Curves, RowPredictions
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.runtime.netcdf import labelled_tree
from bayesterra.study.result import (
    CURVE_QUANTILES,
    conditions_dataset,
    labelled_dataset,
    left_out_dataset,
    observed_dataset,
    of_rows,
    parameter_dataset,
)
from bayesterra.study.study import Study


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
