"""The verdict on ranks: every quantity's test, coverage, and what errors would have been noticed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.calibration.ranks import COVERAGES, ERRORS, RankTest, covered, rank_test, shift_and_width
from bayesterra.calibration.tasks import CONVERGED, FAILED
from bayesterra.study import Study

LEVEL = 0.01
"""Probability that a right posterior fails: all quantities together, each at this over their number."""
UNSETTLED = 0.05
"""Share of replications without convergence above which nothing is established."""
CALIBRATED, MISCALIBRATED, UNESTABLISHED = "calibrated", "not calibrated", "not established"
COLUMNS = ("task", "status", "ess", "r_hat", "seconds", "note")
"""Columns of the table beside the ranks."""


@dataclass(frozen=True)
class Calibration:
    """What a simulation-based calibration found (Talts et al. 2018, Modrák et al. 2023).

    Attributes
    ----------
    study : whose conditions, prior and noise were simulated.
    table : one row per replication: ``task``, ``status``, ``ess``, ``r_hat``, processor ``seconds``,
        ``note``, and the normalised rank of every test quantity.
    record : seed, settings and versions.
    """

    study: Study
    table: pd.DataFrame
    record: dict[str, Any]

    @property
    def quantities(self) -> tuple[str, ...]:
        """All test quantities."""
        return tuple(name for name in self.table.columns if name not in COLUMNS)

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
        free = len(self.study.prior.names)
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
        """Whether the verdict is ``calibrated``."""
        return self.verdict == CALIBRATED

    def findings(self) -> dict[str, Any]:
        """Content of ``calibration.json``: the verdict with every figure and threshold behind it."""
        return {
            **self.record,
            "verdict": self.verdict,
            "calibrated": self.calibrated,
            "replications": len(self.table),
            "not_converged": self.unsettled,
            "failed": len(self.table) - self.ranked,
            "thresholds": {
                "level": LEVEL,
                "p_value_per_quantity": self.threshold,
                "share_not_converged": UNSETTLED,
            },
            "tests": [_known(row) for row in self.tests.to_dict("records")],
            "power": self.power.to_dict("records"),
        }


def _known(row: dict[Any, Any]) -> dict[str, Any]:
    """A row without its gaps."""
    return {str(name): value for name, value in row.items() if not pd.isna(value)}
