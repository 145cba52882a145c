"""The main job: a study in, a result out; or its prior alone, before any reading exists."""

import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.random import Generator, SeedSequence, default_rng
from threadpoolctl import threadpool_limits

from bayesterra.analysis.result import PriorResult, RunResult, curves_dataset, draws_tree, predictions_dataset
from bayesterra.arrays import FloatArray
from bayesterra.checking.predictive import (
    RowPredictions,
    no_rows,
    one_in,
    predict_at_read_loads,
    predict_curves,
    predict_rows,
    predictive_table,
)
from bayesterra.checking.soil_tests import new_tests
from bayesterra.checking.validation import Validation, validate
from bayesterra.errors import check_kind, check_seed
from bayesterra.identifiability import analysis as identifiability_analysis
from bayesterra.identifiability import structure as structures
from bayesterra.identifiability.information import information
from bayesterra.identifiability.verdicts import Identifiability, identifiability, undetermined
from bayesterra.least_squares import results
from bayesterra.least_squares.fit import fit_all
from bayesterra.least_squares.results import CONDITIONAL, Fit, PointEstimate, locate, point_rows, report_table
from bayesterra.least_squares.soil_tests import rows_of_tests
from bayesterra.likelihood.forward import derive
from bayesterra.likelihood.posterior import Posterior, PriorDraws, draw_cut_prior, posterior
from bayesterra.parameters import DERIVED, PARAMETERS, PRIOR_PARAMETERS, Parameter, of_soil_tests
from bayesterra.report.verdicts import Failures, with_failures
from bayesterra.runtime.checkpoints import CheckpointStore
from bayesterra.runtime.netcdf import labelled_tree
from bayesterra.sampling import evidence as evidences
from bayesterra.sampling import sampler
from bayesterra.sampling.adaptation import OF_SOIL_TESTS
from bayesterra.sampling.sampler import PRIOR_DRAWS, Progress, Samples, ThinnedDraws, sample, thin
from bayesterra.sampling.summary import Mode, densest, find_mode, summary_table
from bayesterra.stats.diagnostics import hdi
from bayesterra.study import result
from bayesterra.study.result import conditions_dataset, parameter_dataset
from bayesterra.study.study import Study, without_wheels

MODE_DRAWS = 4000
CURVE_DRAWS = 1000
OTHER_NOISE = {"half": 0.5, "double": 2.0}
"""Factors of the stated noise, of which a report says what they would change."""


def run(
    study: Study,
    *,
    seed: int = 1,
    report: Callable[[Progress], None] = lambda progress: None,
    checkpoint_store: CheckpointStore | None = None,
    crosscheck: bool = False,
) -> RunResult:
    """Sample the posterior of a study and set it beside the least-squares estimates.

    Parameters
    ----------
    study : what to analyse.
    seed : the same seed gives the same draws on one machine, whatever the number of cores.
    report : called as the sampling goes on.
    checkpoint_store : what to resume from and to save every stage in.
    crosscheck : repeat the sampling by nested sampling and record whether it agrees.

    Returns
    -------
    RunResult : also when the sampling did not converge; ``result.converged`` says so. And also when something
        that is computed from the draws fails: the entry ``failures`` of its record says what and why.

    Raises
    ------
    SupportError : the prior leaves no parameter set that fits the conditions of the data.
    StudyError : a cross-check is asked for, and its sampler is not installed.
    """
    if crosscheck:
        evidences.check_installed()
    started, target = time.perf_counter(), posterior(study)
    streams = SeedSequence(seed).spawn(11)
    sampling, prior_stream, predicting, validating, weighing, nesting, *later = streams
    prior = draw_cut_prior(target, PRIOR_DRAWS, default_rng(prior_stream))
    size = None if target.driven else OF_SOIL_TESTS
    samples = sample(target, study.sampling, sampling, report, adaptation=size, checkpoint_store=checkpoint_store)
    report(Progress("comparing", 1.0))
    kept = thin(samples.chains)
    failures = Failures(lambda title: report(Progress("checking", 1.0, step=title)))
    fits, refused = failures.attempt("fits", lambda: fit_all(study) if target.driven else ({}, ()), lambda: ({}, ()))
    spaced, guesses = kept.spaced(MODE_DRAWS), [fitted.values() for fitted in fits.values()]
    mode = failures.attempt("mode", lambda: find_mode(target, spaced, guesses), lambda: densest(target, spaced))
    held = {name: fitted.values()[name] for fitted in fits.values() for name in fitted.held if name in target.names}
    conditional = failures.attempt("mode", lambda: find_mode(target, spaced, guesses, held) if held else None)
    moved, own = samples.target.densities, samples.adaptations
    integral = failures.attempt("evidence", lambda: evidences.ensembles_evidence(moved, own, default_rng(weighing)))
    analysis = Analysis(study, target, prior, samples, kept, mode, conditional, integral, fits, refused, failures)
    report(Progress("checking", 1.0))
    result = analysis.result(seed, default_rng(predicting), (validating, *later), started)
    if not crosscheck:
        return result

    def against() -> dict[str, Any]:
        ours = evidences.Weighted.of_ensembles("bayesterra", samples.chains[:, :: kept.every], integral)
        comparison = evidences.against_nested(target, ours, nesting, report=lambda stage: report(Progress(stage, 1.0)))
        return {"crosscheck": comparison.record()}

    entry = failures.attempt("crosscheck", against, dict[str, Any])
    return replace(result, record=with_failures({**result.record, **entry}, failures))


@dataclass(frozen=True)
class Analysis:
    """Everything a run found, before it is put into tables; ``failures``: what it did not find.

    ``conditional``: the mode with those parameters held that least squares held; None where it held none.
    """

    study: Study
    posterior: Posterior
    prior: PriorDraws
    samples: Samples
    kept: ThinnedDraws
    mode: Mode
    conditional: Mode | None
    evidence: evidences.Evidence | None
    fits: Mapping[str, Fit]
    refused: tuple[str, ...]
    failures: Failures

    def result(self, seed: int, rng: Generator, streams: Sequence[SeedSequence], started: float) -> RunResult:
        """Put everything into tables, labelled draws and the record; ``started`` is the clock's time then.

        ``rng`` predicts; ``streams`` are for the checks, for what the data added to the prior, for
        loads before the readings, for other noise, for the next drive, and for soil tests.
        """
        validating, informing, loading, scaling, planning, testing = streams
        failures, draws_of = self.failures, self.kept.flat
        prior = self.prior.x[:: one_in(len(self.study.observations), len(self.prior.x))]
        rows, before = self._rows(self.stored.reshape(-1, draws_of.shape[1]), rng), self._rows(prior, rng, before=True)
        draws, predicted = self._draws(rows, before, rng), predictive_table(self.study, rows)
        del rows  # 120 MB of 10 000 rows
        if self.study.drive.latent_load:
            before = failures.attempt(
                "prior_predictive",
                lambda: predict_at_read_loads(self.study, self.posterior, prior, default_rng(loading)),
                lambda: no_rows(self.study, len(prior)),
            )
        standings = failures.attempt(
            "standings",
            lambda: self.standings(draws["sample_stats"]["lp"].to_numpy().ravel()),
            dict[str, PointEstimate],
        )
        table, directions = self.identifiability(default_rng(informing))
        noise = failures.attempt("noise", lambda: self.other_noise(default_rng(scaling)), dict[str, evidences.Redrawn])
        checked, tested, following = Validation(None, None, None), None, None
        if self.posterior.driven:
            checked = validate(self.study, self.posterior, draws_of, before, validating, failures)
            following = failures.attempt("next", lambda: self.next_drive(planning))
        if self.posterior.experiments:
            tested = failures.attempt("left_out", lambda: new_tests(self.posterior, draws_of, testing))
        findings = {
            "verdict": sampler.of_diagnosis(self.samples.diagnosis),
            "sampling": sampler.of_samples(self.samples, self.kept.every),
            **({"evidence": evidences.of_evidence(self.evidence, self.prior)} if self.evidence else {}),
            "prior_support": {"tried": self.prior.tried, "shares": dict(self.prior.shares)},
            "mode": self._modes(),
            "fits": {name: results.of_fit(fitted) for name, fitted in self.fits.items()},
            "refused_fits": list(self.refused),
            "standings": {name: results.of_point_estimate(standing) for name, standing in standings.items()},
            "noise": {name: {k: v for k, v in vars(other).items() if k != "x"} for name, other in noise.items()},
            **({"next": following} if following else {}),
            **directions,
            **checked.record(),
            **(tested.record() if tested else {}),
        }
        summary = summary_table(
            self.study, self.posterior, self.kept.chains, self.prior.x, self.mode.x, self.samples.diagnosis,
            failures,
        )  # fmt: skip
        summary = summary.assign(**self._intervals(noise, summary["parameter"]))
        seconds = {**self.samples.seconds, "total": time.perf_counter() - started + self.samples.earlier}
        found = RunResult(
            study=self.study, draws=draws, summary=summary, least_squares=self.least_squares(standings),
            identifiability=table, predictive=predicted,
            new_tests=tested.table if tested else pd.DataFrame(), bands=tested.bands if tested else pd.DataFrame(),
            record=with_failures(result.run_record(self.study, seed, findings, seconds), failures),
        )  # fmt: skip
        judged = failures.attempt("verdicts", lambda: found.judged, lambda: found)
        return replace(judged, record=with_failures(judged.record, failures))

    @property
    def stored(self) -> FloatArray:
        """Draws (chain, draw, d) of which predictions and likelihoods of every row are kept."""
        chains = self.kept.chains
        return chains[:, :: one_in(len(self.study.observations), chains.shape[0] * chains.shape[1])]

    def identifiability(self, rng: Generator) -> tuple[pd.DataFrame, dict[str, Any]]:
        """Verdicts on the parameters, and the record of the directions that design and data determine."""
        names, stated = self.posterior.names, self.study.prior.stated
        prior, draws = self.prior.x, self.kept.flat

        def structure_and_verdicts() -> tuple[structures.Structure, Identifiability]:
            few = structures.NUMBERS // max(1, len(self.study.observations))
            seen = structures.structure(self.posterior, prior[: min(structures.DRAWS, max(structures.FEWEST, few))])
            laws = [self.study.prior.laws[name] for name in names]
            ranges, logs = [law.range for law in laws], np.array([law.logarithmic for law in laws])
            structural = np.isin(names, seen.determined)
            return seen, identifiability(names, ranges, stated(prior), stated(draws), structural, logs)

        both = self.failures.attempt("identifiability", structure_and_verdicts)
        if both is None:
            return undetermined(names, stated(prior), stated(draws)), {}
        seen, verdicts = both

        def directions() -> dict[str, Any]:
            added = information(self.posterior, prior, draws, rng)
            return {"directions": identifiability_analysis.of_directions(verdicts, seen, added)}

        return verdicts.table, self.failures.attempt("directions", directions, dict[str, Any])

    def _rows(self, x: FloatArray, rng: Generator, *, before: bool = False) -> RowPredictions:
        """Readings of all rows that parameter sets (n, d) predict."""
        if not self.posterior.driven:
            return no_rows(self.study, len(x))
        return self.failures.attempt(
            "prior_predictive" if before else "posterior_predictive",
            lambda: predict_rows(self.study, self.posterior, x, rng, before=before),
            lambda: no_rows(self.study, len(x)),
        )

    def _draws(self, rows: RowPredictions, before: RowPredictions, rng: Generator) -> xr.DataTree:
        shape = (*self.stored.shape[:2], *rows.readings.shape[1:])
        by_chain = replace(rows, modelled=rows.modelled.reshape(shape), readings=rows.readings.reshape(shape))
        predictions = {"prior_predictive": before, "posterior_predictive": by_chain}
        kept = self.kept

        def curves() -> xr.Dataset:
            return curves_dataset(predict_curves(self.study, self.posterior, kept.spaced(CURVE_DRAWS), rng))

        return draws_tree(
            self.study, self.posterior, kept.chains, kept.labels, self.prior.x, predictions,
            self.failures.attempt("curves", curves) if self.posterior.driven else None,
        )  # fmt: skip

    def next_drive(self, seed: SeedSequence) -> dict[str, Any] | None:
        """Record of the drive that would tell most."""
        from bayesterra.design.recommendation import QUICK, next_drive

        return next_drive(self.study, self.posterior, self.kept.spaced(QUICK), seed)

    def other_noise(self, rng: Generator) -> dict[str, evidences.Redrawn]:
        """Draws of the posteriors with half and with double the stated noise; none where all is estimated."""
        if not self.study.noise_stated:
            return {}
        near = evidences.PosteriorProposal.of(self.posterior, self.kept.spaced(MODE_DRAWS))
        others = {name: posterior(self.study.with_noise(factor)) for name, factor in OTHER_NOISE.items()}
        with threadpool_limits(limits=1):  # matrices are small: threads of the linear algebra wait for each other
            return {name: evidences.redrawn(near, other, rng) for name, other in others.items()}

    def _intervals(self, noise: Mapping[str, evidences.Redrawn], quantities: Iterable[str]) -> dict[str, list[float]]:
        """Columns of the summary: 90 % HDI of parameters with other noise, field units; NaN of what derives."""
        columns, names = dict[str, list[float]](), self.posterior.names
        for name, other in noise.items():
            ends = {n: hdi(x / PARAMETERS[n].scale, CREDIBLE) for n, x in zip(names, other.x.T, strict=True)}
            for i, end in enumerate(("lo", "hi")):
                columns[f"hdi90_{end}_{name}"] = [ends[q][i] if q in ends else np.nan for q in quantities]
        return columns

    def _modes(self) -> dict[str, Any]:
        """Record of the mode, and how much denser it is than the one at the values that least squares held."""
        of = {"log_density": self.mode.log_density, "agreeing_starts": self.mode.agreeing}
        if self.conditional is None:
            return of
        return {**of, "delta_chi2": 2.0 * (self.mode.log_density - self.conditional.log_density)}

    def standings(self, densities: FloatArray) -> dict[str, PointEstimate]:
        """Standing of every point estimate among the draws' log densities (n,).

        The mode, free and where parameters are held, every least-squares fit, published and true values.
        """
        modes = {"mode": self.mode, CONDITIONAL: self.conditional}
        points = {
            name: dict(zip(self.posterior.names, map(float, at.x), strict=True)) for name, at in modes.items() if at
        }
        points |= {name: fitted.identified() for name, fitted in self.fits.items()}
        points |= {name: dict(stated.values) for name, stated in self.study.references.items()}
        soils = {
            method: {n: v for n, v in values.items() if n in PRIOR_PARAMETERS or of_soil_tests(n)}
            for method, values in points.items()
        }
        return locate(self.posterior, self.kept.flat, densities, soils)

    def least_squares(self, standings: Mapping[str, PointEstimate]) -> pd.DataFrame:
        """The table of point estimates with the share of draws denser than each; NaN for incomplete ones."""
        table = report_table(self.fits, self.study)
        rows = self.failures.attempt("fits", lambda: list(rows_of_tests(self.study)), list[Any])
        if CONDITIONAL in standings:
            rows = [*rows, *point_rows(CONDITIONAL, standings[CONDITIONAL].values, self.study)]
        if rows:
            more = pd.DataFrame(rows, columns=results.COLUMNS)
            table = pd.concat([table, more], ignore_index=True) if len(table) else more
        levels = {name: np.nan if s.filled else s.credible_level for name, s in standings.items()}
        names = table["method"]
        if "solver" in table:
            names = names.where(table["solver"] != "lsqcurvefit", names + " lsqcurvefit")
        return table.assign(credible_level=names.map(levels))


DRAWS = 4000
"""Draws of a prior alone."""
CREDIBLE = 0.9


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
    kept = cut.x[:: one_in(len(study.observations), DRAWS)]
    failures = Failures()
    without_wheels(study, "run --prior-only")
    predictions = failures.attempt(
        "prior_predictive",
        lambda: predict_rows(study, target, kept, predicting, before=True),
        lambda: no_rows(study, len(kept)),
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
    support = {"tried": cut.tried, "shares": dict(cut.shares)}
    record = {**result.origin(study, seed), "prior_only": True, "prior_support": support}
    return PriorResult(
        study=study, draws=labelled_tree(groups), summary=_summary(study, cut.x, failures),
        predictive=predictive_table(study, predictions), record=with_failures(record, failures),
    )  # fmt: skip


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
