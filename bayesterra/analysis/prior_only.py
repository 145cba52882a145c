"""The prior's own result, before any reading exists: what physics leaves of it and what it predicts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.random import SeedSequence, default_rng

from bayesterra.analysis.result import curves_dataset, predictions_dataset
from bayesterra.arrays import FloatArray
from bayesterra.checking.predictive import no_rows, predict_curves, predict_rows, predictive_table
from bayesterra.errors import check_kind, check_seed
from bayesterra.likelihood.forward import derive
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.parameters import DERIVED, PARAMETERS, Parameter
from bayesterra.report.failures import Failures, with_failures
from bayesterra.runtime.netcdf import labelled_tree
from bayesterra.stats.diagnostics import hdi
from bayesterra.study import result
from bayesterra.study.result import DrawnResult, PriorRecord, conditions_dataset, parameter_dataset
from bayesterra.study.study import Study

DRAWS = 4000
CURVE_DRAWS = 1000
CREDIBLE = 0.9


@dataclass(frozen=True, kw_only=True)
class PriorResult(DrawnResult):
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
    RECORD = PriorRecord
    GROUP = "prior"
    VIEW = "bayesterra.analysis.prior_page:prior"
    WITH_STUDY = True

    study: Study
    predictive: pd.DataFrame


def run_prior(study: Study, *, seed: int = 1) -> PriorResult:
    """Draw from the prior cut to the physical support and predict the rows of the table.

    Parameters
    ----------
    study : what to analyse; ``load_study(path, prior_only=True)`` reads one without readings.
    seed : same seed, same draws.

    Raises
    ------
    StudyError : no study is given.
    SupportError : the prior leaves no parameter set that fits the conditions of the table.
    """
    check_kind("bt.run_prior", study, Study)
    check_seed(seed)
    drawing, predicting = (default_rng(stream) for stream in SeedSequence(seed).spawn(2))
    target = posterior(study)
    cut = draw_cut_prior(target, DRAWS, drawing)
    failures = Failures()
    predictions = failures.attempt(
        "prior_predictive",
        lambda: predict_rows(study, target, cut.x, predicting, before=True),
        lambda: no_rows(study, len(cut.x)),
    )
    curves = failures.attempt(
        "curves",
        lambda: {"curves": curves_dataset(predict_curves(study, target, cut.x[:CURVE_DRAWS], predicting))},
        dict[str, xr.Dataset],
    )
    groups = {
        "prior": parameter_dataset(target.names, cut.x[None]),
        "prior_predictive": predictions_dataset(study, predictions),
        "constant_data": conditions_dataset(study),
        **curves,
    }
    record = result.prior_record(study, seed, {"tried": cut.tried, "shares": dict(cut.shares)})
    return PriorResult(
        study=study,
        draws=labelled_tree(groups),
        summary=_summary(study, cut.x, failures),
        predictive=predictive_table(study, predictions),
        record=with_failures(record, failures),
    )


def _summary(study: Study, x: FloatArray, failures: Failures) -> pd.DataFrame:
    derived = failures.attempt(
        "derived", lambda: derive(study, study.prior.soil_values(x[:CURVE_DRAWS])), dict[str, FloatArray]
    )
    quantities: Mapping[str, Parameter] = {**{n: PARAMETERS[n] for n in study.prior.names}, **DERIVED}
    values = {**dict(zip(study.prior.names, x.T, strict=True)), **derived}
    rows = [
        _row(quantity, values[name][np.isfinite(values[name])] / quantity.scale)
        for name, quantity in quantities.items()
        if name in values and np.isfinite(values[name]).any()
    ]
    return pd.DataFrame(rows)


def _row(quantity: Parameter, values: FloatArray) -> dict[str, Any]:
    low, high = hdi(values, CREDIBLE)
    return {
        "parameter": quantity.name,
        "unit": quantity.unit,
        "prior_mean": values.mean(),
        "prior_median": np.median(values),
        "prior_sd": values.std(),
        "prior_hdi90_lo": low,
        "prior_hdi90_hi": high,
    }
