"""The decoupled equations (29)-(41) against the closed-form models they come from."""

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd
import pytest

from bayesterra.least_squares.groupwise import decoupled_steps
from bayesterra.least_squares.settings import readings
from bayesterra.models import MODELS, Soil, WheelSoilModel
from bayesterra.models.decoupled import MARGIN, Contact
from bayesterra.study.study import Study


def paper_model(study: Study) -> WheelSoilModel:
    """The model of a study, which is one of the paper."""
    assert isinstance(study.model, WheelSoilModel)
    return study.model


@pytest.mark.parametrize(("method", "model"), [("IM2", "M2"), ("IM3", "M3")])
def test_equations_hold_on_their_own_model(
    method: str, model: str, make_paper_study: Callable[..., Study], printed: Mapping[str, Mapping[str, Soil]]
) -> None:
    """With the closed-form model's own forces put in, the decoupled equations return the same forces."""
    soil = printed[method]["Wh22"]
    study = make_paper_study(model, "Wh22", Soil(**{**vars(soil), "c3": -0.2, "c": 900.0}))
    steps = decoupled_steps(method, readings(study), paper_model(study))
    theta = Soil(**{**vars(soil), "c3": -0.2, "c": 900.0}).as_array()
    for step in steps:
        assert step.curve.values(theta) == pytest.approx(step.measured, rel=1e-9)


@pytest.mark.parametrize("method", ["IM2", "IM3"])
def test_jacobians_are_exact(
    method: str, make_paper_study: Callable[..., Study], printed: Mapping[str, Mapping[str, Soil]]
) -> None:
    """Complex-step derivatives agree with central differences for every equation and parameter."""
    soil = printed[method]["Wh31"]
    study = make_paper_study("M2", "Wh31", soil)
    theta = soil.as_array()
    for step in decoupled_steps(method, readings(study), paper_model(study)):
        exact = step.curve.jacobian(theta)
        for column, value in enumerate(theta):
            shift = np.zeros(9)
            shift[column] = 1e-5 * (abs(value) or 1.0)
            difference = step.curve.values(theta + shift) - step.curve.values(theta - shift)
            slope = difference / (2 * shift[column])
            assert exact[:, column] == pytest.approx(slope, rel=1e-6, abs=1e-7 * np.abs(step.measured).max())


def test_angle_is_clipped(make_paper_study: Callable[..., Study], printed: Mapping[str, Mapping[str, Soil]]) -> None:
    """Where c1 + c2 s exceeds 1 the equations are those of θm just below θ1, finite and flat in c1, c2."""
    soil = printed["IM2"]["Wh31"]
    study = make_paper_study("M2", "Wh31", soil)
    theta, inside = soil.as_array(), soil.as_array()
    theta[6:8], inside[6:8] = (1.0, 0.5), (1 - MARGIN, 0.0)
    for step in decoupled_steps("IM2", readings(study), paper_model(study)):
        assert step.curve.values(theta) == pytest.approx(step.curve.values(inside), rel=1e-12)
        assert not step.curve.jacobian(theta)[:, 6:8].any()


def test_contact_of_several_wheels(
    make_table: Callable[..., pd.DataFrame], printed: Mapping[str, Mapping[str, Soil]]
) -> None:
    """Rows of different wheels carry their own geometry, so that the equations hold for each."""
    from bayesterra.models import Wheel

    soil = printed["IM2"]["Wh11"]
    wheels = {"a": Wheel(0.135, 0.165, 0.015, 24, 0.75), "b": Wheel(0.15735, 0.11, 0.0)}
    frames = []
    for name, wheel in wheels.items():
        slip = np.array([0.1, 0.4])
        sinkage = MODELS["M2"]().sinkage(soil, wheel, slip, 60.0)
        forces = MODELS["M2"]().forces(soil, wheel, slip, sinkage)
        frames.append(
            pd.DataFrame(
                {
                    "wheel": name,
                    "slip": slip,
                    "load [N]": 60.0,
                    "sinkage [m]": sinkage,
                    "drawbar_pull [N]": forces.drawbar_pull,
                    "resistance_moment [N m]": forces.resistance_moment,
                }
            )
        )
    study = Study(
        pd.concat(frames, ignore_index=True),
        wheels,
        model="M2",
        slip_reference="shearing",
        noise={"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3},
        priors={"set": "paper-box"},
    )
    rows = readings(study)
    at = Contact.of(paper_model(study), rows.conditions, rows.sinkage, rows.sinkage, rows.sinkage)
    assert at.radius == pytest.approx([0.135, 0.135, 0.15735, 0.15735])
    for step in decoupled_steps("IM2", rows, paper_model(study)):
        assert step.curve.values(soil.as_array()) == pytest.approx(step.measured, rel=1e-9)
