"""On noise-free data, each method returns the parameters that the data were made with."""

from collections.abc import Callable, Mapping

import numpy as np
import pytest

from bayesterra.identification import fit
from bayesterra.models import Soil
from bayesterra.study import Study

WHEELS = ("Wh11", "Wh12", "Wh21", "Wh22", "Wh31", "Wh32")
MODEL_OF = {"IM1": "M1", "IM2": "M2", "IM3": "M3"}
Printed = Mapping[str, Mapping[str, Soil]]


@pytest.mark.parametrize("wheel", WHEELS)
@pytest.mark.parametrize("method", ["IM1", "IM2", "IM3"])
def test_each_method_recovers_its_model(
    method: str, wheel: str, make_study: Callable[..., Study], printed: Printed
) -> None:
    """With K_s held and δ = 1e-6 every parameter comes back to 1e-3, and the fit errors vanish."""
    soil = printed[method][wheel]
    found = fit(make_study(MODEL_OF[method], wheel, soil), (method,), delta=1e-6)[method]
    assert found.converged
    assert found.soil.as_array() == pytest.approx(soil.as_array(), rel=1e-3)
    assert max(found.errors.values()) < 0.01
    assert not found.missing
    assert not found.clipped
    assert not found.at_bound
    assert found.held == ("Ks", "c3")
