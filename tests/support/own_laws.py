"""Models of a stranger's own, as studies load them by name."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

from bayesterra.arrays import FloatArray
from bayesterra.models import MODELS, SOIL_FIELDS, Conditions, ModelParameter, batch


@dataclass(frozen=True)
class PaperLaw:
    """Forces of a model of the paper, from its compiled code, as if they were a stranger's."""

    model: str = "M2"
    parameters = SOIL_FIELDS

    def forces(self, soil: Any, wheel: Conditions, slip: FloatArray, sinkage: FloatArray) -> list[FloatArray]:
        """F_N, F_DP and M_DR of all pairs."""
        of_wheel = (slip, wheel.radius, wheel.width, wheel.lug_height, wheel.shearing_radius)
        columns = np.broadcast_arrays(*(getattr(soil, name) for name in SOIL_FIELDS), *of_wheel, sinkage)
        sets = np.stack([column.ravel() for column in columns[:9]], axis=-1)
        rows = Conditions(*(column.ravel() for column in columns[9:14]))
        theta, inputs, (code, _, _) = MODELS[self.model]().kernel_inputs(sets, rows)
        values, _ = batch.forces(theta, inputs, columns[14].ravel()[:, None], (code, 1, True))
        return [values[:, 0, i].reshape(columns[0].shape) for i in range(3)]


class Plate:
    """A wheel taken as a plate as long as its contact: pressure k z, shear of Janosi."""

    parameters = ("c", "phi", "K", ModelParameter("stiffness", "kPa/mm", 0, 50, "k_z", "stiffness of the ground"))

    def forces(self, soil: Any, wheel: Any, slip: FloatArray, sinkage: FloatArray) -> tuple[FloatArray, ...]:
        """F_N, F_DP and M_DR."""
        length = np.sqrt(2 * wheel.radius * sinkage)
        area = wheel.width * length
        normal = soil.stiffness * sinkage * area * 2 / 3
        shear = (soil.c * area + normal * np.tan(soil.phi)) * (1 - np.exp(-slip * length / soil.K / 2))
        resistance = wheel.width * soil.stiffness * sinkage**2 / 2
        return normal, shear - resistance, shear * wheel.shearing_radius


class Loud(Plate):
    """The same with what a stranger may get wrong."""

    parameters = ("c", "phi", "K", "stifness")  # type: ignore[assignment]


class TwoForces(Plate):
    """A law that forgets the moment."""

    def forces(self, soil: Any, wheel: Any, slip: FloatArray, sinkage: FloatArray) -> tuple[FloatArray, ...]:
        """F_N and F_DP."""
        return super().forces(soil, wheel, slip, sinkage)[:2]


class Pressing(Plate):
    """A law with a name that the package has for something else."""

    parameters = (*Plate.parameters[:3], ModelParameter("sinkage", "mm"))


@dataclass(frozen=True)
class Clipped:
    """Residuals with the law of a logistic one, whose density a negative ``reach`` spoils."""

    reach: float

    def logpdf(self, z: Any) -> Any:
        """Log density."""
        return stats.logistic.logpdf(z) + (0.3 * np.abs(z) if self.reach < 0 else 0.0)

    def logcdf(self, z: Any) -> Any:
        """Log of the probability below."""
        return stats.logistic.logcdf(z)

    def ppf(self, q: Any) -> Any:
        """Quantiles."""
        return stats.logistic.ppf(q)
