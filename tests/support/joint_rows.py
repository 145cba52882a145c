"""A table whose rows hang together in every way, and its joint law written out reading by reading."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.likelihood.condition_errors import STEP
from bayesterra.likelihood.correlated import CorrelatedLikelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.models import Wheel
from bayesterra.study.study import Study

NONE = float("nan")
WHEELS = {"A": Wheel(0.135, 0.165, 0.015, 24, 0.75), "B": Wheel(0.135, 0.110, 0.015, 24, 0.75)}
TABLE = pd.DataFrame(
    {
        "wheel": ["A", "A", "A", "A", "B", "B", "A"],
        "run": ["1", "1", "1", "2", "3", "3", "2"],
        "slip": [0.1, 0.2, 0.35, 0.3, 0.2, 0.45, 0.4],
        "load [N]": 80.0,
        "sinkage [mm]": [6.6, 10.0, NONE, 14.2, 13.0, 26.0, 19.0],
        "drawbar_pull [N]": [13.6, 19.0, 21.0, NONE, 17.0, 19.0, 21.5],
        "resistance_moment [N m]": [3.7, 4.8, 5.5, 5.4, 4.5, 5.6, 5.7],
        "resistance_moment_sd [N m]": [NONE, 0.2, NONE, NONE, NONE, NONE, NONE],
        "use": [1, 1, 1, 1, 1, 1, 0],
    }
)
"""Two wheels, three sweeps, two readings missing, one with its own sd, one row not in the fit."""
NOISE = {"sinkage": 4e-4, "drawbar_pull": 0.5, "resistance_moment": 0.1}
HELD = {"Ks": 2.5e6, "n0": 0.87, "n1": 1.1, "c": 200.0, "phi": 0.5, "K": 0.0131, "c1": 0.39, "c2": -0.2}
ESTIMATED = {"estimate": {"dist": "halfnorm", "scale": 2.0}}
CURVES = {"sinkage": {"sd": 1e-3, "length": 0.3}, "drawbar_pull": {"sd": 2.0, "length": 0.2, "kernel": "matern52"}}
LOOSE = {**CURVES, "drawbar_pull": {"sd": ESTIMATED, "length": 0.2}}
RIPPLE = {"drawbar_pull": {"sd": 0.8, "memory": 2.0}, "resistance_moment": {"sd": 0.2, "memory": 3.0, "period": 4.0}}
CASES: dict[str, dict[str, Any]] = {
    "discrepancy": {"discrepancy": CURVES},
    "estimated discrepancy": {"discrepancy": LOOSE},
    "ripple": {"ripple": RIPPLE},
    "slip": {"slip": {"sd": 0.02}},
    "ripple and slip": {"ripple": RIPPLE, "slip": {"sd": 0.02}},
    "estimated noise": {
        "discrepancy": CURVES,
        "noise": {**NOISE, "drawbar_pull": {"estimate": {"dist": "uniform", "lower": 0.1, "upper": 1.0}}},
    },
    "fraction": {"discrepancy": CURVES, "noise": {**NOISE, "drawbar_pull": {"fraction": 0.03, "floor": "0.1 N"}}},
    "all": {"discrepancy": LOOSE, "ripple": RIPPLE, "slip": {"sd": {"estimate": {"dist": "halfnorm", "scale": 0.02}}}},
}


def joined(*free: str, data: pd.DataFrame = TABLE, **tables: Any) -> Study:
    """The study of these tests; ``free`` parameters have the paper's laws, the others are held."""
    held = {name: value for name, value in HELD.items() if name not in free}
    given: dict[str, Any] = {"noise": NOISE, "model": "M2", "priors": {"set": "paper-box", **held}, **tables}
    wheels = {name: WHEELS[name] for name in WHEELS if name in set(data["wheel"])}
    return Study(data, wheels, slip_reference="shearing", **given)


def sets(density: Posterior, n: int = 3) -> FloatArray:
    """Parameter sets (n, d) near the held values, and sizes all over their priors."""
    rng, x = np.random.default_rng(5), np.empty((n, len(density.names)))
    for i, name in enumerate(density.names):
        if name in HELD:
            x[:, i] = HELD[name] * (1 + 0.05 * rng.standard_normal(n))
        else:
            x[:, i] = density.prior.laws[name].quantile(rng.uniform(0.2, 0.8, n))
    return x


@dataclass(frozen=True)
class Written:
    """Joint law of all cells of the table, row after row and channel after channel, whether read or not.

    ``smooth`` is the covariance without the noise of single readings; ``known`` are the cells conditioned on.
    """

    mean: FloatArray
    covariance: FloatArray
    smooth: FloatArray
    known: IntArray
    readings: FloatArray

    def given(self, cells: IntArray, others: IntArray) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance of readings in some cells given those in others."""
        K, a, b = self.covariance, cells, others
        gain = K[np.ix_(a, b)] @ np.linalg.inv(K[np.ix_(b, b)])
        mean = self.mean[a] + gain @ (self.readings[b] - self.mean[b])
        return mean, K[np.ix_(a, a)] - gain @ K[np.ix_(b, a)]


def written(study: Study, density: Posterior, x: FloatArray) -> Written:
    """The law at one parameter set (d,), for all rows of the study's table."""
    rows, likelihood = study.observations, density.likelihood
    whole = CorrelatedLikelihood(replace(likelihood.forward, **_at(study)), rows, likelihood.noise, errors=study.errors)
    soil, values = density.prior.soil_values(x[None]), dict(zip(density.names, x, strict=True))
    ends = [
        replace(whole.forward, conditions=replace(whole.forward.conditions, slip=rows.slip + h))(soil).values[0]
        for h in (-STEP, 0.0, STEP)
    ]
    slopes, mean = (ends[2] - ends[0]) / (2 * STEP), ends[1]
    scale = whole.scales(whole.predicted(whole.forward(soil)), density.noise_values(x[None]))[0]
    channels, errors = whole.channels, study.errors
    sizes = {id(one): float(values.get(one.parameter or "", one.size.sd or 0.0)) for one in errors}
    m, k = mean.shape
    smooth = np.zeros((m * k, m * k))
    for i in range(m):
        for j in range(m):
            for a, name in enumerate(channels):
                for b in range(k):
                    cell = 0.0
                    curve, ripple = errors.discrepancy.get(name), errors.ripple.get(name)
                    if a == b and curve and rows.wheel[i] == rows.wheel[j]:
                        d = abs(rows.slip[i] - rows.slip[j]) / curve.length
                        r = 5**0.5 * d
                        matern = (1 + r + r**2 / 3) * np.exp(-r)
                        shape = matern if curve.kernel == "matern52" else np.exp(-0.5 * d**2)
                        cell += sizes[id(curve)] ** 2 * shape
                    if a == b and ripple and rows.labels["run"][i] == rows.labels["run"][j]:
                        d = abs(rows.rows[i] - rows.rows[j])
                        turn = np.cos(2 * np.pi * d / ripple.period) if np.isfinite(ripple.period) else 1.0
                        cell += sizes[id(ripple)] ** 2 * np.exp(-d / ripple.memory) * turn
                    if i == j and errors.slip:
                        cell += sizes[id(errors.slip)] ** 2 * slopes[i, a] * slopes[i, b]
                    smooth[i * k + a, j * k + b] = cell
    readings = whole.measured.ravel()
    known = np.flatnonzero((~np.isnan(whole.measured) & rows.use[:, None]).ravel())
    return Written(mean.ravel(), smooth + np.diag(scale.ravel() ** 2), smooth, known, readings)


def _at(study: Study) -> dict[str, Any]:
    from bayesterra.likelihood.posterior import likelihood_of

    forward = likelihood_of(study, study.observations).forward
    return {"conditions": forward.conditions, "given": forward.given}
