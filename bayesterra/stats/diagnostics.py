"""Diagnostics of draws: convergence of independent ensembles, uniformity, divergence from a prior.

The only module that imports ArviZ.

Chains have shape (ensembles, steps, walkers). Walkers of one ensemble depend on each other, so they are never
taken for chains: autocorrelation times come from the walker-averaged autocovariance of each ensemble, R-hat
compares ensembles only.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import Any

import numpy as np
from numpy.random import default_rng
from scipy.special import chdtrc, digamma, ndtr, ndtri, stdtrit
from scipy.stats import binom, rankdata

from bayesterra.arrays import FloatArray, IntArray

R_HAT_LIMIT = 1.01
STEPS_PER_TAU = 50
DISAGREEMENT = 1e-3
"""p value, over all parameters, below which halves of ensembles differ by more than Monte Carlo error."""
TAILS = (0.05, 0.95)


@cache
def array_stats() -> Any:
    """ArviZ's statistics of arrays, loaded where they are first used: they bring matplotlib with them."""
    from arviz_stats.base.array import array_stats

    return array_stats


def autocovariance(chain: FloatArray) -> FloatArray:
    """Walker-averaged autocovariance (..., steps) of chains (..., steps, walkers), by Fourier transform."""
    steps = chain.shape[-2]
    centred = chain - chain.mean(axis=(-2, -1), keepdims=True)
    power = np.abs(np.fft.rfft(centred, n=2 * steps, axis=-2)) ** 2
    return np.asarray(np.fft.irfft(power.mean(axis=-1), n=2 * steps, axis=-1)[..., :steps] / steps)


def autocorrelation_time(chain: FloatArray, window: float = 5.0) -> FloatArray:
    """Integrated autocorrelation time, in steps, of chains (..., steps, walkers).

    Sokal's (1997) self-consistent window on the walker-averaged autocovariance; NaN for a constant chain.
    """
    covariance = autocovariance(chain)
    with np.errstate(invalid="ignore", divide="ignore"):
        correlation = covariance / covariance[..., :1]
    times = 2.0 * np.cumsum(correlation, axis=-1) - 1.0
    lags = np.arange(times.shape[-1])
    closed = lags >= window * times
    stop = np.where(closed.any(axis=-1), closed.argmax(axis=-1), times.shape[-1] - 1)
    return np.asarray(np.take_along_axis(times, stop[..., None], axis=-1)[..., 0])


def effective_size(chains: FloatArray) -> float:
    """Effective number of draws in (ensembles, steps, walkers): their number over the ensembles' mean τ.

    Equal to walkers · steps / τ summed over ensembles where these agree on τ. Where they do not, that sum is
    too large: pooled draws weigh a slow ensemble as much as a fast one (and so does ArviZ). None where an
    ensemble stands still.
    """
    times = np.maximum(autocorrelation_time(chains), 1.0 / chains.shape[2])
    return 0.0 if np.isnan(times).any() else float(chains.size / times.mean())


def rank_scores(chains: FloatArray) -> FloatArray:
    """Rank-normalised draws, of which mean and autocorrelation always exist (Vehtari et al. 2021)."""
    ranks = rankdata(chains, axis=None).reshape(chains.shape)
    return np.asarray(ndtri((ranks - 0.375) / (chains.size + 0.25)))


def tail_indicators(chains: FloatArray) -> tuple[FloatArray, ...]:
    """Indicators of draws at or below the 5 and 95 % quantiles, below one that is the greatest value."""
    greatest = chains.max()
    below = (chains < q if q == greatest else chains <= q for q in np.quantile(chains, TAILS))
    return tuple(inside.astype(float) for inside in below)


def disagreement(values: FloatArray, size: float) -> float:
    """P value of the means of both halves of every ensemble being those of one law.

    R-hat below its limit allows ensembles to differ by some hundredths of a standard deviation however many
    draws there are; this allows what Monte Carlo error does. ``values`` (ensembles, steps, walkers) have
    ``size`` effective draws.
    """
    half = values.shape[1] // 2
    means = np.concatenate([values[:, :half].mean(axis=(1, 2)), values[:, -half:].mean(axis=(1, 2))])
    error = values.var() * len(means) / max(size, 1e-300)
    return float(chdtrc(len(means) - 1, ((means - means.mean()) ** 2).sum() / max(error, 1e-300)))


def r_hat(chains: FloatArray) -> float:
    """Rank-normalised split R-hat across ensembles.

    Each ensemble is one chain, laid step after step, so that the split compares early with late steps.
    """
    return array_r_hat(chains.reshape(len(chains), -1))


def array_r_hat(chains: FloatArray) -> float:
    """ArviZ's rank-normalised split R-hat of chains (chains, draws); NaN where nothing varies."""
    with np.errstate(invalid="ignore", divide="ignore"):
        return float(array_stats().rhat(chains, chain_axis=0, draw_axis=1))


def thinning(chains: FloatArray, loss: float = 0.1) -> int:
    """Largest step between kept draws that costs no quantity more than ``loss`` of its effective draws.

    ``chains`` has shape (parameters, ensembles, steps, walkers).
    """
    varying = [chain for chain in chains if effective_size(chain) > 0]
    full = [effective_size(chain) for chain in varying]
    best = 1
    for every in range(2, max(2, chains.shape[2] // STEPS_PER_TAU) + 1):
        kept = [effective_size(chain[:, ::every]) for chain in varying]
        if min((k / f for k, f in zip(kept, full, strict=True)), default=0.0) < 1.0 - loss:
            break
        best = every
    return best


def hdi(draws: FloatArray, probability: float = 0.9) -> tuple[float, float]:
    """Highest-density interval of draws (n,)."""
    low, high = array_stats().hdi(np.asarray(draws).ravel(), prob=probability)
    return float(low), float(high)


def monte_carlo_error(chains: FloatArray, statistic: str) -> float:
    """Monte Carlo standard error of the ``mean``, ``median`` or ``sd`` of chains (chains, draws)."""
    if np.ptp(chains) == 0:
        return 0.0
    return float(array_stats().mcse(chains, chain_axis=0, draw_axis=1, method=statistic))


def array_ess(chains: FloatArray, method: str = "bulk") -> float:
    """ArviZ's own effective sample size of chains (chains, draws), to hold beside ours."""
    prob = TAILS if method == "tail" else None
    return float(array_stats().ess(chains, chain_axis=0, draw_axis=1, method=method, prob=prob))


@dataclass(frozen=True)
class Check:
    """One test of the sampling: what was measured, what was asked, and whether it passed."""

    name: str
    value: float
    threshold: float
    passed: bool
    advice: str


@dataclass(frozen=True)
class Diagnosis:
    """Verdict on a set of ensembles.

    It tells whether they agree with each other and within themselves. It cannot tell of a mode that none of
    them found: they follow one recipe, and a narrow mode that escapes it escapes all of them.
    """

    names: tuple[str, ...]  # parameters
    ess_bulk: FloatArray  # effective draws of the middle of each parameter
    ess_tail: FloatArray  # of its 5 and 95 % points
    r_hat: FloatArray  # of each parameter
    tau: FloatArray  # autocorrelation time of each, steps, pooled over ensembles
    acceptance: float  # share of accepted steps, over all walkers
    steps: int  # kept steps per walker
    checks: tuple[Check, ...]  # every test with its threshold

    @property
    def converged(self) -> bool:
        """True where every check passed."""
        return all(check.passed for check in self.checks)

    @property
    def ess(self) -> float:
        """The smallest bulk or tail effective sample size."""
        return float(min(self.ess_bulk.min(), self.ess_tail.min()))

    @property
    def worst_r_hat(self) -> float:
        """The largest R-hat."""
        return float(self.r_hat.max())


def diagnose(
    names: Sequence[str], chains: FloatArray, accepted: FloatArray, target_ess: float, *, going_on: bool = False
) -> Diagnosis:
    """Judge ensembles.

    Parameters
    ----------
    names : parameters (d).
    chains : kept draws (ensembles, steps, walkers, d).
    accepted : share of kept steps that each walker accepted (ensembles, walkers).
    target_ess : effective draws asked for.
    going_on : the ensembles go on where they have not converged. R-hat, which is dear, is then NaN as long as
        another check fails, and where that of a slower parameter does.
    """
    columns = np.ascontiguousarray(np.moveaxis(chains, -1, 0))
    sizes, differing = np.array([_sizes(column) for column in columns]).transpose(1, 0, 2)
    with np.errstate(divide="ignore"):
        tau = columns[0].size / np.array([effective_size(column) for column in columns])
    bulk, tail, steps = sizes[:, 0], sizes[:, 1:].min(axis=1), int(chains.shape[1])
    early = bool(sizes.min() < target_ess) or not steps >= STEPS_PER_TAU * tau.max()
    differing = differing.min(axis=1) * differing.size  # p values, times their number
    walkers = _on_walkers(accepted)
    early |= differing.min() < DISAGREEMENT or not all(check.passed for check in walkers)
    hats = np.full(len(columns), np.nan)
    for i in np.argsort(sizes.min(axis=1)) if not (going_on and early) else ():
        hats[i] = r_hat(columns[i])
        if going_on and not hats[i] < R_HAT_LIMIT:
            break
    on_draws = _on_draws(names, np.minimum(bulk, tail), hats, tau, differing, steps, target_ess)
    checks = (*on_draws, *walkers)
    return Diagnosis(tuple(names), bulk, tail, hats, tau, float(accepted.mean()), steps, checks)


def _sizes(column: FloatArray) -> tuple[list[float], list[float]]:
    """Effective sizes and p values of disagreement for the centre and both tails of a parameter."""
    statistics = (rank_scores(column), *tail_indicators(column))
    sizes = [effective_size(part) for part in statistics]
    return sizes, [disagreement(part, size) for part, size in zip(statistics, sizes, strict=True)]


def _on_draws(
    names: Sequence[str], ess: FloatArray, hats: FloatArray, tau: FloatArray, differing: FloatArray,
    steps: int, target_ess: float,
) -> tuple[Check, ...]:  # fmt: skip
    hat = np.nan_to_num(hats, nan=np.inf)
    needed = STEPS_PER_TAU * float(np.nan_to_num(tau, nan=np.inf).max())
    slowest, worst = names[int(ess.argmin())], names[int(hat.argmax())]
    apart, p = names[int(differing.argmin())], min(1.0, float(differing.min()))
    return (
        Check("effective draws", float(ess.min()), target_ess, bool(ess.min() >= target_ess),
              f"run longer: {slowest} is the slowest"),
        Check("R-hat across ensembles", float(hat.max()), R_HAT_LIMIT, bool(hat.max() < R_HAT_LIMIT),
              f"the ensembles disagree on {worst}: run longer, or look for a second mode"),
        Check("agreement of ensembles and halves (p)", p, DISAGREEMENT, p >= DISAGREEMENT,
              f"means or tails of {apart} differ by more than chance: run longer, or look for a second mode"),
        Check("steps for a reliable autocorrelation time", float(steps), needed, steps >= needed,
              f"run at least {STEPS_PER_TAU} autocorrelation times"),
    )  # fmt: skip


def _on_walkers(accepted: FloatArray) -> tuple[Check, ...]:
    frozen = int((accepted == 0).sum())
    slow = float(accepted.min() / max(np.median(accepted), 1e-300))
    return (
        Check("walkers that never moved", float(frozen), 0.0, frozen == 0,
              "a walker is stuck where the proposals do not reach"),
        Check("slowest walker's acceptance over the median", slow, 0.2, slow >= 0.2,
              "a walker hardly moves: the proposals miss a part of the posterior"),
    )  # fmt: skip


PLACES = 200
"""Places, at most, at which a band of an empirical distribution is told."""


@lru_cache
def ecdf_band(n: int, probability: float = 0.95, simulations: int = 2000) -> tuple[FloatArray, FloatArray]:
    """Simultaneous band of the empirical distribution of n uniform values (Säilynoja et al. 2022).

    Returns lower and upper ends at 1/k, 2/k, ..., 1, with k = n but ``PLACES`` at most, such that the whole curve lies
    inside with the probability given; found by simulation with a fixed stream.
    """
    k, rng = min(n, PLACES), default_rng(0)
    points = np.arange(1, k + 1) / k
    if n > k:
        counts = rng.multinomial(n, np.full(k, 1 / k), size=simulations).cumsum(axis=1)
    else:
        values = np.sort(rng.random((simulations, n)), axis=1)
        counts = np.array([np.searchsorted(sample, points, side="right") for sample in values])
    tails = np.minimum(binom.cdf(counts, n, points), binom.sf(counts - 1, n, points))[:, :-1].min(axis=1)
    level = np.quantile(tails, 1.0 - probability)
    return binom.ppf(level, n, points) / n, binom.isf(level, n, points) / n


def calibrated(pit: Sequence[float]) -> bool:
    """True where PIT values, NaN left out, keep inside the 95 % band of uniform ones."""
    values = np.sort([p for p in pit if np.isfinite(p)])
    low, high = ecdf_band(len(values))
    share = np.searchsorted(values, np.arange(1, len(low) + 1) / len(low), side="right") / len(values)
    return bool(((share >= low) & (share <= high)).all())


def divergence(draws: FloatArray, reference: FloatArray) -> tuple[float, float]:
    """Divergence (nats) of the law of ``draws`` (n,) from that of ``reference`` (m,), and its standard error.

    The mean over the draws of log p − log q. Both densities come from the width of a window of √n order
    statistics to either side, cut off at the ends of the sample, so that a law may end abruptly there
    (windows as Vasicek 1976; the digamma function makes the log of every width unbiased where the density is
    even). Error by the delta method: var(log p/q)/n + (mean(p/q) − 1)/m. Both sets must be nearly
    independent. A law many times narrower than the gaps of the reference has an error that says so.
    """
    k = round(np.sqrt(len(draws)))
    ratio = _log_density_within(np.sort(draws), k) - _log_density_at(np.sort(draws), np.sort(reference), k)
    error = ratio.var() / len(draws) + max(np.exp(ratio).mean() - 1.0, 0.0) / len(reference)
    return float(ratio.mean()), float(np.sqrt(error))


def _log_density_within(x: FloatArray, k: int) -> FloatArray:
    """Log density (n,) at sorted draws, each from the gaps of its own window."""
    place = np.arange(len(x))
    low, high = np.maximum(place - k, 0), np.minimum(place + k, len(x) - 1)
    return np.asarray(digamma(high - low) - np.log(_width(x[low], x[high])) - np.log(len(x)))


def _log_density_at(points: FloatArray, x: FloatArray, k: int) -> FloatArray:
    """Log density at points (n,) of the law of sorted draws (m,): 2k − 1 gaps have the length of 2k."""
    below: IntArray = np.searchsorted(x, points)
    low, high = np.maximum(below - k, 0), np.minimum(below + k - 1, len(x) - 1)
    left, right = np.minimum(x[low], points), np.maximum(x[high], points)
    gaps = high - low + 1.0
    return np.asarray(digamma(gaps) - np.log(_width(left, right)) - np.log(len(x)))


def _width(left: FloatArray, right: FloatArray) -> FloatArray:
    return np.maximum(right - left, 1e-300)


STATIONARY = 0.463
"""Statistic of :func:`level_stationarity` that one stationary series in twenty exceeds."""


def level_stationarity(series: FloatArray) -> float:
    """Statistic of Kwiatkowski, Phillips, Schmidt and Shin (1992) for a constant level of a series (n,).

    The long-run variance has Bartlett's weights over 4 (n/100)^(1/4) lags; 0 for a constant series.
    """
    n, centred = len(series), series - series.mean()
    lags = int(4 * (n / 100) ** 0.25)
    products = [float(centred[lag:] @ centred[: n - lag]) / n for lag in range(lags + 1)]
    variance = products[0] + 2 * sum((1 - lag / (lags + 1)) * products[lag] for lag in range(1, lags + 1))
    return float(np.sum(np.cumsum(centred) ** 2) / (n**2 * variance)) if variance > 0 else 0.0


def error_of_mean(series: FloatArray) -> float:
    """Standard error of the mean of a short stationary series (n,), n above 3, two of which hold 95 % of means.

    Neighbours may hang together: a series of first order, its correlation corrected for its bias of
    (1 + 3 ρ)/n (Kendall 1954); then Student's t with as many values as are independent.
    """
    n, centred = len(series), series - series.mean()
    power = float(centred @ centred)
    if power == 0:
        return 0.0
    correlation = float(centred[1:] @ centred[:-1]) / power
    correlation = min(max(0.0, (n * correlation + 1) / (n - 3)), 1 - 2 / n)
    time = (1 + correlation) / (1 - correlation)
    size = max(n / time, 2.0)
    variance = power / n / (1 - 1 / size)
    return float(np.sqrt(variance / size) * stdtrit(size - 1, ndtr(2.0)) / 2)
