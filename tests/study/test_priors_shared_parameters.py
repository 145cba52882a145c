"""Ties, Bekker's moduli and the sinkage offset: other ways of saying what the nine soil parameters are."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayesterra.analysis.simulation import simulate, true_values
from bayesterra.checking.predictive import predict_rows
from bayesterra.errors import StudyError
from bayesterra.least_squares.fit import fit
from bayesterra.likelihood.forward import soil_at
from bayesterra.likelihood.page import study_overview
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.models import Wheel
from bayesterra.parameters import PRIOR_PARAMETERS, SOIL_PARAMETERS
from bayesterra.stats.laws import Law
from bayesterra.study.canonical import write_study
from bayesterra.study.priors import Prior, Tie
from bayesterra.study.study import Study, load_study

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]

MODULI = {"kc": Law("uniform", lower=0.0, upper=50e3), "kphi": Law("uniform", lower=0.2e6, upper=5e6)}
OFFSET = {"sinkage_offset": Law("norm", {"scale": 1e-3})}
DRIVES = ("load", "sinkage", "both")


@pytest.mark.parametrize("drive", DRIVES)
def test_a_tied_parameter_has_the_value_of_the_other(drive: str, make_study: MakeStudy) -> None:
    """With c2 tied to c1, the density is that of both free at equal values, less the prior of c2."""
    tied = posterior(make_study(free=("phi", "c1", "c2"), priors={"c2": "c1"}, drive=drive))
    free = posterior(make_study(free=("phi", "c1", "c2"), drive=drive))
    assert tied.names == ("phi", "c1")
    x = draw_cut_prior(tied, 50, np.random.default_rng(1)).x
    both = np.column_stack([x, x[:, 1]])
    np.testing.assert_array_equal(tied.prior.soil_values(x), free.prior.soil_values(both))
    np.testing.assert_allclose(tied.log_density(x), free.log_density(both) + np.log(2.0), rtol=1e-12)


def test_ties_lead_through_others_and_to_fixed_values() -> None:
    """A tie to a tie ends at the root; one to a fixed parameter counts as fixed."""
    laws = dict.fromkeys(SOIL_PARAMETERS, Law("uniform", lower=0.1, upper=0.4))
    prior = Prior({**laws, "c3": Tie("c2"), "c2": Tie("c1"), "n1": 0.3, "n0": Tie("n1")})
    assert prior.root("c3") == "c1"
    assert prior.fixed == {"n0": 0.3, "n1": 0.3}
    x = prior.sample(5, np.random.default_rng(1))
    soil = dict(zip(PRIOR_PARAMETERS, prior.soil_values(x).T, strict=True))
    np.testing.assert_array_equal(soil["c3"], soil["c1"])
    np.testing.assert_array_equal(soil["n0"], 0.3)


@pytest.mark.parametrize(
    ("priors", "message"),
    [
        ({"c1": "c2", "c2": "c1"}, r"\[priors\] 'c1' must not be tied to itself \(c1 = c2 = c1\)"),
        ({"c1": "c1"}, r"'c1' must not be tied to itself \(c1 = c1\)"),
        ({"phi": "c"}, "'phi' must not be tied: it is the only angle"),
        ({"c1": "phi"}, r"'c1' must be tied to a parameter of its own dimension \(got 'pure number' and 'rad'\)"),
        ({"c1": "cc"}, r"'c1' is tied to an unknown parameter 'cc'"),
        ({"c1": "sinkage_offset"}, "'sinkage_offset', which must have a prior of its own"),
        ({"kc": 1e3}, "'kc' needs 'kphi' beside it"),
        ({"kc": 1e3, "kphi": 1e6, "Ks": 1e6}, "'kc' stands in place of 'Ks': give either"),
        ({"kc": "15 kPa"}, r"'kc': the unit 'kPa' is not a unit of pressure times length \(e.g. \"15.6 kPa m\"\)"),
        ({"sinkage_offset": "1 N"}, "the unit 'N' is not a unit of length"),
    ],
)
def test_impossible_priors_say_why(
    priors: Mapping[str, object], message: str, make_table: MakeTable, wheel: Wheel
) -> None:
    """Circles, dimensions, unknown and doubled names are refused in one line."""
    noise = {"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3}
    with pytest.raises(StudyError, match=message) as caught:
        Study(make_table(), {"A": wheel}, slip_reference="shearing", noise=noise, priors=priors)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("drive", DRIVES)
def test_moduli_are_the_modulus_of_each_wheel(
    drive: str, make_table: MakeTable, wheel: Wheel, truth: Mapping[str, float]
) -> None:
    """Two widths share k_c and k_φ: each wheel's rows have the likelihood of their own K_s = k_c/b + k_φ."""
    wheels = {"A": wheel, "B": replace(wheel, width=0.5 * wheel.width)}
    table = make_table().assign(wheel=["A", "B"] * 3)
    table["normal_force [N]"] = table["load [N]"]
    noise = {"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3, "normal_force": 2.0}
    held = {name: value for name, value in truth.items() if name not in ("Ks", "phi")}
    options: dict[str, Any] = {"slip_reference": "shearing", "noise": noise, "drive": drive, "model": "M2"}
    ranges: dict[str, Any] = {"load_range": (60.0, 100.0)} if drive == "both" else {}
    density = posterior(Study(table, wheels, priors={**held, **MODULI}, **options, **ranges))
    assert density.names == ("kc", "kphi", "phi")
    for x in draw_cut_prior(density, 5, np.random.default_rng(1)).x:
        expected = 0.0
        for i, name in enumerate(("A", "B")):
            stiffness = float(x[0] / wheels[name].width + x[1])
            alone = Study(table.iloc[i::2], {name: wheels[name]}, priors={**held, "Ks": stiffness}, **options, **ranges)
            expected += posterior(alone).log_prior_and_likelihood(x[2:][None])[1][0]
        assert density.log_prior_and_likelihood(x[None])[1][0] == pytest.approx(expected, abs=2e-3 if ranges else 1e-9)


def test_a_modulus_that_is_not_positive_carries_nothing(make_study: MakeStudy, wheel: Wheel) -> None:
    """k_c so negative that K_s is not positive leaves the support; soil arrays hold the first wheel's K_s."""
    laws = {**MODULI, "kc": Law("uniform", lower=-1e6, upper=50e3)}
    density = posterior(make_study(free=("n0",), priors=laws))
    x = np.array([[-0.9e6, 1e6, 0.8], [10e3, 1e6, 0.8]])
    assert (density.reasons(x) == 0).tolist() == [False, True]
    soil = density.prior.soil_values(x)
    assert soil[1, 0] == pytest.approx(10e3 / wheel.width + 1e6)
    assert soil_at(soil, 0.1)[1, 0] == pytest.approx(10e3 / 0.1 + 1e6)


@pytest.mark.parametrize("drive", DRIVES)
def test_the_offset_is_added_to_what_the_sinkage_reads(
    drive: str, make_study: MakeStudy, make_table: MakeTable
) -> None:
    """Readings too high by 2 mm with an offset of 2 mm have the likelihood of the right ones without."""
    table = make_table()
    table["normal_force [N]"] = table["load [N]"]
    shifted = table.assign(**{"sinkage [m]": table["sinkage [m]"] + 2e-3})
    ranges = {"load_range": (60.0, 100.0)} if drive == "both" else {}
    plain = posterior(make_study(data=table, free=("phi", "c1"), drive=drive, **ranges))
    moved = posterior(make_study(data=shifted, free=("phi", "c1"), priors=OFFSET, drive=drive, **ranges))
    assert moved.names == ("phi", "c1", "sinkage_offset")
    x = draw_cut_prior(plain, 20, np.random.default_rng(1)).x
    with_offset = np.column_stack([x, np.full(20, 2e-3)])
    found, expected = moved.log_prior_and_likelihood(with_offset)[1], plain.log_prior_and_likelihood(x)[1]
    np.testing.assert_allclose(found, expected, rtol=1e-7, atol=1e-6)
    fixed = posterior(
        make_study(data=shifted, free=("phi", "c1"), priors={"sinkage_offset": 2e-3}, drive=drive, **ranges)
    )
    np.testing.assert_allclose(fixed.log_prior_and_likelihood(x)[1], expected, rtol=1e-7, atol=1e-6)


def test_simulated_readings_carry_offset_ties_and_moduli(make_study: MakeStudy) -> None:
    """Simulation takes every parameter's value, tied ones that of their root, and shifts the sinkage."""
    priors = {**MODULI, **OFFSET, "c2": "c1"}
    given = {"kc": 12e3, "kphi": 2e6, "c1": 0.2, "n0": 0.8, "sinkage_offset": 3e-3}
    study = make_study(free=("n0", "c1", "c2"), priors=priors, noise={"sinkage": 1e-9})
    truth = true_values(study, given)
    assert truth.values["c2"] == 0.2
    assert truth.origins["c2"] == "tied to c1"
    plain = make_study(free=("n0",), priors={**MODULI, "c1": 0.2, "c2": 0.2}, noise={"sinkage": 1e-9})
    rest = {name: value for name, value in given.items() if name != "sinkage_offset"}
    shift = simulate(study, given)["sinkage [mm]"] - simulate(plain, rest)["sinkage [mm]"]
    np.testing.assert_allclose(shift, 3.0, atol=1e-5)


def test_a_written_study_reads_back_the_same(make_study: MakeStudy, tmp_path: Path) -> None:
    """Ties, moduli, offset, tails and range survive a study file: same fingerprint, same density."""
    noise = {"sinkage": {"sd": 1e-3, "dof": 4.0}, "drawbar_pull": {"fraction": 0.1, "floor": 0.5, "dof": 3.0}}
    study = make_study(free=("n0", "c1", "c2"), priors={**MODULI, **OFFSET, "c2": "c1"}, noise=noise, drive="both")
    write_study(study, tmp_path)
    again = load_study(tmp_path)
    assert again.fingerprint == study.fingerprint
    assert again.load_range == study.load_range
    assert again.prior.ties == {"c2": "c1"}
    x = draw_cut_prior(posterior(study), 5, np.random.default_rng(1)).x
    np.testing.assert_array_equal(posterior(again).log_density(x), posterior(study).log_density(x))
    assert study_overview(again)


def test_least_squares_says_what_it_stands_in_for(make_study: MakeStudy, make_table: MakeTable) -> None:
    """Joint takes the measured force for the load and the offset's median; it refuses ties and two widths."""
    table = make_table("M1")
    table["normal_force [N]"] = table.pop("load [N]")
    options = {"data": table, "model": "M1", "free": ("phi", "K")}
    found = fit(make_study(**options, priors=OFFSET, drive="both"), ("joint",))["joint"]
    assert "the measured normal force stands for the load" in found.notes
    assert "the sinkage offset stands at 0 mm" in found.notes
    assert np.degrees(found.soil.phi) == pytest.approx(29.3, rel=1e-4)
    with pytest.raises(StudyError, match=r"joint knows no tied parameters \(got 'c2'\)"):
        fit(make_study(**{**options, "free": ("phi", "c1", "c2")}, priors={"c2": "c1"}, drive="both"), ("joint",))


def test_joint_finds_the_modulus_that_the_moduli_make(
    make_study: MakeStudy, make_table: MakeTable, truth: Mapping[str, float], wheel: Wheel
) -> None:
    """With k_c and k_φ free, joint fits their K_s; fixed, it holds it."""
    data = make_table("M1")
    free = fit(make_study(data=data, model="M1", free=("phi",), priors=MODULI), ("joint",))["joint"]
    assert free.soil.Ks == pytest.approx(truth["Ks"], rel=1e-3)
    fixed = {"kc": 10e3, "kphi": truth["Ks"] - 10e3 / wheel.width}
    held = fit(make_study(data=data, model="M1", free=("phi",), priors=fixed), ("joint",))["joint"]
    assert "Ks" in held.held
    assert held.soil.Ks == pytest.approx(truth["Ks"])


def test_predictions_of_rows_have_latent_loads(make_study: MakeStudy, make_table: MakeTable) -> None:
    """Loads are drawn near the readings of a row, and before these all over the range; forces scatter."""
    table = make_table("M2")
    table["normal_force [N]"] = table.pop("load [N]")
    study = make_study(data=table, drive="both")
    density = posterior(study)
    x = np.tile(draw_cut_prior(density, 1, np.random.default_rng(4)).x, (4000, 1))
    rows = predict_rows(study, density, x, np.random.default_rng(2))
    assert rows.channels == ("sinkage", "normal_force", "drawbar_pull", "resistance_moment")
    before = predict_rows(study, density, x, np.random.default_rng(2), before=True).modelled[:, :, 1]
    low, high = study.load_range or (0.0, 0.0)
    assert before.std() == pytest.approx((high - low) / np.sqrt(12), rel=0.05)
    assert rows.modelled[:, :, 1].std(axis=0).max() < 0.5 * before.std()
    noise = (rows.readings - rows.modelled)[:, :, 1]
    assert noise.std() == pytest.approx(2.0, rel=0.05)
    assert np.isfinite(rows.modelled).all()
