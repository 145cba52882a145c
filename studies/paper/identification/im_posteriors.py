"""Posteriors beside the point estimates, the error of M2 and M3, and which model the readings prefer."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd
from im_fits import HIT, METHODS, noisy, study_of
from paper_data import SOILS, printed, soil_of
from paper_posteriors import Found, infer

import bayesterra as bt
from bayesterra.checking.loo import INDISTINCT
from bayesterra.models import Soil
from bayesterra.runtime.engines import completed, local_pool

MODELS = ("M1", "M2", "M3")
SIMULATED = "Wh32"
SEED = 1
"""Noise seed of the simulated readings whose posteriors are sampled; full noise."""


@dataclass(frozen=True)
class Case:
    """A posterior that is sampled.

    Attributes
    ----------
    data : ``HIT`` or a wheel of Table 1, whose readings are then simulated.
    noise : whether simulated readings carry noise; the posterior has it either way.
    model, drive : as in a study.
    hold : whether K_s is held.
    """

    data: str
    noise: bool
    model: str
    drive: str
    hold: bool

    @property
    def columns(self) -> dict[str, object]:
        """How the case is named in the tables."""
        kind = "digitised" if self.data == HIT else "simulated, noise" if self.noise else "simulated, no noise"
        return {
            "data": self.data, "kind": kind, "model": self.model, "drive": self.drive, "Ks_held": self.hold
        }  # fmt: skip

    @property
    def study(self) -> bt.Study:
        """The study behind it."""
        data = noisy(self.data, SEED, 1.0) if self.noise else None
        return study_of(self.data, data, hold=self.hold, model=self.model, drive=self.drive)


BESIDE = (
    *(
        Case(HIT, False, model, drive, hold)
        for model, drive, hold in product(MODELS, ("load", "sinkage"), (True, False))
    ),
    *(Case(SIMULATED, True, model, "load", hold) for model, hold in product(MODELS, (True, False))),
    Case(SIMULATED, True, "M1", "sinkage", True),
)
"""Posteriors that stand beside the point estimates."""
CLEAN = (
    *(Case(wheel, False, model, "load", True) for wheel, model in product(("Wh11", SIMULATED), MODELS)),
    *(Case(SIMULATED, False, model, "load", False) for model in MODELS[1:]),
)
"""Noise-free readings, on which M2 and M3 show their own error."""
COMPARED = tuple(case for case in BESIDE if case.drive == "load")
"""Posteriors whose evidence and leave-one-out compare the models."""
TABLES = ("posteriors", "standings", "spreads", "model-errors", "comparison")


def answer(case: Case) -> dict[str, pd.DataFrame]:
    """Sample a posterior and put down all that is asked of it, by table."""
    found = infer(case.study, loo=case in COMPARED)
    made = {"posteriors": found.summary()}
    if case in BESIDE:
        points = estimates(case)
        made["standings"] = pd.DataFrame([found.standing(name, at) for name, at in points.items()])
        made["spreads"] = spreads(found, points)
    if case in CLEAN:
        made["model-errors"] = model_errors(case, found)
    if case in COMPARED:
        made["comparison"] = compared(found)
    return {name: _labelled(case, table) for name, table in made.items()}


def answers(cases: Sequence[Case] = (*BESIDE, *CLEAN)) -> dict[str, pd.DataFrame]:
    """All tables, in the order of the cases whatever the number of processes."""
    with local_pool() as engine:
        found = dict(completed(answer, cases, engine))
    every = [found[case] for case in cases]
    made = {name: pd.concat([one[name] for one in every if name in one], ignore_index=True) for name in TABLES}
    return {**made, "comparison": less_first(made["comparison"])}


def _labelled(case: Case, table: pd.DataFrame) -> pd.DataFrame:
    for name, value in reversed(case.columns.items()):
        table.insert(0, name, value)
    return table


def estimates(case: Case) -> dict[str, Mapping[str, float]]:
    """Point estimates (SI) for the readings of a case, with the printed ones of the wheel."""
    fits = bt.fit(case.study, METHODS)
    wheel = "Wh32" if case.data == HIT else case.data
    points: dict[str, Mapping[str, float]] = {name: fit.values() for name, fit in fits.items()}
    printed_14 = soil_of(printed(14).loc[wheel].to_dict())
    return {**points, "Table 10": _values(SOILS[wheel]), "Table 14": _values(printed_14)}


def _values(soil: Soil) -> dict[str, float]:
    return {name: float(value) for name, value in vars(soil).items()}


def spreads(found: Found, points: Mapping[str, Mapping[str, float]]) -> pd.DataFrame:
    """Per parameter: range of IM1, IM2 and IM3 in posterior sds, and how many lie in the central 90 %."""
    low, high = np.quantile(found.draws, (0.05, 0.95), axis=0)
    values = np.array([[points[method][name] for name in found.names] for method in METHODS])
    return pd.DataFrame(
        {
            "parameter": found.names,
            "range_in_sd": np.ptp(values, axis=0) / found.draws.std(axis=0, ddof=1),
            "inside": ((values >= low) & (values <= high)).sum(axis=0),
        }
    )


def model_errors(case: Case, found: Found) -> pd.DataFrame:
    """Noise-free readings of M1: how far a model puts mode and mean from the truth, in its own sds."""
    truth = _values(SOILS[case.data])
    true = np.array([truth[name] for name in found.names])
    sd, mean = found.draws.std(axis=0, ddof=1), found.draws.mean(axis=0)
    shifts = {"mode": (found.mode - true) / sd, "mean": (mean - true) / sd}
    level = found.standing("truth", truth)["credible_level"]
    return pd.DataFrame({"parameter": found.names, **shifts, "truth_level": level, **_misfit(found)})


def _misfit(found: Found) -> dict[str, float]:
    """Largest misfit at the mode in standard deviations of the noise, by outcome."""
    likelihood = found.density.likelihood
    predicted = likelihood.predicted(found.density.outcomes(found.mode[None, :]))
    scales = likelihood.scales(predicted, np.empty((1, 0)))
    worst = np.nanmax(np.abs((predicted - likelihood.measured) / scales)[0], axis=0)
    return {f"misfit_{name}": float(value) for name, value in zip(likelihood.channels, worst, strict=True)}


def compared(found: Found) -> pd.DataFrame:
    """Evidence and leave-one-out of one posterior; ``by_row`` holds the elpd of every row."""
    if found.loo is None:
        raise ValueError("models are compared by leave-one-out")
    row = {
        "log_z": found.evidence.log_z, "log_z_error": found.evidence.error,
        "elpd": found.loo.elpd, "elpd_se": found.loo.se, "by_row": tuple(found.loo.by_row),
        "reliable": found.evidence.reliable, "converged": found.converged,
    }  # fmt: skip
    return pd.DataFrame([row])


def less_first(table: pd.DataFrame) -> pd.DataFrame:
    """Differences of evidence and elpd to M1 on the same readings, with their standard error over rows."""
    first = table[table["model"] == "M1"].set_index(["data", "Ks_held"])
    rows = []
    for row in table.to_dict("records"):
        one = first.loc[(row["data"], row["Ks_held"])]
        away = np.subtract(row.pop("by_row"), one["by_row"])
        se = np.sqrt(len(away)) * away.std(ddof=1)
        told = abs(away.sum()) >= max(INDISTINCT, 2 * se)
        rows.append(
            {
                **row, "log_z_less_M1": row["log_z"] - one["log_z"], "elpd_less_M1": away.sum(),
                "difference_se": se, "distinguishable": told,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)
