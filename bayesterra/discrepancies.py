"""Named statistics that tell in which way readings differ from a model, one channel at a time.

All but the largest reading are taken of standardised residuals z = (reading − model) / σ in the order of
slip. Given the parameters, the law of z is that of the noise alone, so one set of unit residuals serves as
reference for every parameter set.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import FloatArray

Statistic = Callable[[FloatArray, FloatArray], FloatArray]


@dataclass(frozen=True)
class Discrepancy:
    """A statistic of standardised residuals.

    Attributes
    ----------
    name : key in tables and records.
    words : what it is.
    finding : what its alarm says of a channel.
    two_sided : whether small values are as strange as large ones.
    slips : different slips needed at least.
    value : residuals (..., m) and slips (m,), in ascending order, in; statistic (...) out.
    """

    name: str
    words: str
    finding: str
    two_sided: bool
    slips: int
    value: Statistic


def _contrast(degree: int) -> Statistic:
    """Share of the residuals along the polynomial in slip of this degree, orthogonal to all lower ones."""

    def value(z: FloatArray, slip: FloatArray) -> FloatArray:
        scaled = (slip - slip.mean()) / max(float(np.ptp(slip)), 1e-12)
        basis, _ = np.linalg.qr(np.vander(scaled, degree + 1, increasing=True))
        return np.asarray(z @ basis[:, degree] * np.sign(basis[:, degree] @ scaled**degree))

    return value


def _misfit(z: FloatArray, slip: FloatArray) -> FloatArray:
    return np.asarray((z**2).sum(axis=-1))


def _neighbours(z: FloatArray, slip: FloatArray) -> FloatArray:
    total = np.maximum((z**2).sum(axis=-1), 1e-300)
    return np.asarray((z[..., 1:] * z[..., :-1]).sum(axis=-1) / total)


LARGEST = Discrepancy("largest", "largest reading", "has a largest reading that the model does not give",
                      True, 1, lambda readings, slip: np.asarray(readings.max(axis=-1)))  # fmt: skip
"""The one statistic that is taken of the readings themselves."""

OF_RESIDUALS = (
    Discrepancy("misfit", "sum of squared residuals", "scatters more than the noise allows",
                False, 1, _misfit),
    Discrepancy("level", "mean residual", "is shifted as a whole", True, 1, _contrast(0)),
    Discrepancy("slope", "slope over slip", "rises or falls with slip otherwise than the model",
                True, 2, _contrast(1)),
    Discrepancy("curvature", "curvature over slip", "bends over slip otherwise than the model",
                True, 3, _contrast(2)),
    Discrepancy("neighbours", "correlation of neighbouring residuals", "has runs of residuals of one sign",
                False, 4, _neighbours),
)  # fmt: skip

DISCREPANCIES: dict[str, Discrepancy] = {one.name: one for one in (*OF_RESIDUALS, LARGEST)}


def applicable(slip: FloatArray) -> tuple[Discrepancy, ...]:
    """The statistics of residuals that readings at these slips (m,) can have."""
    distinct = len(np.unique(slip))
    return tuple(one for one in OF_RESIDUALS if distinct >= one.slips)


def exceedance(values: FloatArray, ordered: FloatArray) -> FloatArray:
    """Share of an ascending reference (k,) above each value (any shape); ties count half."""
    below = np.searchsorted(ordered, values, side="left") + np.searchsorted(ordered, values, side="right")
    return np.asarray(1.0 - 0.5 * below / len(ordered))
