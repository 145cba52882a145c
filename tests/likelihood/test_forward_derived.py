"""Derived quantities: efficiencies of soils of a prior, and widths of wheels."""

import numpy as np
import pytest

from bayesterra.likelihood.forward import derive_for, model_columns
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.models import M1, Soil, Wheel
from bayesterra.models.traction import SLIP_GRID, traction
from bayesterra.parameters import DERIVED, soil_array
from bayesterra.study.result import Result

WHEEL = Wheel(0.15735, 0.165, 0.010, 30, 0.65)
SOIL = Soil(Ks=2.5e6, n0=0.76, n1=1.30, c=250.0, phi=0.5568, K=0.012, c1=0.5, c2=-0.3)


def test_no_soil_gives_power_back(wide: Result) -> None:
    """Slip alone loses the share s of the power, so η stays below 1 − s for every soil of the prior."""
    target = posterior(wide.study)
    soil = target.prior.soil_values(draw_cut_prior(target, 500, np.random.default_rng(1)).x)
    efficiency = traction(M1(), WHEEL, 80.0, model_columns(soil, M1()))[1]
    assert np.nanmax(efficiency + SLIP_GRID) < 1.0


def test_bearing_pressure_knows_the_width() -> None:
    """With k_c and k_φ in place of K_s, the narrower wheel meets the stiffer soil."""
    extended = soil_array({**vars(SOIL), "Ks": np.nan, "kc": 15.6e3, "kphi": 1.2e6})
    for width in (0.165, 0.05):
        wheel = Wheel(0.15735, width, 0.010, 30, 0.65)
        found = derive_for(M1(), wheel, 80.0, extended)["bearing_pressure"][0]
        assert found == pytest.approx((15.6e3 / width + 1.2e6) * 0.01**0.76)


def test_summary_holds_every_derived_quantity(wide: Result) -> None:
    """Posterior, errors and prior of all derived quantities stand in the summary."""
    rows = wide.summary.set_index("parameter").loc[list(DERIVED)]
    assert (rows["mode_at"] == "inside").all()
    others = ("unit", "mode_at", "_half", "_double")  # words, and what is told of parameters only
    told = [name for name in rows.columns if not name.endswith(others)]
    assert np.isfinite(rows[told].to_numpy(dtype=float)).all()
    assert (rows["prior_sd"] > rows["sd"]).all()
