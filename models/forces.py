"""Forces that a model returns."""

from dataclasses import dataclass

from bayesterra.models.geometry import Floats

SINKAGE = NORMAL_FORCE = 0
DRAWBAR_PULL, RESISTANCE_MOMENT = 1, 2
"""Places along the last axis of what the batch interface answers; first the sinkage, or F_N at a sinkage."""


@dataclass(frozen=True)
class Forces:
    """Forces of the soil on the wheel; numbers, or arrays of the broadcast shape."""

    normal: Floats
    """F_N, N."""
    drawbar_pull: Floats
    """F_DP, N."""
    resistance_moment: Floats
    """M_DR, N m."""


@dataclass(frozen=True)
class Components:
    """Shares of F_N and F_DP in N, Ding et al. 2015, eq. (15): by stress and part, 1 front and 2 rear."""

    F_Nsigma1: Floats
    F_Nsigma2: Floats
    F_Ntau1: Floats
    F_Ntau2: Floats
    F_DPtau1: Floats
    F_DPtau2: Floats
    F_DPsigma1: Floats
    F_DPsigma2: Floats

    @property
    def F_Nsigma(self) -> Floats:
        """Normal stress's share of F_N."""
        return self.F_Nsigma1 + self.F_Nsigma2

    @property
    def F_Ntau(self) -> Floats:
        """Shear stress's share of F_N."""
        return self.F_Ntau1 + self.F_Ntau2

    @property
    def F_DPtau(self) -> Floats:
        """Thrust: shear stress's share of F_DP."""
        return self.F_DPtau1 + self.F_DPtau2

    @property
    def F_DPsigma(self) -> Floats:
        """Resistance: what normal stress takes from F_DP."""
        return self.F_DPsigma1 + self.F_DPsigma2

    @property
    def F_N(self) -> Floats:
        """Normal force, F_Nsigma + F_Ntau."""
        return self.F_Nsigma + self.F_Ntau

    @property
    def F_DP(self) -> Floats:
        """Drawbar pull, F_DPtau - F_DPsigma."""
        return self.F_DPtau - self.F_DPsigma
