"""On noise-free data, each method returns the parameters that the data were made with."""

from collections.abc import Callable, Mapping

import numpy as np
import pytest

from bayesterra.arrays import FloatArray
from bayesterra.least_squares.fit import fit
from bayesterra.least_squares.solver import Box, Curve, Minimum, minimise
from bayesterra.models import Soil
from bayesterra.study.study import Study

WHEELS = ("Wh11", "Wh12", "Wh21", "Wh22", "Wh31", "Wh32")
MODEL_OF = {"IM1": "M1", "IM2": "M2", "IM3": "M3"}
Printed = Mapping[str, Mapping[str, Soil]]


@pytest.mark.parametrize("wheel", WHEELS)
@pytest.mark.parametrize("method", ["IM1", "IM2", "IM3"])
def test_each_method_recovers_its_model(
    method: str, wheel: str, make_paper_study: Callable[..., Study], printed: Printed
) -> None:
    """With K_s held and δ = 1e-6 every parameter comes back to 1e-3, and the fit errors vanish."""
    soil = printed[method][wheel]
    found = fit(make_paper_study(MODEL_OF[method], wheel, soil), (method,), delta=1e-6)[method]
    assert found.converged
    assert found.soil.as_array() == pytest.approx(soil.as_array(), rel=1e-3)
    assert max(found.errors.values()) < 0.01
    assert not found.missing
    assert not found.clipped
    assert not found.at_bound
    assert found.held == ("Ks", "c3")


PASSES = {"Wh11": (12, 40), "Wh12": (11, 32), "Wh21": (10, 29), "Wh22": (5, 22), "Wh31": (14, 56), "Wh32": (14, 48)}
"""Passes of IM1 with δ = 0.002 and with 1e-6."""

COHESION_LEFT = {"Wh11": 46.8, "Wh12": 191.9, "Wh21": 175.1, "Wh22": 222.0, "Wh31": 30.4, "Wh32": 216.3}
"""Cohesion (Pa) that IM1 with δ = 0.002 returns for 103, 218, 212, 236, 97 and 268 Pa."""


@pytest.mark.parametrize("wheel", WHEELS)
def test_the_papers_tolerance_stops_early(wheel: str, make_paper_study: Callable[..., Study], printed: Printed) -> None:
    """δ = 0.002 stops far from the cohesion behind the data although every fit error is below 0.4 %."""
    study = make_paper_study("M1", wheel, printed["IM1"][wheel])
    early, late = (fit(study, ("IM1",), delta=delta)["IM1"] for delta in (0.002, 1e-6))
    assert early.converged
    assert max(early.errors.values()) < 0.4
    assert early.soil.c == pytest.approx(COHESION_LEFT[wheel], abs=0.2)
    assert (early.passes, late.passes) == pytest.approx(PASSES[wheel], abs=1)
    assert late.path[: early.passes] == early.path


@pytest.mark.parametrize("drive", ["load", "sinkage"])
@pytest.mark.parametrize("model", ["M1", "M2", "M3"])
def test_joint_recovers_every_model_in_both_drives(
    model: str, drive: str, make_paper_study: Callable[..., Study], printed: Printed
) -> None:
    """With K_s held, all channels together give every parameter back to 1e-6, wherever the search starts."""
    soil = printed["IM3" if model == "M3" else "IM1"]["Wh31"]
    found = fit(make_paper_study(model, "Wh31", soil, drive=drive), ("joint",))["joint"]
    assert found.converged
    assert found.soil.as_array() == pytest.approx(soil.as_array(), rel=1e-6)


def test_inner_fits_restart_in_every_pass(
    make_paper_study: Callable[..., Study], printed: Printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every inner fit of every pass begins at Table 17's values, not where the last pass ended."""
    starts = []

    def watched(residual: Curve, start: FloatArray, box: Box) -> Minimum:
        starts.append(start[box.columns])
        return minimise(residual, start, box)

    monkeypatch.setattr("bayesterra.least_squares.groupwise.minimise", watched)
    found = fit(make_paper_study("M1", "Wh22", printed["IM1"]["Wh22"]), ("IM1",))["IM1"]
    assert len(starts) == 3 * found.passes
    for bearing, shearing, angles in zip(starts[0::3], starts[1::3], starts[2::3], strict=True):
        assert bearing.tolist() == [0.5, 0.5]
        assert shearing == pytest.approx([200.0, np.radians(30.0), 0.01])
        assert angles.tolist() == [0.5, 0.0]


def test_inner_fits_end_at_minima(
    make_paper_study: Callable[..., Study], printed: Printed, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With K_s free, on a long valley floor, no inner fit is cut short: where that ends is rounding's choice."""
    minima = []

    def watched(residual: Curve, start: FloatArray, box: Box) -> Minimum:
        minima.append(minimise(residual, start, box))
        return minima[-1]

    monkeypatch.setattr("bayesterra.least_squares.groupwise.minimise", watched)
    study = make_paper_study("M1", "Wh22", printed["IM1"]["Wh22"], least_squares={"hold": {}})
    found = fit(study, ("IM1",), delta=0.5)["IM1"]
    assert len(minima) == 3 * found.passes
    assert all(minimum.converged for minimum in minima)
    assert max(minimum.evaluations for minimum in minima) > 300
