"""Validation of a fit: how well the model explains its readings, and the posterior of what it misses."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import Any

import numpy as np
from numpy.random import SeedSequence
from threadpoolctl import threadpool_limits

from bayesterra.arrays import BoolArray, FloatArray, spaced
from bayesterra.checking import predictive_checks
from bayesterra.checking.levels import BAD, DOUBTFUL, counts, parts_of, predicted, rests, ways
from bayesterra.checking.loo import CrossValidation, Level, Without, cross_validate
from bayesterra.checking.predictive import RowPredictions, curve_forward, one_in
from bayesterra.checking.predictive_checks import (
    ALARM,
    CONFLICT,
    DOUBT,
    Check,
    PredictiveChecks,
    PriorCheck,
    PriorChecks,
)
from bayesterra.errors import enumerated
from bayesterra.least_squares.results import CONDITIONAL, ESTIMATES, METHODS
from bayesterra.likelihood.forward import Outcomes, model_columns
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.parameters import CHANNELS, MODEL_PARAMETERS, OUTCOMES, SIZES, soil_array
from bayesterra.report.numbers import probability, share
from bayesterra.report.verdicts import Failures, Verdict, unknown_verdict
from bayesterra.study.result import Result
from bayesterra.study.study import Study

OVERSTATED = 0.99
"""p value above which the stated noise looks larger than the scatter."""
DRAWS = 2000


def spread_draws(result: Result, most: int = DRAWS) -> FloatArray:
    """At most ``most`` posterior draws (n, d), evenly spaced over all ensembles; SI."""
    return spaced(result.values(), most)


def standardised(target: Posterior, x: FloatArray) -> FloatArray:
    """Residuals (reading − model) / σ of parameter sets (n, d).

    Shape (n, rows in the fit, channels), NaN where there is no reading. A latent load is drawn for each.
    """
    outcomes = target.explained(x, np.random.default_rng(0))
    predicted = target.likelihood.predicted(outcomes)
    return target.likelihood.standardised(predicted, target.noise_values(x))


def residuals(result: Result, most: int = DRAWS) -> FloatArray:
    """Standardised residuals of posterior draws, (n, rows in the fit, channels)."""
    few = spread_draws(result, most)
    return standardised(posterior(result.study), few[:: one_in(len(result.study.observations), len(few))])


def estimates(result: Result) -> dict[str, dict[str, float]]:
    """Soil parameters of the conditional mode, least squares, published and true ones by name, SI.

    What a method does not give, and a record fills in to place it in the posterior, is left out.
    """
    fits, standings = result.record["fits"], result.record["standings"]
    points = {}
    for method in (name for name in ESTIMATES if name in standings):
        values, missing = standings[method]["values"].items(), fits.get(method, {}).get("missing", ())
        points[method] = {n: float(value) for n, value in values if n not in missing}
    return points | {name: dict(stated.values) for name, stated in result.study.references.items()}


def complete(result: Result) -> tuple[str, ...]:
    """Those of :func:`estimates` that give every free soil parameter; only they can be judged by density."""
    free = [name for name in result.names if name in MODEL_PARAMETERS]
    return tuple(method for method, values in estimates(result).items() if all(n in values for n in free))


def held(result: Result, method: str) -> tuple[str, ...]:
    """Free parameters of the study that a least-squares method, or any of them for the mode, held at a value."""
    fits = result.record.get("fits", {})
    named = {
        name for each in (fits if method == CONDITIONAL else (method,)) for name in fits.get(each, {}).get("held", ())
    }
    return tuple(name for name in result.names if name in named)


def complete_soils(result: Result) -> dict[str, FloatArray]:
    """Soil arrays (1, p) of the converged least-squares methods that leave no parameter open."""
    study = result.study
    estimated = {n: {**study.prior.fixed, **v} for n, v in estimates(result).items() if n in METHODS}
    soils = {
        name: soil_array({n: values[n] for n in study.model.parameters if n in values})
        for name, values in estimated.items()
    }
    return {n: soil for n, soil in soils.items() if np.isfinite(model_columns(soil, study.model)).all()}


def method_curves(result: Result, wheel: str) -> dict[str, Outcomes]:
    """Modelled outcomes (1, g) of the least-squares estimates on the slip grid of the result's curves.

    All are run by the study's own model and drive; NaN where an estimate has no answer.
    """
    forward = curve_forward(result.study, wheel)
    return {name: forward(soil, every_row=True) for name, soil in complete_soils(result).items()}


def method_residuals(result: Result) -> dict[str, FloatArray]:
    """Standardised residuals (rows in the fit, channels) of the least-squares estimates.

    Estimated noise stands at its posterior median.
    """
    target = posterior(result.study)
    medians = dict(zip(target.names, np.median(result.values(), axis=0), strict=True))
    noise = np.array([[medians[name] for name in target.names if name.startswith(SIZES)]])
    likelihood = target.likelihood
    outcomes = {n: likelihood.forward(soil, every_row=True) for n, soil in complete_soils(result).items()}
    return {n: likelihood.standardised(likelihood.predicted(o), noise)[0] for n, o in outcomes.items()}


@dataclass(frozen=True)
class Validation:
    """Predictive checks under the posterior and the prior, rows left out, and readings of levels left out.

    None stands for what could not be computed; of a folder of an older version the levels are None as well.
    """

    checks: PredictiveChecks | None
    prior: PriorChecks | None
    loo: CrossValidation | None
    levels: Sequence[Mapping[str, Any]] | None = None

    def record(self) -> dict[str, Any]:
        """Everything, for ``run.json``."""
        record: dict[str, Any] = {}
        if self.checks is not None:
            alarm = {"threshold": ALARM, "alarm": self.checks.alarm, "doubtful": self.checks.doubtful}
            record["predictive_checks"] = {**asdict(self.checks), **alarm}
        if self.prior is not None:
            conflict = {"threshold": CONFLICT, "conflict": self.prior.conflict}
            record["prior_checks"] = {**asdict(self.prior), **conflict}
        if self.loo is not None:
            record["loo"] = {
                "elpd": self.loo.elpd,
                "se": self.loo.se,
                "effective_parameters": self.loo.effective_parameters,
                **asdict(self.loo),
            }
        return record if self.levels is None else {**record, "levels": list(self.levels)}

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Validation":
        """Read back from the content of a ``run.json``."""
        checks, prior, loo = (record.get(name) for name in ("predictive_checks", "prior_checks", "loo"))
        if checks:
            each, (low, middle) = tuple(Check(**check) for check in checks["checks"]), checks["effective"]
            checks = PredictiveChecks(each, checks["overall"], checks["replicates"], (low, middle))
        if prior:
            prior = PriorChecks(tuple(PriorCheck(**check) for check in prior["checks"]), prior["overall"])
        return cls(checks, prior, loo and CrossValidation.from_record(loo), record.get("levels"))


def validate(
    study: Study,
    posterior: Posterior,
    draws: FloatArray,
    before: RowPredictions,
    seed: SeedSequence,
    failures: Failures,
) -> Validation:
    """Validate a study's posterior.

    Parameters
    ----------
    draws : near-independent posterior draws (n, d).
    before : readings of all rows that the cut prior predicts, at known or read loads.
    failures : takes note of checks that cannot be computed.
    """
    checking, leaving, predicting = seed.spawn(3)
    levels, found = ways(study), dict[Level, Without]()

    def left_out() -> CrossValidation:
        loo, without = cross_validate(posterior, draws, leaving, rests(study, levels))
        found.update(without)
        return loo

    with threadpool_limits(limits=1):  # matrices are small: threads of the linear algebra wait for each other
        checks = failures.attempt(
            "predictive_checks",
            lambda: predictive_checks.predictive_checks(posterior, draws, checking, parts=parts_of(study, levels)),
        )
        prior = None
        if "prior_predictive" not in failures:
            prior = failures.attempt("prior_checks", lambda: predictive_checks.prior_checks(study, before))
        loo, predicting_rng = failures.attempt("loo", left_out), np.random.default_rng(predicting)
        if "loo" in failures:
            return Validation(checks, prior, loo)
        of_levels = failures.attempt("levels", lambda: predicted(study, posterior, levels, found, predicting_rng))
        return Validation(checks, prior, loo, of_levels)


FEW_READINGS = 3
"""Readings per free parameter below which the check of the fit can hardly fail."""
MANY = {name: f"{name.rpartition('_')[2]}s" for name in OUTCOMES}
"""Readings of a channel in a word, such as pulls."""


def fit_verdict(checks: PredictiveChecks | None, readings: int = 0, free: int = 0, failed: str = "") -> Verdict:
    """Verdict on whether the readings look as the model says that they look.

    ``readings`` and ``free`` parameters are numbers; ``failed`` says why there are no checks.
    """
    if checks is None:
        return unknown_verdict("Fit", failed)
    figures = {"overall": checks.overall, "replicates": checks.replicates}
    thresholds = {"bad": ALARM, "doubtful": DOUBT}
    if checks.doubtful:
        findings = [f"{CHANNELS[c.channel].description} {c.finding}" for c in alarming(checks)]
        said = f"{enumerated(findings)} (overall p {probability(checks.overall)})"
        word, grade = ("does not fit", "bad") if checks.alarm else ("doubtful", "doubtful")
        claim = f"the model {'does not fit' if checks.alarm else 'may not fit'}: {findings[0]}"
        return Verdict("Fit", word, grade, f"{said[:1].upper()}{said[1:]}.", claim, figures, thresholds)
    sentence = f"{share(checks.overall)} of the tables that the model itself makes look as strange."
    overstated = [c.channel for c in checks.checks if c.statistic == "misfit" and c.p > OVERSTATED]
    if overstated:
        names = enumerated([CHANNELS[name].description for name in overstated])
        sentence += f" Noise of {names} looks overstated."
    if readings < FEW_READINGS * free:  # the model can bend to them
        sentence += f" {readings} readings for {free} parameters: a lenient test."
    return Verdict("Fit", "fits", "good", sentence, "", figures, thresholds)


def alarming(checks: PredictiveChecks) -> tuple[Check, ...]:
    """The strangest statistic of each channel that has a strange one, three channels at most."""
    strangest: dict[str, Check] = {}
    for check in checks.checks:
        if check.calibrated < DOUBT or not strangest:
            strangest.setdefault(check.channel, check)
    return tuple(strangest.values())[:3]


def prediction_verdict(levels: Sequence[Mapping[str, Any]] | None, model: str, failed: str = "") -> Verdict:
    """Verdict on readings of levels that the fit had not seen; ``failed`` says why there are none."""
    if levels is None:
        said = failed or "Levels were not left out: by an older version, or too few are there."
        return Verdict("Prediction", "not tested", "note", said)
    found = counts(levels, model)
    if not found:
        return Verdict("Prediction", "not tested", "note", "All readings are of one level: none can be left out.")
    number = len(found)
    few, many = (min(1.0, number * min(getattr(count, name) for count in found)) for name in ("few", "many"))
    parts = []
    for by in dict.fromkeys(count.by for count in found):
        shares = [f"{c.inside} of {c.readings} {MANY[c.channel]}" for c in found if c.by == by]
        parts.append(f"left-out {by}s: {enumerated(shares)}")
    off = min(found, key=lambda count: count.few if few <= many else count.many)
    worse = [MANY[count.channel] for count in found if count.worse]
    word, grade, claim = "predicts", "good", ""
    if few < DOUBTFUL:
        inside = f"{off.inside} of {off.readings} {MANY[off.channel]} inside 90 %"
        claim = f"intervals are too narrow for other {off.by}s ({inside})"
        word, grade = "too narrow", "bad" if few < BAD else "doubtful"
    elif worse:
        word, grade = "worse than a curve", "doubtful"
        claim = f"a curve through the readings predicts {enumerated(worse)} better"
    elif many < DOUBTFUL:
        word, grade, claim = "too wide", "doubtful", f"intervals are too wide for other {off.by}s"
    said = "; ".join(parts)
    sentence = f"{said[:1].upper()}{said[1:]} inside 90 %" + (f": {claim.partition(' (')[0]}." if claim else ".")
    if unsure := sorted({str(row["level"]) for row in levels if not row["reliable"]}):
        sentence += f" Not relied on: {enumerated(unsure)}, without which the posterior is quite another one."
    figures = {"few": few, "many": many}
    return Verdict("Prediction", word, grade, sentence, claim, figures, {"bad": BAD, "doubtful": DOUBTFUL})


CURVE_DRAWS = 1000
GRID = 41
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
NOTABLE = 0.5
"""Share of the variance of a level or tilt that goes with the parameters, from which it is said."""


@dataclass(frozen=True)
class Stretch:
    """Slips over which the 90 % band of a discrepancy leaves 0 to one side."""

    low: float  # first of these slips
    high: float  # last of them
    least: float  # smallest median there, SI; negative where the model is too high
    most: float  # greatest median there, likewise


@dataclass(frozen=True)
class Trade:
    """A shape of a discrepancy that the parameters of the soil can take over."""

    shape: str  # ``level``, the mean over the driven slips, or ``tilt``, the slope over them
    share: float  # of its posterior variance that goes with the parameters, by linear regression on them
    parameter: str  # the one that correlates most with it
    correlation: float  # how much


@dataclass(frozen=True)
class Missed:
    """The discrepancy of one channel of one wheel over the driven slips."""

    wheel: str
    channel: str
    slip: FloatArray  # (g,) grid over the driven slips
    bands: FloatArray  # quantiles ``LEVELS`` of the discrepancy (5, g), SI
    rows: FloatArray  # slips of the readings in the fit (r,)
    residuals: FloatArray  # median of reading less model there (r,), SI; the model without its discrepancy
    trades: tuple[Trade, ...]  # shapes that the parameters can take over, the strongest first

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """Stretches of slip where the model is surely off, 90 % of the draws on one side."""
        side = np.where(self.bands[0] > 0, 1, np.where(self.bands[-1] < 0, -1, 0))
        stretches = []
        for sign, group in groupby(range(len(side)), key=lambda i: int(side[i])):
            places = list(group)
            if sign:
                middle = self.bands[2, places]
                ends = sorted((float(middle.min()), float(middle.max())), key=abs)
                stretches.append(Stretch(float(self.slip[places[0]]), float(self.slip[places[-1]]), *ends))
        return tuple(stretches)


def missed(result: Result) -> Iterator[Missed]:
    """The discrepancy of every wheel and channel that has one; nothing where the study states none."""
    if not result.study.errors.discrepancy:
        return
    target, draws = posterior(result.study), spread_draws(result, CURVE_DRAWS)
    likelihood, rng = target.likelihood, np.random.default_rng(0)
    soil, noise = target.prior.soil_values(draws), target.noise_values(draws)
    plain = likelihood.predicted(likelihood.forward(soil))
    rows = likelihood.observations
    for wheel in dict.fromkeys(rows.wheel):
        mine: BoolArray = np.array([name == wheel for name in rows.wheel])
        slip = np.linspace(rows.slip[mine].min(), rows.slip[mine].max(), GRID)
        if (curves := likelihood.beyond(soil, noise, wheel, slip, rng)) is None:
            return
        for channel in result.study.errors.discrepancy:
            column = likelihood.channels.index(channel)
            read = mine & ~np.isnan(likelihood.measured[:, column])
            off = likelihood.measured[read, column] - plain[:, read, column]
            curve = curves[:, :, column]
            notable = [trade for trade in trades(target.names, draws, slip, curve) if trade.share >= NOTABLE]
            yield Missed(
                wheel, channel, slip, np.quantile(curve, LEVELS, axis=0), rows.slip[read],
                np.median(off, axis=0), tuple(sorted(notable, key=lambda trade: -trade.share)),
            )  # fmt: skip


def trades(names: tuple[str, ...], draws: FloatArray, slip: FloatArray, curve: FloatArray) -> tuple[Trade, ...]:
    """Shares of level and tilt of a curve (n, g) over slips (g,) that go with the parameters of draws (n, d).

    Sizes of errors are left out; nothing where no other parameter is free.
    """
    soil = [i for i, name in enumerate(names) if not name.startswith(SIZES)]
    if not soil:
        return ()
    x = (draws[:, soil] - draws[:, soil].mean(axis=0)) / draws[:, soil].std(axis=0)
    trade_offs = []
    for shape, values in (("level", curve.mean(axis=1)), ("tilt", curve @ (slip - slip.mean()))):
        y = values - values.mean()
        explained = x @ np.linalg.lstsq(x, y, rcond=None)[0]
        single = [float(np.corrcoef(column, y)[0, 1]) for column in x.T]
        most = int(np.abs(single).argmax())
        trade_offs.append(Trade(shape, float(explained.var() / y.var()), names[soil[most]], single[most]))
    return tuple(trade_offs)
