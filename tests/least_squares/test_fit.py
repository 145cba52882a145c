"""What ``fit`` accepts, refuses and reports."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayesterra.errors import StudyError
from bayesterra.least_squares import fit as fits_of
from bayesterra.least_squares.fit import fit, fit_all
from bayesterra.least_squares.results import METHODS, Fit
from bayesterra.models import Soil
from bayesterra.study.study import Study, load_study

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]
TORQUE, PULL, SINKAGE = "resistance_moment [N m]", "drawbar_pull [N]", "sinkage [m]"


@pytest.fixture(scope="module")
def soil(printed: Mapping[str, Mapping[str, Soil]]) -> Soil:
    """Table 10, Wh32."""
    return printed["IM1"]["Wh32"]


@pytest.fixture(scope="module")
def study(make_paper_study: MakeStudy, soil: Soil) -> Study:
    """Noise-free M1 data with K_s held."""
    return make_paper_study("M1", "Wh32", soil)


@pytest.fixture
def study_without(make_paper_study: MakeStudy, make_table: MakeTable, soil: Soil) -> Callable[..., Study]:
    """The same without some columns."""

    def make(*columns: str) -> Study:
        return make_paper_study("M1", "Wh32", soil, data=make_table("M1", "Wh32", soil).drop(columns=list(columns)))

    return make


def test_all_methods_by_default(study: Study) -> None:
    """Without a choice the study's methods are run, in order."""
    assert tuple(fit(study)) == METHODS


def test_missing_torque_leaves_the_shearing_group(study_without: Callable[..., Study]) -> None:
    """Without torque, IM1 and IM3 name c, φ, K as missing at their start values and fit the rest."""
    fits = fit(study_without(TORQUE), ("IM1", "IM3"))
    for found in fits.values():
        assert {"c", "phi", "K"} <= set(found.missing)
        assert found.soil.phi == pytest.approx(np.radians(30.0))
        assert "phi" not in found.identified()
        assert np.isnan(found.errors["resistance_moment"])
        assert found.errors["normal_force"] < 1.0
    assert {"c1", "c2"} <= set(fits["IM3"].missing)
    assert "c1" not in fits["IM1"].missing


def test_im2_needs_the_torque_for_everything(study_without: Callable[..., Study]) -> None:
    """Every equation of IM2 holds M_DR: alone it is refused, beside other methods it is reported as empty."""
    study = study_without(TORQUE)
    with pytest.raises(StudyError, match="nothing can be fitted by IM2: P_III"):
        fit(study, ("IM2",))
    found = fit(study, ("IM1", "IM2"))["IM2"]
    assert not found.converged
    assert set(found.missing) == {"n0", "n1", "c", "phi", "K", "c1", "c2"}


def test_missing_drawbar_pull_leaves_the_contact_angles(study_without: Callable[..., Study]) -> None:
    """Without drawbar pull IM1 iterates the other two groups to rest with c1, c2 at their start."""
    found = fit(study_without(PULL), ("IM1",))["IM1"]
    assert found.missing == ("c1", "c2")
    assert found.converged
    assert found.passes >= 2
    assert (found.soil.c1, found.soil.c2) == (0.5, 0.0)


def test_missing_sinkage_leaves_nothing(study_without: Callable[..., Study]) -> None:
    """Without sinkage no IM can be done, joint still can."""
    study = study_without(SINKAGE)
    with pytest.raises(StudyError, match="nothing can be fitted by IM1"):
        fit(study, ("IM1",))
    fits, refused = fit_all(study)
    assert "joint" in fits
    assert len(refused) == 3


def test_too_few_readings_are_named(make_paper_study: MakeStudy, make_table: MakeTable, soil: Soil) -> None:
    """Two readings cannot give three parameters, and the message says which and how many."""
    study = make_paper_study("M1", "Wh32", soil, data=make_table("M1", "Wh32", soil, (0.1, 0.4)))
    with pytest.raises(StudyError, match="too few observations for IM1: F_N has 2 readings, 3 parameters"):
        fit(study, ("IM1",), hold={})
    with pytest.raises(StudyError, match="too few observations for joint: 6 readings, 8 parameters"):
        fit(study, ("joint",), hold={})


def test_a_missing_cell_costs_one_reading(make_paper_study: MakeStudy, make_table: MakeTable, soil: Soil) -> None:
    """IM1 recovers the soil though one torque and one drawbar pull are missing."""
    data = make_table("M1", "Wh32", soil)
    data.loc[1, TORQUE] = np.nan
    data.loc[3, PULL] = np.nan
    found = fit(make_paper_study("M1", "Wh32", soil, data=data), ("IM1",), delta=1e-6)["IM1"]
    assert found.soil.as_array() == pytest.approx(soil.as_array(), rel=2e-3)


def test_rows_without_a_positive_sinkage_are_left_out(
    make_paper_study: MakeStudy, make_table: MakeTable, soil: Soil
) -> None:
    """A sinkage of zero cannot be conditioned on: the row is left out of IM1 and a note says so."""
    data = make_table("M1", "Wh32", soil)
    data.loc[0, SINKAGE] = 0.0
    found = fit(make_paper_study("M1", "Wh32", soil, data=data), ("IM1",))["IM1"]
    assert any("1 row(s) without a sinkage" in note for note in found.notes)


def test_hold_start_and_bounds_override_the_study(study: Study, soil: Soil) -> None:
    """Keywords replace the study's tables; an empty hold frees K_s."""
    freed = fit(study, ("IM3",), hold={})["IM3"]
    assert freed.held == ("c3",)
    bounded = fit(study, ("IM3",), lower={"phi": 0.55}, start={"phi": 0.56})["IM3"]
    assert bounded.soil.phi >= 0.55
    angles = {"Ks": float(soil.Ks), "c1": 0.5, "c2": 0.0}
    held = fit(study, ("IM1", "joint"), hold=angles)
    for found in held.values():
        assert (found.soil.c1, found.soil.c2, found.soil.Ks) == (0.5, 0.0, soil.Ks)


def test_a_parameter_fixed_by_the_prior_is_held(make_paper_study: MakeStudy, soil: Soil) -> None:
    """What the priors fix is held in every method."""
    study = make_paper_study("M1", "Wh32", soil, priors={"set": "paper-box", "K": 0.012})
    for found in fit(study, ("IM2", "joint")).values():
        assert "K" in found.held
        assert found.soil.K == 0.012


@pytest.mark.parametrize(
    ("keywords", "message"),
    [
        ({"hold": {"psi": 1.0}}, r"least squares knows no parameter 'psi' \(one of Ks, "),
        ({"start": {"phi": float("nan")}}, r"'phi' must be finite \(got nan\)"),
        ({"start": {"phi": 1.5}}, r"of 'phi': 'start' must lie in \[0, 0.872665\] \(got 1.5\)"),
        ({"lower": {"K": 0.1}}, r"of 'K': 'lower' must be below 'upper' \(got 0.1 and 0.05\)"),
        ({"delta": 0.0}, r"'delta' must be above 0 \(got 0\)"),
        ({"methods": ("IM4",)}, r"'methods' must be among IM1, IM2, IM3, joint \(got 'IM4'\)"),
    ],
)
def test_bad_settings_are_named(study: Study, keywords: dict[str, object], message: str) -> None:
    """A wrong name, value, range or method is refused in one line."""
    with pytest.raises(StudyError, match=message):
        fit(study, **{"methods": ("IM1",), **keywords})  # type: ignore[arg-type]


def test_constant_exponent_holds_n1(make_paper_study: MakeStudy, soil: Soil) -> None:
    """With N = n0 the growth n1 is held at 0."""
    study = make_paper_study("M1", "Wh32", soil, model_options={"constant_exponent": True})
    assert "n1" in fit(study, ("IM2",))["IM2"].held


def test_bound_and_clipping_are_reported(make_paper_study: MakeStudy, make_table: MakeTable, soil: Soil) -> None:
    """A drawbar pull far above the model's drives c1, c2 to the edge, and the fit says so."""
    data = make_table("M1", "Wh32", soil)
    data[PULL] += 20.0 * data["slip"] - 30.0
    found = fit(make_paper_study("M1", "Wh32", soil, data=data), ("IM3",))["IM3"]
    assert found.clipped
    assert any("was clipped" in note for note in found.notes)


def test_passes_that_do_not_come_to_rest_are_given_up(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    """Out of passes, IM1 is not converged and says after how many; the path holds them all."""
    monkeypatch.setattr("bayesterra.least_squares.groupwise.MAX_PASSES", 3)
    found = fit(study, ("IM1",), delta=1e-6)["IM1"]
    assert not found.converged
    assert len(found.path) == found.passes == 3
    assert "the parameters did not come to rest in 3 passes" in found.notes


def test_passes_that_only_wander_are_given_up(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten passes without a new smallest change end IM1 long before the last pass allowed."""
    changes = iter([0.1, *[0.2] * 50])
    monkeypatch.setattr("bayesterra.least_squares.groupwise._change", lambda *_: next(changes))
    assert fit(study, ("IM1",))["IM1"].passes == 12


def test_parameters_all_held_are_judged(study: Study, soil: Soil) -> None:
    """With nothing free, the held values come back with their fit errors."""
    hold = {name: float(value) for name, value in vars(soil).items()}
    for found in fit(study, ("IM1", "joint"), hold=hold).values():
        assert found.converged
        assert found.soil == soil
        assert found.errors["drawbar_pull"] < 1e-6


HELD_KS = {  # n0, n1, c (Pa), φ (deg), K (mm), c1, c2 of the shipped rows with K_s held at 2500 kPa/m^N
    "IM1": (0.7923, 1.136, 1589, 16.85, 6.493, 0.182, 0.240),
    "IM2": (0.7280, 1.247, 408.5, 29.38, 12.42, 0.293, 0.033),
    "IM3": (0.7246, 1.232, 619.1, 25.06, 10.20, 0.296, -0.089),
    "joint": (0.7927, 1.114, 1063, 23.49, 9.496, 0.095, 0.494),
}


def test_hit_wh32_with_the_modulus_held() -> None:
    """On the shipped rows the methods part by 12 degrees in φ; IM2 comes nearest to the paper's 29.3."""
    study = load_study(Path(__file__).parents[2] / "studies" / "hit-wh32")
    for method, found in fit(study, hold={"Ks": 2.5e6}).items():
        n0, n1, c, phi, K, c1, c2 = HELD_KS[method]
        expected = (2.5e6, n0, n1, c, np.radians(phi), 1e-3 * K, c1, c2, 0.0)
        assert found.converged
        assert found.soil.as_array() == pytest.approx(expected, rel=2e-3, abs=1e-3)


def test_fits_that_joint_starts_from_are_made_once(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    """It ends where it ends when it makes them itself, to the last bit."""
    alone, made, fit_groups = fit(study, ("joint",))["joint"], list[str](), fits_of._fit_groups

    def counted(method: str, *rest: Any) -> Fit:
        made.append(method)
        return fit_groups(method, *rest)

    monkeypatch.setattr(fits_of, "_fit_groups", counted)
    fits, refused = fit_all(study)
    assert refused == ()
    assert made == ["IM1", "IM2", "IM3"]
    assert fits["joint"].values() == alone.values()
