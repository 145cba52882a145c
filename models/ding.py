"""M1, M2 and M3 of Ding et al. (2015): stresses integrated along the arc, and closed forms from linear ones."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from bayesterra.models.base import WheelSoilModel
from bayesterra.models.checks import FloatArray
from bayesterra.models.contact import Contact


@dataclass(frozen=True, kw_only=True)
class M1(WheelSoilModel):
    """The integral model, Ding et al. 2015, eqs. (4), (9), (14), (15), to 1e-9 of adaptive quadrature."""

    equations: ClassVar[str] = "stresses (4) and (9) integrated along the arc, (14) and (15)"
    _kind: ClassVar[tuple[int, ...]] = (0,)

    def _stresses(self, contact: Contact, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        normal = contact.normal_stress(angle)
        return normal, contact.shear_stress(angle, normal)


@dataclass(frozen=True, kw_only=True)
class M2(WheelSoilModel):
    """Linear sigma and tau: CM1, Ding et al. 2015, eqs. (18)-(24)."""

    equations: ClassVar[str] = "closed form with linear stresses, (18) to (24)"
    _kind: ClassVar[tuple[int, ...]] = (0, 0)

    def _stresses(self, contact: Contact, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        normal, shear = contact.peak_stresses()
        shape = contact.triangle(angle)
        return normal * shape, shear * shape


@dataclass(frozen=True, kw_only=True)
class M3(WheelSoilModel):
    """Linear sigma cos(theta) and tau cos(theta) in F_N and F_DP, no F_Ntau: CM2, Ding et al. 2015, (25), (26).

    The paper keeps M2's linear stresses in the other integrals; `stresses` returns those of the cosine terms.
    """

    equations: ClassVar[str] = "closed form with linear stress cosines, (25) and (26)"
    _kind: ClassVar[tuple[int, ...]] = (1, 1)

    def _stresses(self, contact: Contact, angle: FloatArray) -> tuple[FloatArray, FloatArray]:
        normal, shear = contact.peak_stresses()
        shape = contact.triangle(angle) * np.cos(contact.maximum) / np.cos(angle)
        return normal * shape, shear * shape
