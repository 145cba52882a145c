"""Simulation-based calibration: whether the posterior is right over the whole prior of a study.

True values are drawn from the cut prior, readings are simulated from them, the posterior of each simulated
table is sampled, and the true values are ranked among its draws (Talts et al. 2018). Functions of readings
and parameters are ranked too, as parameters alone miss whole classes of error (Modrák et al. 2023).
"""

from __future__ import annotations

import platform
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

import pandas as pd
from numpy.random import default_rng

from bayesterra.calibration.fitting import Fit, Fitted, ShortRuns
from bayesterra.calibration.judging import Calibration
from bayesterra.calibration.quantities import quantity_names
from bayesterra.calibration.ranks import DRAWS
from bayesterra.calibration.tasks import CONVERGED, Outcome, Replication
from bayesterra.engines import Engine, ended, in_process
from bayesterra.errors import StudyError
from bayesterra.posteriors import draw_cut_prior, posterior
from bayesterra.record import PACKAGES
from bayesterra.study import Study

__all__ = ["Calibration", "Fit", "Fitted", "Outcome", "Progress", "ShortRuns", "calibrate", "origin"]

FEWEST = 20
"""Fewer replications than this notice nothing but the grossest errors."""


@dataclass(frozen=True)
class Progress:
    """How far a calibration is.

    Attributes
    ----------
    done, of : replications.
    unsettled : those that failed or did not converge.
    seconds_left : at the pace so far; None before the first.
    """

    done: int
    of: int
    unsettled: int
    seconds_left: float | None


def check(study: Study, n: int) -> None:
    """Make sure that a calibration is possible before work is spent on it.

    Raises
    ------
    StudyError : too few replications, or nothing is free.
    SupportError : the prior leaves no parameter set that fits the conditions of the data.
    """
    if n < FEWEST:
        raise StudyError(f"'n' must be at least {FEWEST} replications, better 200 or more (got {n})")
    if not study.prior.names:
        raise StudyError("every parameter is fixed: there is nothing to calibrate")
    draw_cut_prior(posterior(study), 1, default_rng(0))


def calibrate(
    study: Study,
    *,
    n: int,
    seed: int = 1,
    engine: Engine | None = None,
    fit: Fit | None = None,
    finished: Iterable[Outcome] = (),
    report: Callable[[Sequence[Outcome], Progress], None] = lambda outcomes, progress: None,
) -> Calibration:
    """Calibrate the posterior of a study; see the package's docstring.

    Parameters
    ----------
    n : replications; a power of 200 or less is small (the result states it).
    seed : same seed, same outcomes, whatever the engine.
    engine : computes the replications; by default this process.
    fit : samples a posterior; by default the sampler of every run, until there are draws enough to rank.
    finished : outcomes that are known already.
    report : called with new outcomes and the progress, at the start with none.

    Raises
    ------
    StudyError, SupportError : see :func:`check`.
    """
    check(study, n)
    known = {outcome.task: outcome for outcome in finished if outcome.task <= n}
    open_tasks = [task for task in range(1, n + 1) if task not in known]
    replication = Replication(study, seed, fit or ShortRuns())
    started, before = time.perf_counter(), len(known)
    report((), _progress(known, n, None))
    for batch in ended(replication, open_tasks, engine or in_process()):
        known |= batch
        pace = (time.perf_counter() - started) / (len(known) - before)
        report([outcome for _, outcome in batch], _progress(known, n, pace * (n - len(known))))
    return Calibration(study, table([known[task] for task in sorted(known)], study), origin(study, seed, fit))


def _progress(known: dict[int, Outcome], n: int, seconds_left: float | None) -> Progress:
    unsettled = sum(outcome.status != CONVERGED for outcome in known.values())
    return Progress(len(known), n, unsettled, seconds_left)


def table(known: Iterable[Outcome], study: Study) -> pd.DataFrame:
    """One row per outcome; see :attr:`Calibration.table`."""
    rows = [asdict(outcome) for outcome in known]
    ranks = [row.pop("ranks") for row in rows]
    names = quantity_names(study.prior.names, study.drive)
    return pd.DataFrame(rows).join(pd.DataFrame(ranks, columns=list(names)))


def origin(study: Study, seed: int, fit: Fit | None = None) -> dict[str, Any]:
    """What outcomes depend on, and what must be the same for a calibration to go on."""
    chosen = fit or ShortRuns()
    named = {"fit": getattr(chosen, "__qualname__", type(chosen).__name__)}
    settings = chosen.record() if isinstance(chosen, ShortRuns) else named
    return {
        "seed": seed,
        "model": study.model.name,
        "drive": study.drive,
        "fingerprints": study.fingerprint,
        "settings": {"ranked_among": DRAWS, **settings},
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
    }
