"""Posteriors beside the point estimates, the error that M2 and M3 add, and which model the readings prefer."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import product

import numpy as np
import pandas as pd
from im_fits import HIT, METHODS, noisy, study_of
from paper_data import SOILS, printed, soil_of
from paper_posteriors import Found, infer

import bayesterra as bt
from bayesterra.crossvalidation import difference
from bayesterra.models import Soil

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


BESIDE = tuple(
    Case(data, data != HIT, model, drive, hold)
    for data, model, drive, hold in product((HIT, SIMULATED), MODELS, ("load", "sinkage"), (True, False))
)
"""Posteriors that stand beside the point estimates."""
WHEELS = ("Wh11", "Wh22", SIMULATED)
"""Wheels on whose readings the models are compared: each radius, width and lug height at least once."""
CLEAN = (
    *(Case(wheel, False, model, "load", True) for wheel, model in product(WHEELS, MODELS)),
    *(Case(SIMULATED, False, model, "load", False) for model in MODELS),
)
"""Noise-free readings, on which M2 and M3 show their own error."""
COMPARED = (
    *(case for case in BESIDE if case.drive == "load"),
    *(
        Case(wheel, True, model, "load", True)
        for wheel, model in product(WHEELS, MODELS)
        if wheel != SIMULATED
    ),
)
"""Posteriors whose evidence and leave-one-out compare the models."""


@cache
def found(case: Case) -> Found:
    """The posterior of a case, sampled once."""
    return infer(case.study, loo=case in COMPARED)


def summaries(cases: Iterable[Case] = (*BESIDE, *CLEAN)) -> pd.DataFrame:
    """Mode, median, sd and central 90 % of every parameter, field units."""
    return pd.concat([_labelled(case, found(case).summary()) for case in cases], ignore_index=True)


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


def standings(cases: Iterable[Case] = BESIDE) -> pd.DataFrame:
    """Where IM1, IM2, IM3 and the printed values stand in each posterior."""
    rows: list[dict[str, object]] = []
    for case in cases:
        points = estimates(case)
        rows += [{**case.columns, **found(case).standing(name, at)} for name, at in points.items()]
    return pd.DataFrame(rows)


def spreads(cases: Iterable[Case] = BESIDE) -> pd.DataFrame:
    """Per parameter: range of IM1, IM2 and IM3 in posterior sds, and how many lie in the central 90 %."""
    return pd.DataFrame(list(_spreads(cases)))


def _spreads(cases: Iterable[Case]) -> Iterator[dict[str, object]]:
    for case in cases:
        points, posterior = estimates(case), found(case)
        low, high = np.quantile(posterior.draws, (0.05, 0.95), axis=0)
        sds = posterior.draws.std(axis=0, ddof=1)
        for i, name in enumerate(posterior.names):
            values = np.array([points[method][name] for method in METHODS])
            inside = int(((values >= low[i]) & (values <= high[i])).sum())
            yield {**case.columns, "parameter": name, "range_in_sd": np.ptp(values) / sds[i], "inside": inside}


def model_errors(cases: Iterable[Case] = CLEAN) -> pd.DataFrame:
    """Noise-free readings of M1: how far M2 and M3 put mode and mean from the truth, in their sds."""
    rows: list[dict[str, object]] = []
    for case in cases:
        posterior, truth = found(case), _values(SOILS[case.data])
        true = np.array([truth[name] for name in posterior.names])
        sd, mean = posterior.draws.std(axis=0, ddof=1), posterior.draws.mean(axis=0)
        misfit = _misfit(case, posterior)
        standing = posterior.standing("truth", truth)
        for i, name in enumerate(posterior.names):
            shifts = {"mode": (posterior.mode[i] - true[i]) / sd[i], "mean": (mean[i] - true[i]) / sd[i]}
            rows.append(
                {**case.columns, "parameter": name, **shifts, "truth_level": standing["credible_level"], **misfit}
            )
    return pd.DataFrame(rows)


def _misfit(case: Case, posterior: Found) -> dict[str, float]:
    """Largest misfit at the mode in standard deviations of the noise, by outcome."""
    likelihood = posterior.density.likelihood
    outcomes = posterior.density.outcomes(posterior.mode[None, :])
    predicted = likelihood.predicted(outcomes)
    scales = likelihood.scales(predicted, np.empty((1, 0)))
    worst = np.nanmax(np.abs((predicted - likelihood.measured) / scales)[0], axis=0)
    return {f"misfit_{name}": float(value) for name, value in zip(likelihood.channels, worst, strict=True)}


def comparison(cases: Iterable[Case] = COMPARED) -> pd.DataFrame:
    """Evidence and leave-one-out of M1, M2 and M3 on the same readings; differences are to M1."""
    rows: list[dict[str, object]] = []
    for case in cases:
        one = found(case)
        first = found(Case(case.data, case.noise, "M1", case.drive, case.hold))
        if one.loo is None or first.loo is None:
            raise ValueError(f"{case} was sampled without leave-one-out")
        away = difference(first.loo, one.loo)
        rows.append(
            {
                **case.columns,
                "log_z": one.evidence.log_z, "log_z_error": one.evidence.error,
                "log_z_less_M1": one.evidence.log_z - first.evidence.log_z,
                "elpd": one.loo.elpd, "elpd_se": one.loo.se,
                "elpd_less_M1": one.loo.elpd - first.loo.elpd, "difference_se": away.se,
                "distinguishable": away.distinguishable,
                "reliable": one.evidence.reliable, "converged": one.converged,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


