"""One replication: true values from the cut prior, readings from them, a posterior, ranks."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.calibration.fitting import Fit, Fitted, ShortRuns
from bayesterra.calibration.quantities import quantities, quantity_names
from bayesterra.calibration.ranks import DRAWS, normalised_rank
from bayesterra.errors import BayesterraError, SupportError
from bayesterra.posteriors import draw_cut_prior, posterior
from bayesterra.study import Study

CONVERGED, UNCONVERGED, FAILED = "converged", "not converged", "failed"
_BATCH, _ATTEMPTS = 128, 2000


@dataclass(frozen=True)
class Outcome:
    """What one replication found.

    Attributes
    ----------
    task : its number, from 1.
    status : ``converged``, ``not converged`` or ``failed``; a failed one has no ranks.
    ess, r_hat : of its sampling.
    seconds : processor time.
    note : why it failed.
    ranks : normalised rank of every test quantity, NaN where it is constant.
    """

    task: int
    status: str
    ess: float
    r_hat: float
    seconds: float
    note: str = ""
    ranks: Mapping[str, float] = field(default_factory=dict)

    @classmethod
    def from_record(cls, content: Mapping[str, Any]) -> Outcome:
        """Read back what ``dataclasses.asdict`` wrote; TypeError or ValueError where it is no outcome."""
        one = cls(**content)
        ranks = {str(name): float(rank) for name, rank in one.ranks.items()}
        if one.status not in (CONVERGED, UNCONVERGED, FAILED) or type(one.task) is not int or one.task < 1:
            raise ValueError(f"no outcome of a replication: {one!r:.60}")
        if any(rank < 0 or rank > 1 for rank in ranks.values()):
            raise ValueError(f"no ranks: {ranks!r:.60}")
        ess, r_hat, seconds = float(one.ess), float(one.r_hat), float(one.seconds)
        return cls(one.task, one.status, ess, r_hat, seconds, str(one.note), ranks)


@dataclass(frozen=True)
class Replication:
    """The task of a calibration: a number in, an outcome out, the same wherever and whenever it is run."""

    study: Study
    seed: int
    fit: Fit = field(default_factory=ShortRuns)

    def __call__(self, task: int) -> Outcome:
        """Run replication number ``task``."""
        started = time.process_time()
        making, fitting, ranking = SeedSequence(self.seed, spawn_key=(task,)).spawn(3)
        truth, simulated = replicated(self.study, default_rng(making))
        try:
            fitted = self.fit(simulated, fitting)
            ranks = _ranks(simulated, truth, fitted, default_rng(ranking))
        except (BayesterraError, ArithmeticError, ValueError, np.linalg.LinAlgError) as error:
            names = quantity_names(self.study.prior.names, self.study.drive)
            note, nothing = f"{type(error).__name__}: {error}", float("nan")
            seconds = time.process_time() - started
            return Outcome(task, FAILED, 0.0, nothing, seconds, note, dict.fromkeys(names, nothing))
        status = CONVERGED if fitted.converged else UNCONVERGED
        seconds = time.process_time() - started
        return Outcome(task, status, fitted.ess, fitted.r_hat, seconds, ranks=ranks)


def replicated(study: Study, rng: Generator) -> tuple[FloatArray, Study]:
    """Draw true values (1, d) from the cut prior, and the study with readings that they make.

    Readings are made where the study has some, at its slips, wheels and loads; with the drive ``sinkage`` at
    its sinkage. With ``both`` every load is drawn from its flat prior, and the soil anew where it does not
    carry one of them.

    Raises
    ------
    SupportError : hardly any soil of the prior carries the loads.
    """
    target, likelihood = posterior(study), posterior(study).likelihood
    for _ in range(_ATTEMPTS):
        truth = draw_cut_prior(target, 1, rng, batch=_BATCH).x
        noise = target.noise_values(truth)
        outcomes = likelihood.imagined(target.prior.soil_values(truth), noise, rng)
        if not outcomes.status[0]:
            break
    else:
        raise SupportError(f"none of {_ATTEMPTS} soils of the prior carries loads of the whole load range")
    drawn = likelihood.draw(outcomes, noise, rng)[0]
    drawn[np.isnan(likelihood.measured)] = np.nan
    rows, readings = study.observations, {}
    for i, name in enumerate(likelihood.channels):
        readings[name] = rows.values[name].copy()
        readings[name][rows.use] = drawn[:, i]
    return truth, study.with_data(readings)


def _ranks(study: Study, truth: FloatArray, fitted: Fitted, rng: Generator) -> dict[str, float]:
    draws = spaced(fitted.draws, rng)
    values = quantities(posterior(study), np.concatenate([truth, draws]))
    return {name: normalised_rank(column[0], column[1:], rng) for name, column in values.items()}


def spaced(draws: FloatArray, rng: Generator) -> FloatArray:
    """``DRAWS`` of the draws (n, d), one from each of as many equal stretches."""
    places = (np.arange(DRAWS) + rng.random(DRAWS)) * len(draws) / DRAWS
    return draws[places.astype(np.int64)]
