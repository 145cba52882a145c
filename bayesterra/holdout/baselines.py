"""Predictions that know no terramechanics, from the same training rows as the model's.

Each is fitted to one channel. It knows slip, load (with the drive ``both`` the normal force as read, with
``sinkage`` the sinkage) and the wheel of every row, and has to find the noise in the training rows itself.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import minimize

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.holdout.mixtures import Mixture

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
class Known:
    """Training rows of one channel.

    Attributes
    ----------
    conditions : (n, k), slip first.
    readings : (n,), none missing.
    level : (n,) number of the level of every row.
    slip_level : (n,) number of the cluster of its slip.
    """

    conditions: FloatArray
    readings: FloatArray
    level: IntArray
    slip_level: IntArray

    def take(self, keep: BoolArray) -> Known:
        """Some of the rows."""
        return Known(self.conditions[keep], self.readings[keep], self.level[keep], self.slip_level[keep])


@dataclass(frozen=True)
class Answer:
    """Predictive laws at new rows, and what was chosen to get there."""

    laws: tuple[Mixture, ...]
    detail: str = ""


def training_mean(known: Known, new: FloatArray) -> Answer:
    """The mean of the training rows, whatever the slip: a floor."""
    design, at = np.ones((len(known.readings), 1)), np.ones((len(new), 1))
    return Answer(_regressed(design, known.readings, at))


def polynomial(known: Known, new: FloatArray) -> Answer:
    """Least squares on powers of slip and on the other conditions, with Student-t predictive laws.

    The degree in slip is the one that, inside the training rows, predicts a level best that it has not seen
    (smallest mean square). Where too few rows are left for any, the mean of the training rows.
    """
    found = {degree: _left_out_square(known, degree) for degree in DEGREES}
    degree = min(found, key=lambda each: found[each])
    if not np.isfinite(found[degree]):
        return Answer(training_mean(known, new).laws, "mean")
    design, at = _designs(known.conditions, new, degree)
    return Answer(_regressed(design, known.readings, at), f"degree {degree}")


def _designs(conditions: FloatArray, new: FloatArray, degree: int) -> tuple[FloatArray, FloatArray]:
    """Columns for the training rows and the new ones; what does not vary among the former is left out."""
    varies = np.ptp(conditions[:, 1:], axis=0) > 1e-9 * np.abs(conditions[:, 1:]).max(axis=0, initial=0.0)
    centre = conditions[:, 1:][:, varies].mean(axis=0)

    def columns(rows: FloatArray) -> FloatArray:
        powers = rows[:, :1] ** np.arange(degree + 1)
        return np.column_stack([powers, rows[:, 1:][:, varies] - centre])

    return columns(conditions), columns(new)


def _left_out_square(known: Known, degree: int) -> float:
    """Mean square by which training levels are missed when left out; infinite where that cannot be done."""
    design, _ = _designs(known.conditions, known.conditions, degree)
    if len(design) - design.shape[1] < LEAST_DOF or len(np.unique(known.level)) < 2:
        return np.inf
    misses = []
    for level in np.unique(known.level):
        left = known.level == level
        rest = known.take(~left)
        inner, at = _designs(rest.conditions, known.conditions[left], degree)
        if len(np.unique(rest.slip_level)) <= degree or np.linalg.matrix_rank(inner) < inner.shape[1]:
            return np.inf
        coefficients = np.linalg.lstsq(inner, rest.readings, rcond=None)[0]
        misses.append(known.readings[left] - at @ coefficients)
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
    return tuple(Mixture(np.array([centre]), np.array([scale]), float(dof)) for centre, scale in pairs)


def gaussian_process(known: Known, new: FloatArray) -> Answer:
    """A Gaussian process with a linear trend and a squared-exponential covariance.

    Amplitude, lengths and noise are those of the highest posterior density under wide log-normal priors;
    their own uncertainty is not in the predictive laws, as is usual.
    """
    spread = float(known.readings.std()) or 1.0
    y = (known.readings - known.readings.mean()) / spread
    size = known.conditions.std(axis=0)
    size = np.where(size > 1e-9 * np.abs(known.conditions).max(axis=0), size, np.inf)  # constant: no effect
    centre = known.conditions.mean(axis=0)
    size[0] = 1.0
    x, at = (known.conditions - centre) / size, (new - centre) / size
    found = [minimize(_misfit, start, args=(x, y), method="L-BFGS-B") for start in _STARTS]
    best = min(found, key=lambda each: float(each.fun)).x
    noise = np.exp(2 * best[3])
    factor = cho_factor(_covariance(best, x, x) + noise * np.eye(len(x)), lower=True)
    across = _covariance(best, at, x)
    mean = across @ cho_solve(factor, y)
    own = np.diag(_covariance(best, at, at)) + noise
    variance = np.maximum(own - (across * cho_solve(factor, across.T).T).sum(axis=1), noise)
    pairs = zip(known.readings.mean() + spread * mean, spread * np.sqrt(variance), strict=True)
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


BASELINES: dict[str, Callable[[Known, FloatArray], Answer]] = {
    "mean": training_mean,
    "polynomial": polynomial,
    "Gaussian process": gaussian_process,
}
"""By the names that tables and figures use."""


def baseline_names() -> Sequence[str]:
    """Names of the baselines, weakest first."""
    return tuple(BASELINES)
