"""Scores of left-out rows: mixtures of predictive laws, regression baselines, summaries.

The continuous ranked probability score of a law F at a reading y,

    CRPS(F, y) = ∫ (F(x) − 1{x ≥ y})² dx = E|X − y| − ½ E|X − X'|,

has the unit of the reading and is the smaller the better; for a law without width it is the absolute error
(Gneiting and Raftery 2007). For a mixture of normals both expectations are known in closed form (Grimit et
al. 2006).

Each is fitted to one channel. It knows slip, load (with the drive ``both`` the normal force as read, with
``sinkage`` the sinkage) and the wheel of every row, and has to find the noise in the training rows itself.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd
from numpy.random import Generator, default_rng
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import brentq, minimize
from scipy.special import ndtr

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.stats.mixture import log_mean
from bayesterra.stats.tails import GAUSSIAN, StudentT, Tails

PARTS = ("all", "inner", "end")
"""All rows; those at slips between the training rows' (interpolated); those beyond (extrapolated)."""
RESAMPLED = 4000
SCORES = ("crps", "log_score", "covered50", "covered90")


def clustered(values: FloatArray, level: IntArray) -> tuple[float, float]:
    """Mean of values (n,) and its standard error from the spread between levels (n,).

    √(G / (G − 1) Σ_g (Σ_{i in g} (v_i − v̄))²) / n with G levels (Liang and Zeger 1986); NaN with one level.
    """
    if not len(values):
        return float("nan"), float("nan")
    mean, n = float(values.mean()), len(values)
    names, of = np.unique(level, return_inverse=True)
    if len(names) < 2:
        return mean, float("nan")
    sums = np.bincount(of, weights=values - mean)
    return mean, float(np.sqrt(len(names) / (len(names) - 1) * (sums**2).sum()) / n)


def summarise(table: pd.DataFrame) -> pd.DataFrame:
    """Mean scores and coverages with standard errors, by predictor, channel and part.

    Rows without a predictive law have no score and count as not covered; ``unscored`` is their number.
    """
    records = []
    for predictor, channel in product(table["predictor"].unique(), table["channel"].unique()):
        own = table[(table["predictor"] == predictor) & (table["channel"] == channel)]
        for part, rows in _parts(own):
            record = {
                "predictor": predictor,
                "channel": channel,
                "unit": rows["unit"].iloc[0],
                "part": part,
                "rows": len(rows),
                "levels": rows["level"].nunique(),
                "unscored": int(rows["crps"].isna().sum()),
            }
            for score in SCORES:
                scored = rows[rows[score].notna()]
                level = pd.factorize(scored["level"])[0]
                record[score], record[f"{score}_se"] = clustered(scored[score].to_numpy(np.float64), level)
            records.append(record)
    return pd.DataFrame(records)


def _parts(rows: pd.DataFrame) -> Iterator[tuple[str, pd.DataFrame]]:
    for part in PARTS:
        chosen = rows if part == "all" else rows[rows["extrapolated"] == (part == "end")]
        if len(chosen):
            yield part, chosen


def skills(table: pd.DataFrame, model: str, seed: int = 1) -> pd.DataFrame:
    """Skill: share by which the model's mean CRPS is below a baseline's, 1 − CRPS / CRPS(baseline).

    Only rows that both have a law for. ``skill_lo``, ``skill_hi``: central 90 % when levels are drawn again
    with replacement, which needs two levels or more; ``difference`` of the mean CRPS with its standard error
    by level, negative where the model is better. ``levels_won``: levels in which the model's is the smaller.
    """
    records, keys = [], ["row", "channel"]
    own = table[table["predictor"] == model].set_index(keys)
    for baseline in (name for name in table["predictor"].unique() if name != model):
        other = table[table["predictor"] == baseline].set_index(keys)["crps"].rename("other")
        pairs = own.join(other).dropna(subset=["crps", "other"]).reset_index()
        for channel in pairs["channel"].unique():
            for part, rows in _parts(pairs[pairs["channel"] == channel]):
                head = {"model": model, "baseline": baseline, "channel": channel, "part": part}
                records.append({**head, **_skill(rows, default_rng(seed))})
    return pd.DataFrame(records)


def _skill(rows: pd.DataFrame, rng: Generator) -> dict[str, float]:
    level = pd.factorize(rows["level"])[0]
    ours, other = (rows[name].to_numpy(np.float64) for name in ("crps", "other"))
    sums = np.array([np.bincount(level, weights=values) for values in (ours, other)])
    groups = sums.shape[1]
    difference, error = clustered(ours - other, level)
    low = high = float("nan")
    if groups > 1:
        chosen = rng.integers(groups, size=(RESAMPLED, groups))
        resampled = sums[:, chosen].sum(axis=2)
        low, high = np.quantile(1 - resampled[0] / resampled[1], [0.05, 0.95])
    return {
        "rows": len(rows), "levels": groups, "skill": float(1 - ours.sum() / other.sum()), "skill_lo": float(low),
        "skill_hi": float(high), "difference": difference, "difference_se": error,
        "levels_won": int((sums[0] < sums[1]).sum()),
    }  # fmt: skip


_CUTS = np.array([0.001, 0.01, 0.05, 0.15, 0.3, 0.5, 0.7, 0.85, 0.95, 0.99, 0.999])
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
_U, _DU = 0.5 * (_NODES + 1), 0.5 * _WEIGHTS


@dataclass(frozen=True)
class Mixture:
    """Equal parts of laws of one shape."""

    centre: FloatArray  # of every part (n,)
    scale: FloatArray  # of every part (n,)
    tails: Tails = GAUSSIAN  # the shape of all parts

    def cdf(self, x: FloatArray) -> FloatArray:
        """Probability (k,) below each of ``x`` (k,)."""
        z = (np.asarray(x)[:, None] - self.centre) / self.scale
        return np.asarray(self.tails.cdf(z).mean(axis=1))

    def log_density(self, y: float) -> float:
        """Log of the density at ``y``."""
        z = (y - self.centre) / self.scale
        return float(log_mean(self.tails.log_density(z) - np.log(self.scale)))

    def quantiles(self, levels: FloatArray) -> FloatArray:
        """Quantiles (k,) at levels (k,) inside (0, 1); one lies between those of the parts."""
        return np.array([self._quantile(float(level)) for level in levels])

    def _quantile(self, level: float) -> float:
        of_parts = self.centre + self.scale * self.tails.quantile(np.array(level))
        low, high = float(of_parts.min()), float(of_parts.max())
        width = high - low
        if width <= 1e-12 * max(abs(low), abs(high)):
            return low
        margin = 1e-6 * width  # rounding must not leave the root outside
        return float(
            brentq(
                lambda x: float(self.cdf(np.array([x]))[0]) - level, low - margin, high + margin,
                xtol=1e-10 * width,
            )
        )  # fmt: skip

    def crps(self, y: float) -> float:
        """Continuous ranked probability score of a reading ``y``, in its unit."""
        if self.tails != GAUSSIAN:
            return self._integrated(y)
        square = self.scale**2
        between = _mean_size(self.centre[:, None] - self.centre, square[:, None] + square)
        return float(_mean_size(self.centre - y, square).mean() - 0.5 * between.mean())

    def _integrated(self, y: float) -> float:
        """The integral that defines the score, piece by piece between quantiles, tails mapped to (0, 1)."""
        cuts = np.unique(np.append(self.quantiles(_CUTS), y))
        widths = np.diff(cuts)
        x = (cuts[:-1, None] + widths[:, None] * _U).ravel()
        weight = (widths[:, None] * _DU).ravel()
        reach = float(cuts[-1] - cuts[0]) or 1.0
        tail, stretch = reach * _U / (1 - _U), reach * _DU / (1 - _U) ** 2
        x = np.concatenate([x, cuts[-1] + tail, cuts[0] - tail])
        weight = np.concatenate([weight, stretch, stretch])
        return float((self.cdf(x) - (x >= y)) ** 2 @ weight)


def _mean_size(mean: FloatArray, variance: FloatArray) -> FloatArray:
    """E|X| of normal X."""
    sd = np.sqrt(variance)
    z = mean / sd
    return np.asarray(mean * (2 * ndtr(z) - 1) + 2 * sd * np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi))


DEGREES = (1, 2, 3)
LEAST_DOF = 2
"""Degrees of freedom that must be left for the spread of a regression."""
_SLOPES = 10.0
"""Prior standard deviation of the trend of a Gaussian process, in spreads of the readings."""
_TYPICAL = np.log([1.0, 0.5, 2.0, 0.1])
_DOUBT = np.array([1.0, 1.0, 1.0, 1.5])
"""Medians and logarithmic widths of the log-normal priors: amplitude (in spreads of the readings), length in
slip, length in the other conditions (in spreads of these), noise (in spreads of the readings)."""
_STARTS = np.log([[1.0, 0.5, 2.0, 0.1], [0.5, 0.2, 1.0, 0.3], [2.0, 1.0, 5.0, 0.05]])


@dataclass(frozen=True)
class TrainingRows:
    """Training rows of one channel."""

    conditions: FloatArray  # (n, k), slip first
    readings: FloatArray  # (n,), none missing
    level: IntArray  # (n,) number of the level of every row
    slip_level: IntArray  # (n,) number of the cluster of its slip

    def take(self, keep: BoolArray) -> "TrainingRows":
        """Some of the rows."""
        return TrainingRows(self.conditions[keep], self.readings[keep], self.level[keep], self.slip_level[keep])


@dataclass(frozen=True)
class Answer:
    """Predictive laws at new rows, and what was chosen to get there."""

    laws: tuple[Mixture, ...]
    detail: str = ""


def training_mean(training: TrainingRows, new: FloatArray) -> Answer:
    """The mean of the training rows, whatever the slip: a floor."""
    design, at = np.ones((len(training.readings), 1)), np.ones((len(new), 1))
    return Answer(_regressed(design, training.readings, at))


def polynomial(training: TrainingRows, new: FloatArray) -> Answer:
    """Least squares on powers of slip and on the other conditions, with Student-t predictive laws.

    The degree in slip is the one that, inside the training rows, predicts a level best that it has not seen
    (smallest mean square). Where too few rows are left for any, the mean of the training rows.
    """
    squares = {degree: _left_out_square(training, degree) for degree in DEGREES}
    degree = min(squares, key=lambda each: squares[each])
    if not np.isfinite(squares[degree]):
        return Answer(training_mean(training, new).laws, "mean")
    design, at = _designs(training.conditions, new, degree)
    return Answer(_regressed(design, training.readings, at), f"degree {degree}")


def _designs(conditions: FloatArray, new: FloatArray, degree: int) -> tuple[FloatArray, FloatArray]:
    """Columns for the training rows and the new ones; what does not vary among the former is left out."""
    varies = np.ptp(conditions[:, 1:], axis=0) > 1e-9 * np.abs(conditions[:, 1:]).max(axis=0, initial=0.0)
    centre = conditions[:, 1:][:, varies].mean(axis=0)

    def columns(rows: FloatArray) -> FloatArray:
        powers = rows[:, :1] ** np.arange(degree + 1)
        return np.column_stack([powers, rows[:, 1:][:, varies] - centre])

    return columns(conditions), columns(new)


def _left_out_square(training: TrainingRows, degree: int) -> float:
    """Mean square by which training levels are missed when left out; infinite where that cannot be done."""
    design, _ = _designs(training.conditions, training.conditions, degree)
    if len(design) - design.shape[1] < LEAST_DOF or len(np.unique(training.level)) < 2:
        return np.inf
    misses = []
    for level in np.unique(training.level):
        left = training.level == level
        rest = training.take(~left)
        inner, at = _designs(rest.conditions, training.conditions[left], degree)
        if len(np.unique(rest.slip_level)) <= degree or np.linalg.matrix_rank(inner) < inner.shape[1]:
            return np.inf
        coefficients = np.linalg.lstsq(inner, rest.readings, rcond=None)[0]
        misses.append(training.readings[left] - at @ coefficients)
    return float(np.mean(np.concatenate(misses) ** 2))


def _regressed(design: FloatArray, readings: FloatArray, at: FloatArray) -> tuple[Mixture, ...]:
    """Student-t predictive laws of linear least squares."""
    n, p = design.shape
    dof = n - p
    if dof < 1:
        return ()
    q, r = np.linalg.qr(design)
    coefficients = np.linalg.solve(r, q.T @ readings)
    spread = np.sqrt(np.sum((readings - design @ coefficients) ** 2) / dof)
    spread = max(float(spread), 1e-9 * float(np.abs(readings).max()), 1e-300)
    leverage = (np.linalg.solve(r.T, at.T) ** 2).sum(axis=0)
    scales = spread * np.sqrt(1 + leverage)
    pairs = zip(at @ coefficients, scales, strict=True)
    return tuple(Mixture(np.array([centre]), np.array([scale]), StudentT(float(dof))) for centre, scale in pairs)


def gaussian_process(training: TrainingRows, new: FloatArray) -> Answer:
    """A Gaussian process with a linear trend and a squared-exponential covariance.

    Amplitude, lengths and noise are those of the highest posterior density under wide log-normal priors;
    their own uncertainty is not in the predictive laws, as is usual.
    """
    spread = float(training.readings.std()) or 1.0
    y = (training.readings - training.readings.mean()) / spread
    size = training.conditions.std(axis=0)
    # a constant condition has no effect
    size = np.where(size > 1e-9 * np.abs(training.conditions).max(axis=0), size, np.inf)
    centre = training.conditions.mean(axis=0)
    size[0] = 1.0
    x, at = (training.conditions - centre) / size, (new - centre) / size
    optima = [minimize(_misfit, start, args=(x, y), method="L-BFGS-B") for start in _STARTS]
    best = min(optima, key=lambda each: float(each.fun)).x
    noise = np.exp(2 * best[3])
    factor = cho_factor(_covariance(best, x, x) + noise * np.eye(len(x)), lower=True)
    across = _covariance(best, at, x)
    mean = across @ cho_solve(factor, y)
    own = np.diag(_covariance(best, at, at)) + noise
    variance = np.maximum(own - (across * cho_solve(factor, across.T).T).sum(axis=1), noise)
    pairs = zip(training.readings.mean() + spread * mean, spread * np.sqrt(variance), strict=True)
    laws = tuple(Mixture(np.array([m]), np.array([s])) for m, s in pairs)
    return Answer(laws, f"length {np.exp(best[1]):.2g}")


def _covariance(log: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    """Covariance of a vague linear trend and of the deviations from it."""
    amplitude, slip, others, _ = np.exp(log)
    lengths = np.append(slip, np.full(a.shape[1] - 1, others))
    square = (((a[:, None] - b) / lengths) ** 2).sum(axis=2)
    return np.asarray(_SLOPES**2 * (1 + a @ b.T) + amplitude**2 * np.exp(-0.5 * square))


def _misfit(log: FloatArray, x: FloatArray, y: FloatArray) -> float:
    """Minus the log posterior density of the logarithms of amplitude, lengths and noise."""
    covariance = _covariance(log, x, x) + (np.exp(2 * log[3]) + 1e-8) * np.eye(len(x))
    try:
        factor, lower = cho_factor(covariance, lower=True)
    except np.linalg.LinAlgError:
        return 1e10
    prior = 0.5 * np.sum(((log - _TYPICAL) / _DOUBT) ** 2)
    return float(0.5 * y @ cho_solve((factor, lower), y) + np.log(np.diag(factor)).sum() + prior)


BASELINES: dict[str, Callable[[TrainingRows, FloatArray], Answer]] = {
    "mean": training_mean,
    "polynomial": polynomial,
    "Gaussian process": gaussian_process,
}
"""By the names that tables and figures use, weakest first."""
