"""Ranks of true values among draws: uniformity, coverage, and the verdict on them.

Ranks are normalised to (rank + u) / (draws + 1) with u uniform on (0, 1), which is uniform on (0, 1) if truth
and draws come from one law. The test is the one behind simultaneous ECDF bands (Säilynoja et al. 2022).
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator, default_rng
from scipy.special import ndtri
from scipy.stats import binom, chi2, ncx2, norm

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.likelihood.joint import whole_posterior
from bayesterra.runtime.tables import Count, Record
from bayesterra.study.result import AnalysisResult
from bayesterra.study.study import Study

DRAWS = 99
"""Draws that a true value is ranked among."""
POINTS = 100
"""Intervals that the test counts ranks in."""
SIMULATIONS = 20_000
HAIR = 1e-9
"""Relative difference of statistics that are equal but for rounding."""
COVERAGES = (0.5, 0.8, 0.9, 0.95)
"""Probabilities of the central intervals whose coverage is counted."""


def normalised_rank(truth: float, draws: FloatArray, rng: Generator) -> float:
    """Rank of a true value among draws (n,), as a number in (0, 1); ties are broken at random.

    NaN where nothing varies, so that there is nothing to rank.
    """
    below, ties = int((draws < truth).sum()), int((draws == truth).sum())
    if ties == len(draws):
        return float("nan")
    return float((below + rng.integers(ties + 1) + rng.random()) / (len(draws) + 1))


@dataclass(frozen=True)
class RankTest:
    """The simultaneous test of ``n`` normalised ranks for uniformity; see :func:`rank_test`.

    The statistic is the smallest binomial tail probability of the counts below 1/100, 2/100, ...; its law
    under uniformity is simulated with a fixed stream.
    """

    n: int

    @property
    def points(self) -> FloatArray:
        """Points at which the ranks below are counted."""
        return np.arange(1, POINTS) / POINTS

    @cached_property
    def _tails(self) -> FloatArray:
        """Smaller tail probability of every count 0 ... n at every point, (points, n + 1)."""
        counts, at = np.arange(self.n + 1), self.points[:, None]
        return np.asarray(np.minimum(binom.cdf(counts, self.n, at), binom.sf(counts - 1, self.n, at)))

    @cached_property
    def _uniform(self) -> FloatArray:
        """Sorted statistics of uniform ranks."""
        return np.sort(self._simulated(np.full(POINTS, 1.0 / POINTS), SIMULATIONS, default_rng(0)))

    def _simulated(self, shares: FloatArray, simulations: int, rng: Generator) -> FloatArray:
        counts = rng.multinomial(self.n, shares, size=simulations).cumsum(axis=1)[:, :-1]
        return self._statistic(counts)

    def _statistic(self, counts: IntArray) -> FloatArray:
        """Smallest tail probability of counts (..., points)."""
        return np.asarray(self._tails[np.arange(POINTS - 1), counts].min(axis=-1))

    def below(self, ranks: FloatArray) -> IntArray:
        """Number of ranks below every point."""
        return np.searchsorted(np.sort(ranks), self.points)

    def p_value(self, ranks: FloatArray) -> float:
        """Probability that uniform ranks look at least as far from uniform as these (n,)."""
        as_far = np.searchsorted(self._uniform, self._statistic(self.below(ranks)) * (1 + HAIR), side="right")
        return float((1 + as_far) / (1 + SIMULATIONS))

    def critical(self, level: float) -> float:
        """Largest statistic with a p value of ``level`` at most, and a hair more; 0 where there is none."""
        allowed = int(level * (SIMULATIONS + 1)) - 1  # simulated statistics that may be as small
        first_above = self._uniform[max(allowed, 0)]
        below = np.searchsorted(self._uniform, first_above * (1 - HAIR))  # equal ones stand or fall together
        return float(self._uniform[below - 1] * (1 + HAIR)) if below else 0.0

    def band(self, level: float) -> tuple[FloatArray, FloatArray]:
        """Least and greatest share below every point that the test at ``level`` lets pass."""
        inside = self._tails > self.critical(level)
        low, high = inside.argmax(axis=1), self.n - inside[:, ::-1].argmax(axis=1)
        return low / self.n, high / self.n

    def power(self, shares: FloatArray, level: float) -> float:
        """Probability that the test at ``level`` notices ranks with these shares (100,) in the intervals."""
        statistics = self._simulated(shares, 2000, default_rng(1))
        return float((statistics <= self.critical(level)).mean())


@lru_cache(maxsize=8)
def rank_test(n: int) -> RankTest:
    """The test of ``n`` ranks; its tables are made once."""
    return RankTest(n)


@dataclass(frozen=True)
class Error:
    """An error of a posterior in units of its right standard deviation."""

    name: str
    scale: float = 1.0  # its standard deviation over the right one
    shift: float = 0.0  # of its mean

    def of_value(self) -> FloatArray:
        """Shares (100,) of the ranks of one Gaussian parameter with this error."""
        truth = norm.ppf(_MIDDLES)
        return _shares(norm.cdf((truth - self.shift) / self.scale))

    def of_density(self, d: int) -> FloatArray:
        """Shares (100,) of the ranks of the log density of ``d`` parameters that all have this error."""
        truth = chi2.ppf(_MIDDLES, d) / self.scale**2
        offset = d * (self.shift / self.scale) ** 2
        return _shares(ncx2.cdf(truth, d, offset) if offset else chi2.cdf(truth, d))


_MIDDLES = (np.arange(4000) + 0.5) / 4000


def _shares(below: FloatArray) -> FloatArray:
    """Shares of the ranks 0 ... ``DRAWS``, for the probabilities that a draw lies below the truth."""
    shares = binom.pmf(np.arange(DRAWS + 1), DRAWS, below[:, None]).mean(axis=0)
    return np.asarray(shares / shares.sum())


ERRORS = (
    Error("standard deviation 10 % too small", scale=0.9),
    Error("standard deviation 20 % too small", scale=0.8),
    Error("mean shifted by 0.1 standard deviations", shift=0.1),
    Error("mean shifted by 0.2 standard deviations", shift=0.2),
)
"""Errors whose chance of being noticed stands beside every verdict."""


def covered(ranks: FloatArray, probability: float) -> float:
    """Share of true values inside the central interval of this probability."""
    return float((np.abs(ranks - 0.5) < 0.5 * probability).mean())


def shift_and_width(ranks: FloatArray) -> tuple[float, float]:
    """Error of a Gaussian posterior with such ranks: shift of its mean, and its sd over the right one.

    Normal scores of its ranks have the mean −shift/width and the sd 1/width.
    """
    scores = ndtri(ranks)
    width = 1.0 / float(scores.std())
    return -float(scores.mean()) * width, width


LEVEL = 0.01
"""Probability that a right posterior fails: all quantities together, each at this over their number."""
UNSETTLED = 0.05
"""Share of replications without convergence above which nothing is established."""
CALIBRATED, MISCALIBRATED, UNESTABLISHED = "calibrated", "not calibrated", "not established"
COLUMNS = ("task", "status", "ess", "r_hat", "seconds", "note")
"""Columns of the table beside the ranks."""


@dataclass(frozen=True)
class Calibration(AnalysisResult):
    """Result of a simulation-based calibration (Talts et al. 2018, Modrák et al. 2023).

    Attributes
    ----------
    study : whose conditions, prior and noise were simulated.
    table : one row per replication: ``task``, ``status``, ``ess``, ``r_hat``, processor ``seconds``,
        ``note``, and the normalised rank of every test quantity.
    record : seed, settings and versions.
    """

    MARK = "calibration.json"
    RECORD = Record.having(
        seed=Count, model=str, drive=str, fingerprints=dict[str, str], settings=dict, versions=dict[str, str],
        verdict=str, calibrated=bool, replications=Count, not_converged=Count, failed=Count,
        thresholds=dict[str, float], tests=list[dict[str, Any]], power=list[dict[str, Any]],
    )  # fmt: skip
    VIEW = "bayesterra.checking.calibration_page:calibration"
    WITH_STUDY = True

    study: Study
    table: pd.DataFrame
    record: dict[str, Any]

    @property
    def quantities(self) -> tuple[str, ...]:
        """All test quantities."""
        return tuple(name for name in self.table.columns if name not in COLUMNS)

    @property
    def parameters(self) -> tuple[str, ...]:
        """Free parameters, of all groups where there are any."""
        return whole_posterior(self.study).names

    @property
    def tested(self) -> tuple[str, ...]:
        """Quantities that vary: a flat prior, say, leaves nothing to rank."""
        return tuple(name for name in self.quantities if self.table[name].notna().any())

    @property
    def threshold(self) -> float:
        """The p value below which one quantity fails the whole."""
        return LEVEL / max(1, len(self.tested))

    def ranks(self, quantity: str) -> FloatArray:
        """Normalised ranks of a quantity, converged or not; failed replications have none."""
        return self.table[quantity].dropna().to_numpy(dtype=np.float64)

    def test(self, quantity: str) -> RankTest:
        """The test of a quantity's ranks."""
        return rank_test(len(self.ranks(quantity)))

    @cached_property
    def tests(self) -> pd.DataFrame:
        """One row per quantity: p value, whether it passed, the error that its ranks look like, coverage."""
        return pd.DataFrame([self._tested(name) for name in self.quantities])

    def _tested(self, name: str) -> dict[str, Any]:
        ranks = self.ranks(name)
        if not ranks.size:
            return {"quantity": name, "ranks": 0, "verdict": "constant"}
        p_value, (shift, width) = self.test(name).p_value(ranks), shift_and_width(ranks)
        return {
            "quantity": name,
            "ranks": len(ranks),
            "verdict": "uniform" if p_value > self.threshold else "not uniform",
            "p_value": p_value,
            "shift": shift,
            "width": width,
            **{f"covered_{100 * level:.0f}": covered(ranks, level) for level in COVERAGES},
        }

    @cached_property
    def power(self) -> pd.DataFrame:
        """Chance that these many replications would have noticed an error, by error.

        ``one``: in a single parameter, by its own ranks; ``all``: in all of them, by the log likelihood or
        one of them, whichever is likelier. For a Gaussian posterior and the threshold of one quantity, so
        these are lower bounds.
        """
        test, level = rank_test(self.ranked), self.threshold
        free = len(self.parameters)
        alone = [test.power(error.of_value(), level) for error in ERRORS]
        jointly = [test.power(error.of_density(free), level) for error in ERRORS]
        names = [error.name for error in ERRORS]
        return pd.DataFrame({"error": names, "one": alone, "all": np.maximum(alone, jointly)})

    @property
    def ranked(self) -> int:
        """Replications with ranks."""
        return int((self.table["status"] != FAILED).sum())

    @property
    def unsettled(self) -> int:
        """Replications that failed, or whose sampling did not converge."""
        return int((self.table["status"] != CONVERGED).sum())

    @property
    def failing(self) -> tuple[str, ...]:
        """Quantities whose ranks are not uniform."""
        return tuple(self.tests.loc[self.tests["verdict"] == "not uniform", "quantity"])

    @property
    def verdict(self) -> str:
        """``calibrated``, ``not calibrated``, or ``not established`` for want of convergence."""
        if self.failing:
            return MISCALIBRATED
        settled = self.tested and self.unsettled <= UNSETTLED * len(self.table)
        return CALIBRATED if settled else UNESTABLISHED

    @property
    def calibrated(self) -> bool:
        """True where the verdict is ``calibrated``."""
        return self.verdict == CALIBRATED

    def tables(self) -> dict[str, pd.DataFrame]:
        """The ranks."""
        return {"ranks": self.table}

    def to_record(self) -> dict[str, Any]:
        """Content of the JSON file: the verdict with every figure and threshold behind it."""
        return {
            **self.record,
            "verdict": self.verdict,
            "calibrated": self.calibrated,
            "replications": len(self.table),
            "not_converged": self.unsettled,
            "failed": len(self.table) - self.ranked,
            "thresholds": {"level": LEVEL, "p_value_per_quantity": self.threshold, "share_not_converged": UNSETTLED},
            "tests": [
                {str(name): value for name, value in row.items() if not pd.isna(value)}
                for row in self.tests.to_dict("records")
            ],
            "power": self.power.to_dict("records"),
        }


CONVERGED, UNCONVERGED, FAILED = "converged", "not converged", "failed"
