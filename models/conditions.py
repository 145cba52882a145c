"""The conditions of measured rows as flat arrays, and the status of one evaluation."""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Self

import numpy as np
from numpy.typing import ArrayLike

from bayesterra.models.checks import FloatArray, as_floats, require
from bayesterra.models.wheel import Wheel


class Status(IntEnum):
    """Reason why a parameter set cannot be evaluated in a row."""

    OK = 0
    EXPONENT = 1
    """The sinkage exponent N is not positive."""
    CONTACT_ANGLE = 2
    """theta_m does not lie inside (theta_2, theta_1), or theta_2 is below -theta_1."""
    LOAD = 3
    """No sinkage below the wheel's radius carries the load."""
    SINKAGE = 4
    """The sinkage does not lie inside (0, r)."""
    NORMAL_FORCE = 5
    """With c_M < 0, eq. (42) has no normal force at this sinkage."""
    NO_ANSWER = 6
    """A model of one's own has no finite forces."""


@dataclass(frozen=True)
class Conditions:
    """Slip and wheel of m rows: five arrays (m,), slip on the shearing radius, lengths in m."""

    slip: FloatArray
    radius: FloatArray
    width: FloatArray
    lug_height: FloatArray
    shearing_radius: FloatArray

    @classmethod
    def of(cls, wheels: Wheel | Sequence[Wheel], slip: ArrayLike, phi: float | None = None) -> Self:
        """Conditions of one wheel, or of one wheel per row, at `slip` (m,).

        `phi` serves wheels whose shearing-radius coefficient comes from equation (2). Raises ValueError for
        slips outside [0, 1), and where `phi` is needed and missing.
        """
        slips = np.atleast_1d(as_floats("slip", np.asarray(slip, dtype=np.float64)))
        require((slips >= 0) & (slips < 1), "slip", "must lie in [0, 1)", slips)
        rows = [wheels] * slips.size if isinstance(wheels, Wheel) else list(wheels)
        require(len(rows) == slips.size, "wheels", f"must be one wheel or one per row ({slips.size})", len(rows))
        return cls(
            slips,
            np.array([float(wheel.radius) for wheel in rows]),
            np.array([float(wheel.width) for wheel in rows]),
            np.array([float(wheel.lug_height) for wheel in rows]),
            np.array([_shearing_radius(wheel, phi) for wheel in rows]),
        )


def _shearing_radius(wheel: Wheel, phi: float | None) -> float:
    needs_phi = wheel.lug_height > 0 and wheel.shearing_radius_coefficient is None
    if needs_phi and phi is None:
        raise ValueError("'phi' must be given for a wheel without shearing_radius_coefficient (got None)")
    return float(wheel.shearing_radius(0.0 if phi is None else phi))
