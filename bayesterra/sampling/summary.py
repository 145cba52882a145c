"""Summary of draws: the posterior mode, and a table of every quantity with its errors and prior."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.forward import derive
from bayesterra.likelihood.posterior import Posterior
from bayesterra.likelihood.target import Target, chart, edges
from bayesterra.parameters import DERIVED, PARAMETERS, SIZES, Parameter
from bayesterra.report.verdicts import Failures
from bayesterra.stats.diagnostics import Diagnosis, array_ess, array_r_hat, hdi, monte_carlo_error
from bayesterra.stats.optimiser import descend
from bayesterra.study.study import Study

CREDIBLE = 0.9
INSIDE = "inside"
DERIVED_DRAWS = 1000
"""Draws per chain, at most, that derived quantities are computed for."""


def summary_table(
    study: Study,
    posterior: Posterior,
    chains: FloatArray,
    prior: FloatArray,
    mode: FloatArray,
    diagnosis: Diagnosis,
    failures: Failures,
) -> pd.DataFrame:
    """One row per free parameter, then one per derived quantity that has answers and varies, in field units.

    ``mode_at``: the edge of the prior or of physics that the mode lies on, else ``inside``.

    Parameters
    ----------
    chains : near-independent draws (chains, draws, d).
    prior : draws of the cut prior (n, d).
    mode : posterior mode (d,).
    diagnosis : effective sizes and R-hat of the parameters.
    failures : takes note where derived quantities cannot be computed; the parameters stand without them.
    """
    rows = parameter_rows([PARAMETERS[name] for name in posterior.names], chains, prior, mode, diagnosis)
    derived = failures.attempt(
        "derived",
        lambda: _derived_rows(study, posterior, chains, prior, mode) if study.wheels else [],
        list[dict[str, Any]],
    )
    table, at = pd.DataFrame(rows + derived), edges(posterior, mode)
    return table.assign(mode_at=[at.get(name, INSIDE) for name in table["parameter"]])


def parameter_rows(
    quantities: Sequence[Parameter], chains: FloatArray, prior: FloatArray, mode: FloatArray, diagnosis: Diagnosis
) -> list[dict[str, Any]]:
    """One :func:`summary_row` per parameter (d,) of chains (chains, draws, d) and prior draws (n, d)."""
    sizes = zip(diagnosis.ess_bulk, diagnosis.ess_tail, diagnosis.r_hat, strict=True)
    columns = zip(quantities, np.moveaxis(chains, 2, 0), prior.T, mode, sizes, strict=True)
    return [summary_row(quantity, x, before, float(at), of) for quantity, x, before, at, of in columns]


def _derived_rows(
    study: Study, posterior: Posterior, chains: FloatArray, prior: FloatArray, mode: FloatArray
) -> list[dict[str, Any]]:
    subset = chains[:, :: max(1, chains.shape[1] // DERIVED_DRAWS)]
    soil = posterior.prior.soil_values
    drawn = derive(study, soil(subset.reshape(-1, subset.shape[2])))
    before = derive(study, soil(prior[:DERIVED_DRAWS]))
    best = derive(study, soil(mode[None]))
    rows = []
    for name, quantity in DERIVED.items():
        values = drawn[name].reshape(subset.shape[:2])
        finite = values[np.isfinite(values)]
        # answers are all the same where nothing behind them is free
        if finite.size and np.ptp(finite) > 0 and np.isfinite(before[name]).any():
            diagnosis = array_diagnosis(values)
            rows.append(summary_row(quantity, values, before[name], float(best[name][0]), diagnosis))
    return rows


def array_diagnosis(chains: FloatArray) -> tuple[float, float, float]:
    """ArviZ's bulk and tail sizes and R-hat; draws without an answer stand at the median."""
    chains = np.where(np.isfinite(chains), chains, np.nanmedian(chains))
    return array_ess(chains, "bulk"), array_ess(chains, "tail"), array_r_hat(chains)


def summary_row(
    quantity: Parameter, chains: FloatArray, prior: FloatArray, mode: float, diagnosis: Sequence[float]
) -> dict[str, Any]:
    """One row in field units.

    Parameters
    ----------
    quantity : what the row is about.
    chains : draws (chains, draws), SI; NaN where there is no answer.
    prior : draws of the cut prior (n,), SI.
    mode : value at the posterior mode, SI.
    diagnosis : bulk and tail effective size and R-hat.
    """
    chains, prior = chains / quantity.scale, prior[np.isfinite(prior)] / quantity.scale
    finite = np.isfinite(chains)
    draws = chains[finite]
    low, high = hdi(draws, CREDIBLE)
    complete = chains if finite.all() else draws[: len(draws) // 4 * 4].reshape(4, -1)
    errors = {f"mcse_{s}": monte_carlo_error(complete, s) for s in ("mean", "median", "sd")}
    return {
        "parameter": quantity.name, "unit": quantity.unit, "mode": mode / quantity.scale, "mean": draws.mean(),
        "median": np.median(draws), "sd": draws.std(), "hdi90_lo": low, "hdi90_hi": high, **errors,
        **dict(zip(("ess_bulk", "ess_tail", "r_hat"), diagnosis, strict=True)), "prior_mean": prior.mean(),
        "prior_sd": prior.std(),
    }  # fmt: skip


STARTS = 8
MOST = 400
"""Steps of a descent: bent valleys take many."""


@dataclass(frozen=True)
class Mode:
    """The most probable parameter set.

    Attributes
    ----------
    x : parameters (d,) in the posterior's order; estimated noise stands at its posterior median, because the
        joint mode of a spread and what spreads is no fair summary of either.
    log_density : log posterior density there.
    agreeing : how many of the optimiser's starts ended within 0.01 of it in log density.
    starts : how many starts there were.
    """

    x: FloatArray
    log_density: float
    agreeing: int
    starts: int


def find_mode(
    posterior: Posterior,
    draws: FloatArray,
    guesses: Sequence[Mapping[str, float]] = (),
    held: Mapping[str, float] | None = None,
) -> Mode:
    """Maximise the posterior density of the soil parameters, noise held at its posterior median.

    Parameters
    ----------
    posterior : the density.
    draws : posterior draws (n, d); the densest of them are starting points.
    guesses : further starting points, soil parameters by name.
    held : parameters held at a value: the mode is conditional on it, with a density of 0 where there is none.
    """
    held = held or {}
    median = {**dict(zip(posterior.names, np.median(draws, axis=0), strict=True)), **held}
    soil = np.array([not name.startswith(SIZES) and name not in held for name in posterior.names])
    near = np.where(soil, draws, [median[name] for name in posterior.names])
    density = posterior.log_density(near)
    n = len(near)  # the densest first, then ever further down the list
    ranks = sorted({min(n - 1, int(n * 0.5 * (i / (STARTS - 1)) ** 2)) for i in range(STARTS)})
    starts = near[np.argsort(-density, kind="stable")[ranks]]
    others = [[{**median, **guess, **held}[name] for name in posterior.names] for guess in guesses]
    starts = np.vstack([starts, *others])
    starts = starts[posterior.log_density(starts) > -np.inf]
    if not len(starts):
        return Mode(near[0], -np.inf, 0, 0)
    target = Target(posterior, chart(posterior, np.vstack([near, starts])), with_prior=True, anchor=None)
    y = descend(target, target.chart.from_physical(starts), np.broadcast_to(~soil, starts.shape), MOST).y
    ends = np.where(soil, target.chart.to_physical(y), starts)
    levels = posterior.log_density(ends)
    best = int(levels.argmax())
    agreeing = int((levels > levels[best] - 0.01).sum())
    return Mode(ends[best], float(levels[best]), agreeing, len(starts))


def densest(posterior: Posterior, draws: FloatArray) -> Mode:
    """The densest of posterior draws (n, d), where no optimiser has an answer."""
    density = posterior.log_density(draws)
    best = int(density.argmax())
    return Mode(draws[best], float(density[best]), 0, 0)
