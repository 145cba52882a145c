"""The main job: a study in, a result out."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.random import SeedSequence, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.comparison import Standing, stand
from bayesterra.derived import DERIVED, derive
from bayesterra.diagnostics import Diagnosis, array_ess, array_r_hat, hdi, monte_carlo_error, thinning
from bayesterra.identifiability import Identifiability, identifiability
from bayesterra.identification import Fit, fit_all, report_table
from bayesterra.mode import Mode, find_mode
from bayesterra.parameters import NOISE_PREFIX, PARAMETERS, Parameter
from bayesterra.posteriors import Posterior, PriorDraws, draw_cut_prior, posterior
from bayesterra.predictive import predict_curves, predict_rows, predictive_table
from bayesterra.record import run_record
from bayesterra.results import Result, curves_dataset, draws_tree
from bayesterra.sampling.sampler import Progress, Samples, sample
from bayesterra.study import Study

PRIOR_DRAWS = 4000
CURVE_DRAWS = 1000
CREDIBLE = 0.9


@dataclass(frozen=True)
class Kept:
    """Near-independent draws of all ensembles.

    Attributes
    ----------
    chains : (ensembles, draws, d), laid walker after walker.
    labels : walker and step of every draw, (ensembles, draws) each.
    every : one step in ``every`` is kept.
    """

    chains: FloatArray
    labels: dict[str, FloatArray]
    every: int

    @property
    def flat(self) -> FloatArray:
        """All draws (n, d)."""
        return self.chains.reshape(-1, self.chains.shape[2])


def keep(chains: FloatArray) -> Kept:
    """Thin chains (ensembles, steps, walkers, d) to near independence and lay them walker after walker."""
    every = thinning(np.ascontiguousarray(np.moveaxis(chains, -1, 0)))
    thinned = chains[:, ::every].swapaxes(1, 2)
    ensembles, walkers, steps, d = thinned.shape
    walker, step = np.divmod(np.arange(walkers * steps), steps)
    labels = {
        "walker": np.tile(walker, (ensembles, 1)),
        "step": np.tile(step * every, (ensembles, 1)),
    }
    return Kept(thinned.reshape(ensembles, walkers * steps, d), labels, every)


def run(study: Study, *, seed: int = 1, report: Callable[[Progress], None] = lambda progress: None) -> Result:
    """Sample the posterior of a study and set it beside the least-squares estimates.

    Parameters
    ----------
    study : what to analyse.
    seed : the same seed gives the same draws on one machine, whatever the number of cores.
    report : called as the sampling goes on.

    Returns
    -------
    Result : also when the sampling did not converge; ``result.converged`` says so.

    Raises
    ------
    SupportError : the prior leaves no parameter set that fits the conditions of the data.
    """
    started = time.perf_counter()
    target = posterior(study)
    sampling, prior_stream, predicting = SeedSequence(seed).spawn(3)
    prior = draw_cut_prior(target, PRIOR_DRAWS, default_rng(prior_stream))
    samples = sample(target, study.sampling, sampling, report)
    report(Progress("comparing", 1.0))
    kept = keep(samples.chains)
    fits, refused = fit_all(study)
    mode = find_mode(target, _subset(kept.flat, 4000), [fitted.values() for fitted in fits.values()])
    analysis = Analysis(study, target, prior, samples, kept, mode, fits, refused)
    result = analysis.result(default_rng(predicting))
    seconds = {**samples.seconds, "total": time.perf_counter() - started}
    return replace(result, record=run_record(study, seed, analysis.findings(result), seconds))


def _subset(draws: FloatArray, most: int) -> FloatArray:
    """Evenly spaced draws, ``most`` at most."""
    return draws[:: max(1, -(-len(draws) // most))]


@dataclass(frozen=True)
class Analysis:
    """Everything a run found, before it is put into tables."""

    study: Study
    posterior: Posterior
    prior: PriorDraws
    samples: Samples
    kept: Kept
    mode: Mode
    fits: Mapping[str, Fit]
    refused: tuple[str, ...]

    def result(self, rng: np.random.Generator) -> Result:
        """Tables and labelled draws; the record is still empty."""
        draws = self._draws(rng)
        standings = self.standings(draws["sample_stats"]["lp"].to_numpy().ravel())
        found = identifiability(self.posterior.names, self.prior.x, self.kept.flat)
        rows = predict_rows(self.study, self.posterior, _subset(self.kept.flat, 4000), rng)
        return Result(
            study=self.study,
            draws=draws,
            summary=self.summary(),
            least_squares=self.least_squares(standings),
            identifiability=found.table,
            predictive=predictive_table(self.study, rows),
            record={
                "standings": {name: _standing_record(s) for name, s in standings.items()},
                "directions": _direction_record(found),
            },
        )

    def _draws(self, rng: np.random.Generator) -> xr.DataTree:
        rows = predict_rows(self.study, self.posterior, self.kept.flat, rng)
        shape = (*self.kept.chains.shape[:2], *rows.readings.shape[1:])
        by_chain = replace(rows, modelled=rows.modelled.reshape(shape), readings=rows.readings.reshape(shape))
        tree = draws_tree(
            self.study,
            self.posterior,
            self.kept.chains,
            self.kept.labels,
            self.prior.x,
            {
                "prior_predictive": predict_rows(self.study, self.posterior, self.prior.x, rng),
                "posterior_predictive": by_chain,
            },
        )
        curves = predict_curves(self.study, self.posterior, _subset(self.kept.flat, CURVE_DRAWS), rng)
        tree["curves"] = xr.DataTree(curves_dataset(curves))
        return tree

    def points(self) -> dict[str, dict[str, float]]:
        """Point estimates by method: the mode, every least-squares fit, the published values."""
        points = {"mode": dict(zip(self.posterior.names, map(float, self.mode.x), strict=True))}
        points |= {name: fitted.values() for name, fitted in self.fits.items()}
        for name, reference in (("published", self.study.published), ("truth", self.study.truth)):
            if reference is not None:
                points[name] = dict(reference.values)
        return points

    def standings(self, densities: FloatArray) -> dict[str, Standing]:
        """Where every point estimate stands among the draws' log densities (n,)."""
        soil_only = {
            method: {k: v for k, v in values.items() if not k.startswith(NOISE_PREFIX)}
            for method, values in self.points().items()
        }
        return stand(self.posterior, self.kept.flat, densities, soil_only)

    def least_squares(self, standings: Mapping[str, Standing]) -> pd.DataFrame:
        """The table of point estimates with the share of draws denser than each."""
        table = report_table(self.fits, self.study)
        levels = {method: standing.credible_level for method, standing in standings.items()}
        return table.assign(credible_level=table["method"].map(levels))

    def summary(self) -> pd.DataFrame:
        """One row per free parameter, then one per derived quantity, in field units."""
        diagnosis = self.samples.diagnosis
        rows = [
            _summary_row(
                PARAMETERS[name],
                self.kept.chains[:, :, i],
                self.prior.x[:, i],
                float(self.mode.x[i]),
                (diagnosis.ess_bulk[i], diagnosis.ess_tail[i], diagnosis.r_hat[i]),
            )
            for i, name in enumerate(self.posterior.names)
        ]
        return pd.DataFrame(rows + self._derived_rows())

    def _derived_rows(self) -> list[dict[str, Any]]:
        subset = self.kept.chains[:, :: max(1, self.kept.chains.shape[1] // 1000)]
        soil = self.posterior.prior.soil_values
        chains = derive(self.study, soil(subset.reshape(-1, subset.shape[2])))
        prior = derive(self.study, soil(self.prior.x[:1000]))
        mode = derive(self.study, soil(self.mode.x[None]))
        return [
            _summary_row(
                quantity,
                chains[name].reshape(subset.shape[:2]),
                prior[name],
                float(mode[name][0]),
                _array_diagnosis(chains[name].reshape(subset.shape[:2])),
            )
            for name, quantity in DERIVED.items()
            if np.isfinite(chains[name]).any() and np.isfinite(prior[name]).any()
        ]

    def findings(self, result: Result) -> dict[str, Any]:
        """What the record keeps of this analysis."""
        return {
            "verdict": _verdict_record(self.samples.diagnosis),
            "sampling": {
                "acceptance": self.samples.diagnosis.acceptance,
                "steps": self.samples.diagnosis.steps,
                "kept_one_step_in": self.kept.every,
                "tau": dict(zip(self.posterior.names, self.samples.diagnosis.tau.tolist(), strict=True)),
                "temperatures": [len(a.temperatures) - 1 for a in self.samples.adaptations],
                "proposal_efficiency": [a.efficiency for a in self.samples.adaptations],
                "log_evidence": [a.log_evidence for a in self.samples.adaptations],
            },
            "prior_support": {"tried": self.prior.tried, "shares": dict(self.prior.shares)},
            "mode": {"log_density": self.mode.log_density, "agreeing_starts": self.mode.agreeing},
            "fits": {name: _fit_record(fitted) for name, fitted in self.fits.items()},
            "refused_fits": list(self.refused),
            **result.record,
        }


def _summary_row(
    quantity: Parameter,
    chains: FloatArray,
    prior: FloatArray,
    mode: float,
    diagnosis: Sequence[float],
) -> dict[str, Any]:
    """A row of ``summary.csv`` of chains (chains, draws), SI in, field units out."""
    chains, prior = chains / quantity.scale, prior[np.isfinite(prior)] / quantity.scale
    known = np.isfinite(chains)
    draws = chains[known]
    low, high = hdi(draws, CREDIBLE)
    complete = chains if known.all() else draws[: len(draws) // 4 * 4].reshape(4, -1)
    errors = {f"mcse_{s}": monte_carlo_error(complete, s) for s in ("mean", "median", "sd")}
    return {
        "parameter": quantity.name,
        "unit": quantity.unit,
        "mode": mode / quantity.scale,
        "mean": draws.mean(),
        "median": np.median(draws),
        "sd": draws.std(),
        "hdi90_lo": low,
        "hdi90_hi": high,
        **errors,
        **dict(zip(("ess_bulk", "ess_tail", "r_hat"), diagnosis, strict=True)),
        "prior_mean": prior.mean(),
        "prior_sd": prior.std(),
    }


def _array_diagnosis(chains: FloatArray) -> tuple[float, float, float]:
    chains = np.where(np.isfinite(chains), chains, np.nanmedian(chains))
    return array_ess(chains, "bulk"), array_ess(chains, "tail"), array_r_hat(chains)


def _verdict_record(diagnosis: Diagnosis) -> dict[str, Any]:
    return {
        "converged": diagnosis.converged,
        "ess": diagnosis.ess,
        "r_hat": diagnosis.worst_r_hat,
        "checks": [
            {
                "name": check.name,
                "value": check.value,
                "threshold": check.threshold,
                "passed": check.passed,
                "advice": check.advice,
            }
            for check in diagnosis.checks
        ],
    }


def _fit_record(fitted: Fit) -> dict[str, Any]:
    return {
        "converged": fitted.converged,
        "passes": fitted.passes,
        "errors_percent": dict(fitted.errors),
        "held": list(fitted.held),
        "at_bound": list(fitted.at_bound),
        "missing": list(fitted.missing),
        "notes": list(fitted.notes),
    }


def _standing_record(standing: Standing) -> dict[str, Any]:
    return {
        "credible_level": standing.credible_level,
        "log_density": standing.log_density if np.isfinite(standing.log_density) else None,
        "word": standing.word,
        "at_bound": list(standing.at_bound),
        "values": dict(standing.values),
    }


def _direction_record(found: Identifiability) -> dict[str, Any]:
    return {
        "determined": found.determined,
        "of": len(found.contractions),
        "contractions": found.contractions.tolist(),
    }
