"""What normal and shear stress each contribute to the forces, and how they lie on the contact arc."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.models import Wheel, WheelSoilModel
from bayesterra.models.geometry import entrance_angle, leaving_angle, maximum_stress_angle
from sensitivity.groups import Group, Setting, soil_array
from sensitivity.responses import broadcast_soil, respond


@dataclass(frozen=True)
class Shares:
    """Components of normal force and drawbar pull, Ding et al. 2015, eq. (15), Table 4 and Fig. 5.

    Attributes
    ----------
    names : of the soils (n,).
    setting : wheel, load and slips (m,).
    F_Nsigma, F_Ntau : N (n, m), F_N = F_Nsigma + F_Ntau, which is the load.
    F_DPtau, F_DPsigma : thrust and resistance, N (n, m), F_DP = F_DPtau − F_DPsigma.
    """

    names: tuple[str, ...]
    setting: Setting
    F_Nsigma: FloatArray
    F_Ntau: FloatArray
    F_DPtau: FloatArray
    F_DPsigma: FloatArray

    @property
    def shear_share(self) -> FloatArray:
        """F_Nτ/F_N (n, m): what the decoupling of P_I from the shear stress leaves out."""
        return self.F_Ntau / (self.F_Nsigma + self.F_Ntau)

    @property
    def table(self) -> pd.DataFrame:
        """One row per soil and slip; forces in N, the share in percent."""
        count = len(self.setting.slips)
        forces = ("F_Nsigma", "F_Ntau", "F_DPtau", "F_DPsigma")
        return pd.DataFrame(
            {
                "soil": np.repeat(self.names, count),
                "slip": np.tile(self.setting.slips, len(self.names)),
                **{f"{name} [N]": getattr(self, name).ravel() for name in forces},
                "F_Ntau/F_N [%]": 100.0 * self.shear_share.ravel(),
            }
        )


def force_shares(
    model: WheelSoilModel, soils: FloatArray, setting: Setting, names: Sequence[str] | None = None
) -> Shares:
    """Components of the forces of ``soils`` (n, 9) against slip under the load; F_Nτ of M3 is zero."""
    answer = respond(model, soils, setting, names)
    parts = model.components(broadcast_soil(soils, 1), setting.wheel, setting.slips, answer.sinkage)
    forces = (parts.F_Nsigma, parts.F_Ntau, parts.F_DPtau, parts.F_DPsigma)
    return Shares(answer.names, setting, *(np.asarray(force) for force in forces))


def group_shares(model: WheelSoilModel, groups: Sequence[Group], setting: Setting) -> Shares:
    """The components of groups of the paper; see :func:`force_shares`."""
    return force_shares(model, soil_array(groups), setting, [group.name for group in groups])


@dataclass(frozen=True)
class Stresses:
    """Stresses on the arc from θ2 to θ1, Ding et al. 2015, eqs. (4) and (9), or the lines (20), (21).

    Attributes
    ----------
    slips : (m,).
    angle : from the vertical, rad (n, m, p).
    normal, shear : σ and τ, Pa (n, m, p).
    maximum : θm, rad (n, m); one of the angles of each arc.
    """

    slips: FloatArray
    angle: FloatArray
    normal: FloatArray
    shear: FloatArray
    maximum: FloatArray

    @property
    def table(self) -> pd.DataFrame:
        """One row per soil, slip and angle; degrees and kPa."""
        n, m, p = self.angle.shape
        return pd.DataFrame(
            {
                "soil": np.repeat(np.arange(n) + 1, m * p),
                "slip": np.tile(np.repeat(self.slips, p), n),
                "angle [deg]": np.degrees(self.angle.ravel()),
                "normal_stress [kPa]": self.normal.ravel() / 1e3,
                "shear_stress [kPa]": self.shear.ravel() / 1e3,
            }
        )


def stress_distributions(
    model: WheelSoilModel, soils: FloatArray, wheel: Wheel, slips: FloatArray, sinkage: FloatArray, *, points: int = 101
) -> Stresses:
    """Stresses of ``soils`` (n, 9) at ``slips`` (m,) and ``sinkage`` (n, m) or any shape that broadcasts.

    Give the sinkage of :func:`sensitivity.responses.respond` for a given load (Fig. 8), or one
    number for all (Fig. 11). ``points`` must be odd and at least 3: half on either side of θm.
    """
    if points < 3 or points % 2 == 0:
        raise ValueError(f"'points' must be odd and at least 3 (got {points})")
    soil, depth = broadcast_soil(soils, 2), np.broadcast_to(sinkage, (len(soils), len(slips)))[:, :, None]
    entrance = np.asarray(entrance_angle(depth, wheel.radius))
    leaving = np.asarray(leaving_angle(entrance, soil.c3))
    maximum = np.asarray(maximum_stress_angle(entrance, soil.c1, soil.c2, slips[:, None]))
    share = np.linspace(0.0, 1.0, points // 2 + 1)
    rear, front = leaving + share * (maximum - leaving), maximum + share[1:] * (entrance - maximum)
    angle = np.concatenate([rear, front], axis=2)
    normal, shear = model.stresses(soil, wheel, slips[:, None], depth, angle)
    return Stresses(slips, angle, np.asarray(normal), np.asarray(shear), maximum[:, :, 0])
