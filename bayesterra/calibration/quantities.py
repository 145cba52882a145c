"""What is ranked: functions of parameters and readings that are defined for every soil of the cut prior."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.derived import bearing_pressure, shear_strength
from bayesterra.forward import soil_at
from bayesterra.posteriors import Posterior

LOG_LIKELIHOOD, LOG_PRIOR = "log_likelihood", "log_prior"
AT_SLIP = "_at_largest_slip"
"""Ending of quantities that the model says of the row with the largest slip."""


def predictive_names(drive: str) -> tuple[str, str]:
    """The two predictive quantities of a drive.

    With a latent load (``both``) no modelled force is defined for every soil, so they are those of the soil.
    """
    if drive == "both":
        return "bearing_pressure", "shear_strength"
    first = "sinkage" if drive == "load" else "normal_force"
    return f"{first}{AT_SLIP}", f"drawbar_pull{AT_SLIP}"


def quantity_names(names: tuple[str, ...], drive: str) -> tuple[str, ...]:
    """All test quantities: free parameters, log likelihood, log prior, two predictive ones."""
    return (*names, LOG_LIKELIHOOD, LOG_PRIOR, *predictive_names(drive))


def quantities(posterior: Posterior, x: FloatArray) -> dict[str, FloatArray]:
    """Every test quantity (n,) of parameter sets (n, d) inside the support, for the posterior's readings."""
    prior, likelihood = posterior.log_prior_and_likelihood(x)
    values = {name: x[:, i] for i, name in enumerate(posterior.names)}
    return {**values, LOG_LIKELIHOOD: likelihood, LOG_PRIOR: prior, **_predicted(posterior, x)}


def _predicted(posterior: Posterior, x: FloatArray) -> dict[str, FloatArray]:
    forward, soil = posterior.likelihood.forward, posterior.prior.soil_values(x)
    names = predictive_names(forward.drive)
    if forward.drive == "both":
        plain = soil_at(soil, float(forward.conditions.width[0]))
        derived: tuple[Callable[[FloatArray], FloatArray], ...] = (bearing_pressure, shear_strength)
        return {name: function(plain) for name, function in zip(names, derived, strict=True)}
    values = forward(soil).values[:, int(np.argmax(forward.conditions.slip))]
    return {name: values[:, forward.outcomes.index(name.removesuffix(AT_SLIP))] for name in names}
