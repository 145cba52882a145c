"""Forces of the three models at a given sinkage."""

import numpy as np
import pytest

from bayesterra.models import M1, M2, M3, Soil, Wheel, WheelSoilModel

WHEEL = Wheel(radius=0.15735, width=0.165, lug_height=0.010, lug_count=30, shearing_radius_coefficient=0.65)
G1 = Soil(Ks=2.5e6, n0=0.76, n1=1.30, c=250.0, phi=0.5568, K=0.012, c1=0.5, c2=-0.3)
SLIPS = np.array([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6])


@pytest.mark.parametrize("model", [M1(), M2(), M3()], ids=lambda m: m.name)
def test_components_sum_to_forces(model: WheelSoilModel) -> None:
    """The components add up to F_N and F_DP."""
    forces = model.forces(G1, WHEEL, SLIPS, 0.01)
    parts = model.components(G1, WHEEL, SLIPS, 0.01)
    np.testing.assert_allclose(parts.F_N, forces.normal, rtol=1e-14)
    np.testing.assert_allclose(parts.F_DP, forces.drawbar_pull, rtol=0, atol=1e-13 * np.max(parts.F_DPtau))


@pytest.mark.parametrize("model", [M1(), M2(), M3()], ids=lambda m: m.name)
def test_sinkage_carries_the_load(model: WheelSoilModel) -> None:
    """Forces at the solved sinkage give the load back to 1e-10."""
    sinkage = model.sinkage(G1, WHEEL, SLIPS, 80.0)
    np.testing.assert_allclose(model.forces(G1, WHEEL, SLIPS, sinkage).normal, 80.0, rtol=1e-10)
