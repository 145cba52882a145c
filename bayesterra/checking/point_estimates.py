"""Point estimates seen from the posterior: how dense it is where each of them stands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.posterior import INSIDE, REASONS, Posterior
from bayesterra.parameters import MODEL_PARAMETERS, PRIOR_PARAMETERS


@dataclass(frozen=True)
class PointEstimate:
    """Place of a point estimate in the posterior.

    Attributes
    ----------
    method : name of the estimate.
    values : soil parameters, SI and radians, by name.
    log_density : log posterior density there, −inf outside the support.
    credible_level : share of the draws with a higher density (1 outside the support). Near 0 the estimate is
        a typical good fit; above 0.99 practically no draw is as improbable.
    reason : why the density is zero there, "" where it is not.
    at_bound : free parameters that sit on the edge of their prior's range.
    filled : free soil parameters that the estimate does not give; they stand at the posterior median, so its
        density says little about the estimate.
    """

    method: str
    values: Mapping[str, float]
    log_density: float
    credible_level: float
    reason: str
    at_bound: tuple[str, ...]
    filled: tuple[str, ...] = ()

    @property
    def word(self) -> str:
        """The verdict in words."""
        if self.filled:
            return f"not judged: it gives no {', '.join(self.filled)}"
        if self.reason:
            return f"outside the prior: {self.reason}" if self.reason != REASONS[-1] else self.reason
        return f"{100 * self.credible_level:.1f} % of the draws are denser"


def locate(
    posterior: Posterior,
    draws: FloatArray,
    draw_densities: FloatArray,
    points: Mapping[str, Mapping[str, float]],
) -> dict[str, PointEstimate]:
    """Place point estimates in the posterior.

    Parameters
    ----------
    posterior : the density.
    draws : posterior draws (n, d).
    draw_densities : log density of each draw (n,).
    points : soil parameters of each estimate by method; a free parameter that an estimate does not give
        stands at its posterior median, as estimated noise always does; where K_s is given, but not k_c and
        k_φ, the latter makes up for it. Values of parameters that the study fixes are not used.
    """
    median = dict(zip(posterior.names, np.median(draws, axis=0), strict=True))
    return {
        method: _standing(posterior, method, values, median, draw_densities)
        for method, values in points.items()
    }


def _completed(
    posterior: Posterior, median: Mapping[str, float], values: Mapping[str, float]
) -> dict[str, float]:
    completed = {**median, **values}
    if "Ks" in values and "kphi" in posterior.names and "kphi" not in values:
        kc = {**posterior.prior.fixed, **completed}["kc"]
        completed["kphi"] = values["Ks"] - kc / posterior.prior.width
    return completed


def _standing(
    posterior: Posterior,
    method: str,
    values: Mapping[str, float],
    median: Mapping[str, float],
    draw_densities: FloatArray,
) -> PointEstimate:
    names, completed = posterior.names, _completed(posterior, median, values)
    x = np.array([[completed[name] for name in names]])
    reason = int(posterior.reasons(x)[0])
    density = float(posterior.log_density(x)[0])
    soil = {name: completed[name] for name in PRIOR_PARAMETERS if name in values}
    return PointEstimate(
        method,
        soil,
        density,
        credible_level=float(np.mean(draw_densities > density)),
        reason="" if reason == INSIDE else REASONS[reason],
        at_bound=tuple(n for n in soil if n in names and _at_edge(posterior, n, soil[n])),
        filled=tuple(n for n in MODEL_PARAMETERS if n in names and n not in values),
    )


def _at_edge(posterior: Posterior, name: str, value: float) -> bool:
    """True where a value lies within a thousandth of the prior's range (98 % range if infinite) of an end."""
    law = posterior.prior.laws[name]
    low, high = law.range
    width = high - low if np.isfinite(high - low) else float(np.ptp(law.quantile(np.array([0.01, 0.99]))))
    return bool(min(abs(value - low), abs(value - high)) < 1e-3 * width)


def of_point_estimate(standing: PointEstimate) -> dict[str, Any]:
    """Record of a point estimate's place in the posterior."""
    return {
        "credible_level": standing.credible_level,
        "log_density": standing.log_density if np.isfinite(standing.log_density) else None,
        "word": standing.word,
        "at_bound": list(standing.at_bound),
        "filled": list(standing.filled),
        "values": dict(standing.values),
    }
