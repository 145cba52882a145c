"""M1: the stresses integrated along the arc."""

from dataclasses import dataclass
from typing import ClassVar

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
