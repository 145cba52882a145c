"""Out of sample: rows are left out level by level, predicted by a fit to the others, and scored.

What a left-out row keeps is what somebody who plans that drive would know: its slip, its wheel and its load.
With the drive ``both`` that is the normal force as it was read, from which each draw's true load is inferred;
with ``sinkage`` it is the sinkage. Everything else that was read is predicted, noise included.

A draw for which the model has no answer (no sinkage carries the load, say) states that the drive cannot be.
As it was made, such draws are set aside and the others predict; their share is in the table.
"""

from __future__ import annotations

import platform
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import pandas as pd

from bayesterra.calibration.fitting import Fit, ShortRuns
from bayesterra.calibration.tasks import CONVERGED
from bayesterra.engines import Engine, completed, in_process
from bayesterra.errors import StudyError
from bayesterra.holdout.levels import TOLERANCE, By, Level, levels
from bayesterra.holdout.summary import skills, summarise
from bayesterra.holdout.tasks import DRAWS, REFITS, Band, LeaveOneOut, Outcome
from bayesterra.record import PACKAGES
from bayesterra.study import Study

__all__ = ["Band", "Holdout", "Level", "Outcome", "leave_out", "levels"]


@dataclass(frozen=True)
class Holdout:
    """Every level left out once.

    Attributes
    ----------
    study : what was analysed.
    levels : what was left out, in order.
    outcomes : one per level.
    record : grouping, seed, settings, fingerprints and versions.
    """

    study: Study
    levels: tuple[Level, ...]
    outcomes: tuple[Outcome, ...]
    record: dict[str, Any]

    @property
    def model(self) -> str:
        """The model's name among the predictors."""
        return self.study.model.name

    @property
    def converged(self) -> bool:
        """Whether every refit converged."""
        return all(outcome.status == CONVERGED for outcome in self.outcomes)

    @property
    def table(self) -> pd.DataFrame:
        """One row per predictor, left-out row and channel.

        Observed value, predictive quantiles, probability below the reading (``pit``), CRPS, log of the
        predictive density, whether the central 50 and 90 % hold the reading, the share of draws without an
        answer; all in field units.
        """
        return pd.DataFrame([row for outcome in self.outcomes for row in outcome.rows])

    @property
    def summary(self) -> pd.DataFrame:
        """Mean scores by predictor, channel and part; see :func:`bayesterra.holdout.summary.summarise`."""
        return summarise(self.table)

    @property
    def skills(self) -> pd.DataFrame:
        """The model against every baseline; see :func:`bayesterra.holdout.summary.skills`."""
        return skills(self.table, self.model, self.record["seed"])

    @property
    def refits(self) -> pd.DataFrame:
        """One row per level: rows left out, and how the refit went."""
        rows = self.study.observations.rows
        return pd.DataFrame(
            [
                {
                    "level": level.name,
                    "rows": " ".join(str(rows[i]) for i in level.left.nonzero()[0]),
                    "status": outcome.status,
                    "ess": outcome.ess,
                    "r_hat": outcome.r_hat,
                    "seconds": outcome.seconds,
                    "note": outcome.note,
                }
                for level, outcome in zip(self.levels, self.outcomes, strict=True)
            ]
        )


def leave_out(
    study: Study,
    *,
    by: By = "slip",
    tolerance: float = TOLERANCE,
    seed: int = 1,
    engine: Engine | None = None,
    fit: Fit | None = None,
    report: Callable[[str], None] = lambda part: None,
) -> Holdout:
    """Leave every level out once; see the package's docstring.

    Parameters
    ----------
    by, tolerance : how rows are grouped; see :func:`bayesterra.holdout.levels.levels`.
    seed : same seed, same scores, whatever the engine.
    engine : computes the refits; by default this process.
    fit : samples a posterior; by default the sampler of every run, until there are 1000 effective draws.
    report : told what is at work.

    Raises
    ------
    StudyError : nothing is free, nothing is left to score or to fit to, or an unknown grouping.
    """
    if not study.prior.names:
        raise StudyError("every parameter is fixed: there is nothing to fit again")
    parts = levels(study, by, tolerance)
    task = LeaveOneOut(study, parts, seed, fit or REFITS)
    done: dict[int, Outcome] = {}
    report(f"leaving out {len(parts)} levels, one at a time")
    for number, outcome in completed(task, range(len(parts)), engine or in_process()):
        done[number] = outcome
        report(f"leaving out {len(parts)} levels: {len(done)} done")
    found = tuple(done[number] for number in range(len(parts)))
    return Holdout(study, parts, found, _record(study, by, tolerance, seed, fit or REFITS))


def _record(study: Study, by: By, tolerance: float, seed: int, fit: Fit) -> dict[str, Any]:
    """What the outcomes depend on."""
    named = {"fit": getattr(fit, "__qualname__", type(fit).__name__)}
    return {
        "kind": "holdout",
        "by": by if isinstance(by, str) else "groups given",
        **({"tolerance": tolerance} if by == "slip" else {}),
        "seed": seed,
        "model": study.model.name,
        "drive": study.drive,
        "data": study.kind,
        "fingerprints": study.fingerprint,
        "settings": {"draws": DRAWS, **(fit.record() if isinstance(fit, ShortRuns) else named)},
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    }
