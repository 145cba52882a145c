"""Predictive checks: test statistics of readings, and whether the readings look as the model says.

All but the largest reading are taken of standardised residuals z = (reading − model) / σ in the order of
slip. Given the parameters, the law of z is that of the noise alone, so one set of unit residuals serves as
reference for every parameter set.

A posterior predictive p value is conservative: the parameters have seen the readings that they are to
predict. It is therefore calibrated. Tables are replicated from the posterior predictive law, each gets its
own posterior, and the p values of the replicates are what the p value of the readings is held against (Hjort,
Dahl and Steinbakk 2006, with the posterior in place of the prior). One alarm judges all statistics of all
channels together by the most extreme of them, so that its rate of false alarms is that of one test and not
of twenty.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng
from scipy.special import ndtri

from bayesterra.arrays import BoolArray, FloatArray, IntArray, spaced
from bayesterra.checking.predictive import FORCE, Modelled, Replicate, ReplicateOptions, RowPredictions, replicates
from bayesterra.likelihood.posterior import Posterior
from bayesterra.study.observations import LABELS
from bayesterra.study.study import Study

Statistic = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class TestStatistic:
    """A statistic of standardised residuals."""

    name: str  # key in tables and records
    words: str  # what it is
    finding: str  # what its alarm says of a channel
    two_sided: bool  # whether small values are as strange as large ones
    slips: int  # different slips needed at least
    value: Statistic  # residuals (..., m) and slips (m,), in ascending order, in; statistic (...) out


def _contrast(degree: int) -> Statistic:
    """Share of the residuals along the polynomial in slip of this degree, orthogonal to all lower ones."""

    @lru_cache(maxsize=8)
    def direction(slips: tuple[float, ...]) -> FloatArray:
        scaled = (np.array(slips) - np.mean(slips)) / max(float(np.ptp(slips)), 1e-12)
        basis, _ = np.linalg.qr(np.vander(scaled, degree + 1, increasing=True))
        return np.asarray(basis[:, degree] * np.sign(basis[:, degree] @ scaled**degree))

    return lambda z, slip: np.asarray(z @ direction(tuple(slip.tolist())))


def _neighbours(z: FloatArray, slip: FloatArray) -> FloatArray:
    total = np.maximum((z**2).sum(axis=-1), 1e-300)
    return np.asarray((z[..., 1:] * z[..., :-1]).sum(axis=-1) / total)


LARGEST = TestStatistic("largest", "largest reading", "has a largest reading that the model does not give",
                      True, 1, lambda readings, slip: np.asarray(readings.max(axis=-1)))  # fmt: skip
"""The one statistic that is taken of the readings themselves."""

OF_RESIDUALS = (
    TestStatistic("misfit", "sum of squared residuals", "scatters more than the noise allows",
                False, 1, lambda z, slip: np.asarray((z**2).sum(axis=-1))),
    TestStatistic("level", "mean residual", "is shifted as a whole", True, 1, _contrast(0)),
    TestStatistic("slope", "slope over slip", "rises or falls with slip otherwise than the model",
                True, 2, _contrast(1)),
    TestStatistic("curvature", "curvature over slip", "bends over slip otherwise than the model",
                True, 3, _contrast(2)),
    TestStatistic("neighbours", "correlation of neighbouring residuals", "has runs of residuals of one sign",
                False, 4, _neighbours),
)  # fmt: skip


def between(by: str, number: IntArray) -> TestStatistic:
    """The statistic of readings that are parted ``by`` wheel, load or run; ``number`` (m,) of the part."""
    parts = [number == k for k in np.unique(number)]

    def value(z: FloatArray, slip: FloatArray) -> FloatArray:
        """Greatest mean residual of a part, in its standard errors."""
        means = [np.abs(z[..., own].sum(axis=-1)) / np.sqrt(own.sum()) for own in parts]
        return np.asarray(np.max(means, axis=0))

    finding = f"is off to different sides for different {by}s"
    return TestStatistic(f"by {by}", f"difference between {by}s", finding, False, 1, value)


TEST_STATISTICS: dict[str, TestStatistic] = {
    statistic.name: statistic
    for statistic in (
        *OF_RESIDUALS,
        *(between(by, np.zeros(1, dtype=np.intp)) for by in ("load", "wheel", *LABELS)),
        LARGEST,
    )
}


def applicable(slip: FloatArray) -> tuple[TestStatistic, ...]:
    """The statistics of residuals that readings at these slips (m,) can have."""
    distinct = len(np.unique(slip))
    return tuple(statistic for statistic in OF_RESIDUALS if distinct >= statistic.slips)


def exceedance(values: FloatArray, ordered: FloatArray) -> FloatArray:
    """Share of an ascending reference (k,) above each value (any shape); ties count half."""
    below = np.searchsorted(ordered, values, side="left") + np.searchsorted(ordered, values, side="right")
    return np.asarray(1.0 - 0.5 * below / len(ordered))


ALARM, DOUBT = 0.003, 0.02
"""Overall p below which the readings contradict the model, or are doubtful."""
PAIR = 0.01
"""Readings with two statistics as strange as this are doubtful as well."""
CONFLICT = 0.01
"""Overall p below which the readings contradict the prior."""
JUDGED_DRAWS = 1000
MORE = 2
FEWEST, NUMBERS = 200, 1_000_000
"""Draws or residuals of each of many rows: so many numbers in all, and the fewest."""
REFERENCE = 2000
"""Residuals of replicated readings that a statistic is compared with."""


@dataclass(frozen=True)
class Check:
    """One statistic of one channel."""

    channel: str  # its name
    statistic: str  # a key of ``TEST_STATISTICS``
    p: float  # posterior predictive probability of a value at least as large
    calibrated: float  # share of replicated tables that are as strange in this statistic

    @property
    def finding(self) -> str:
        """Words of its alarm about the channel."""
        return TEST_STATISTICS[self.statistic].finding


@dataclass(frozen=True)
class PredictiveChecks:
    """All checks of a table of readings."""

    checks: tuple[Check, ...]  # every statistic of every channel, the strangest first
    overall: float  # share of replicated tables whose strangest statistic is as strange as that of the readings
    replicates: int  # number of replicated tables
    effective: tuple[float, float]  # effective draws of the posteriors of the replicates: 5 % quantile and median

    @property
    def alarm(self) -> bool:
        """True where the readings contradict the model."""
        return self.overall < ALARM

    @property
    def doubtful(self) -> bool:
        """True where they are stranger than they should be."""
        return self.overall < DOUBT or sum(check.calibrated < PAIR for check in self.checks) > 1


@dataclass(frozen=True)
class _Judge:
    """The statistics of one channel: its readings in the order of slip (m,), unit residuals of replicates (k, m)."""

    channel: str
    column: int
    rows: IntArray
    slip: FloatArray
    unit: FloatArray
    parts: Mapping[str, IntArray]

    @cached_property
    def of_residuals(self) -> tuple[TestStatistic, ...]:
        return (*applicable(self.slip), *(between(by, number) for by, number in self.parts.items()))

    @cached_property
    def _ordered(self) -> list[FloatArray]:
        return [np.sort(statistic.value(self.unit, self.slip)) for statistic in self.of_residuals]

    @property
    def statistics(self) -> tuple[TestStatistic, ...]:
        return (*self.of_residuals, LARGEST)

    def p_values(self, readings: FloatArray, modelled: Modelled) -> FloatArray:
        """Upper-tail posterior predictive p of every statistic, of readings (rows, channels)."""
        y = readings[self.rows, self.column]
        mean, scale = (v[:, self.rows, self.column] for v in (modelled.mean, modelled.scale))
        z = (y - mean) / scale
        pairs = zip(self.of_residuals, self._ordered, strict=True)
        shares = [exceedance(statistic.value(z, self.slip), ordered).mean() for statistic, ordered in pairs]
        turns = (7 * np.arange(len(mean))[:, None] + np.arange(min(10, 1 + 5000 // len(y)))) % len(self.unit)
        largest = [LARGEST.value(mean + scale * self.unit[turn], self.slip) for turn in turns.T]
        return np.array([*shares, np.mean(np.array(largest) > y.max())])


def predictive_checks(
    posterior: Posterior,
    draws: FloatArray,
    seed: SeedSequence,
    options: ReplicateOptions | None = None,
    parts: Mapping[str, IntArray] | None = None,
) -> PredictiveChecks:
    """Check the readings in the fit against posterior draws (n, d).

    ``parts``: by wheel, load or run, the number of the part that each row in the fit belongs to. Where no
    replicated table is as strange as the readings, ``MORE`` times as many are made.
    """
    own, replicating, again = seed.spawn(3)
    rng, options = default_rng(own), options or ReplicateOptions()
    judges = _judges(posterior, rng, parts or {})
    x = spaced(draws, _of_rows(JUDGED_DRAWS, posterior))
    explained = Modelled.of(posterior, x, posterior.explained(x, rng))
    observed = _p_values(judges, posterior.likelihood.measured, explained)

    def judged(table: Replicate) -> tuple[FloatArray, float]:
        return _p_values(judges, table.readings, table.modelled), table.effective

    def compared(tables: list[tuple[FloatArray, float]]) -> PredictiveChecks:
        low, middle = np.quantile([effective for _, effective in tables], [0.05, 0.5])
        return _compared(judges, observed, np.array([p for p, _ in tables]), (float(low), float(middle)))

    tables = list(replicates(posterior, draws, replicating, options, judged))
    found = compared(tables)
    if found.overall > 1 / (1 + len(tables)):
        return found
    more = replace(options, number=MORE * options.number)
    return compared(tables + list(replicates(posterior, draws, again, more, judged)))


def uncalibrated_checks(
    posterior: Posterior, draws: FloatArray, rng: Generator, parts: Mapping[str, IntArray]
) -> PredictiveChecks:
    """Checks of the readings of a group against draws (n, d), SI, that other groups formed as well.

    There are no replicates: p values stand as they are, which is conservative, and the least of them times their
    number is the ``overall`` one. ``parts`` as for :func:`predictive_checks`.
    """
    judges, x = _judges(posterior, rng, parts), spaced(draws, _of_rows(JUDGED_DRAWS, posterior))
    explained = Modelled.of(posterior, x, posterior.explained(x, rng))
    names = [(judge.channel, statistic) for judge in judges for statistic in judge.statistics]
    checks = [
        Check(channel, statistic.name, p, 2 * min(p, 1 - p) if statistic.two_sided else p)
        for (channel, statistic), p in zip(
            names, _p_values(judges, posterior.likelihood.measured, explained).tolist(), strict=True
        )
    ]
    checks.sort(key=lambda check: check.calibrated)
    return PredictiveChecks(tuple(checks), min(1.0, len(checks) * checks[0].calibrated), 0, (0.0, 0.0))


def _of_rows(most: int, posterior: Posterior) -> int:
    """So many at most, fewer where rows are many."""
    return min(most, max(FEWEST, NUMBERS // len(posterior.likelihood.observations)))


def _judges(posterior: Posterior, rng: Generator, parts: Mapping[str, IntArray]) -> list[_Judge]:
    likelihood, judges = posterior.likelihood, []
    for column, noise in enumerate(likelihood.noise):
        rows = np.flatnonzero(~np.isnan(likelihood.measured[:, column]))
        slip = likelihood.observations.slip[rows]
        order = np.argsort(slip, kind="stable")
        unit = noise.tails.draw((_of_rows(REFERENCE, posterior), len(rows)), rng)
        own = {by: number[rows[order]] for by, number in parts.items()}
        own = {by: number for by, number in own.items() if len(np.unique(number)) > 1}
        judges.append(_Judge(noise.channel, column, rows[order], slip[order], unit, own))
    return judges


def _p_values(judges: list[_Judge], readings: FloatArray, modelled: Modelled) -> FloatArray:
    return np.concatenate([judge.p_values(readings, modelled) for judge in judges])


def _compared(
    judges: list[_Judge], observed: FloatArray, made: FloatArray, effective: tuple[float, float]
) -> PredictiveChecks:
    """Hold p values (checks,) against those of the replicates (n, checks)."""
    names = [(judge.channel, statistic.name) for judge in judges for statistic in judge.statistics]
    two_sided = np.array([TEST_STATISTICS[name].two_sided for _, name in names])
    own, others = _strangeness(observed, made, two_sided), _strangeness(made, made, two_sided)
    calibrated = (1 + (others >= own).sum(axis=0)) / (1 + len(made))
    overall = (1 + (others.max(axis=1) >= own.max()).sum()) / (1 + len(made))
    checks = [
        Check(names[i][0], names[i][1], float(observed[i]), float(calibrated[i]))
        for i in np.argsort(-own, kind="stable")
    ]
    return PredictiveChecks(tuple(checks), float(overall), len(made), effective)


def _strangeness(p: FloatArray, made: FloatArray, two_sided: BoolArray) -> FloatArray:
    """Distance of p values (..., checks) from those of replicates (n, checks), in sd of normal scores."""
    score, others = (np.asarray(ndtri(np.clip(values, 1e-4, 1 - 1e-4))) for values in (p, made))
    distance = (others.mean(axis=0) - score) / np.maximum(others.std(axis=0), 1e-6)
    return np.asarray(np.where(two_sided, np.abs(distance), distance))


@dataclass(frozen=True)
class PriorCheck:
    """A statistic of one channel's readings under the prior alone."""

    channel: str
    statistic: str  # ``mean``, ``slope`` over slip or ``largest``
    value: float  # of the readings, SI
    low: float  # 5 % of what the prior predicts
    high: float  # 95 % of it
    p: float  # two-sided prior predictive p


@dataclass(frozen=True)
class PriorChecks:
    """Checks of the readings against what the prior can predict."""

    checks: tuple[PriorCheck, ...]  # every statistic of every channel, but of the normal force where the load is latent
    overall: float  # smallest p times the number of checks (Bonferroni), 1 at most

    @property
    def conflict(self) -> bool:
        """True where prior and readings contradict each other."""
        return self.overall < CONFLICT


def prior_checks(study: Study, predictions: RowPredictions) -> PriorChecks:
    """Hold the readings in the fit against readings that draws of the cut prior predict.

    A latent load (drive ``both``) has a flat law over a range that nobody believes in: readings of the normal
    force are not judged, and the others only where ``predictions`` are made at loads that these tell
    (:func:`bayesterra.checking.predictive.predict_at_read_loads`).
    """
    rows, checks, latent = study.observations, [], study.drive.latent_load
    told = ~np.isnan(rows.values[FORCE]) if latent and FORCE in rows.values else np.full(len(rows), not latent)
    for column, name in enumerate(predictions.channels):
        if latent and name == FORCE:
            continue
        chosen = np.flatnonzero(rows.use & told & ~np.isnan(rows.values[name]))
        slip, values = rows.slip[chosen], rows.values[name][chosen]
        drawn = predictions.readings[:, chosen, column]
        drawn = drawn[np.isfinite(drawn).all(axis=1)]
        for statistic, compute in PRIOR_STATISTICS.items():
            if len(np.unique(slip)) > (statistic == "slope") and len(drawn):
                checks.append(_prior_check(name, statistic, compute(values, slip), compute(drawn, slip)))
    overall = min([1.0, *(len(checks) * check.p for check in checks)])
    return PriorChecks(tuple(checks), overall)


def _prior_check(name: str, statistic: str, value: FloatArray, drawn: FloatArray) -> PriorCheck:
    above = (1 + np.sum(drawn >= value)) / (1 + len(drawn))
    below = (1 + np.sum(drawn <= value)) / (1 + len(drawn))
    low, high = np.quantile(drawn, [0.05, 0.95])
    p = min(1.0, 2 * float(min(above, below)))
    return PriorCheck(name, statistic, float(value), float(low), float(high), p)


def _slope(values: FloatArray, slip: FloatArray) -> FloatArray:
    """Least-squares slope of readings (..., m) over slip (m,)."""
    centred = slip - slip.mean()
    return np.asarray(values @ centred / (centred @ centred))


PRIOR_STATISTICS: Mapping[str, Statistic] = {
    "mean": lambda values, slip: np.asarray(values.mean(axis=-1)),
    "slope": _slope,
    "largest": LARGEST.value,
}
"""Statistics of readings (..., m) at slips (m,)."""
