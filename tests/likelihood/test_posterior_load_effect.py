"""Studies with the model M2L: priors, posterior, derivatives, least squares and what a design determines."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import bayesterra as bt
from bayesterra.errors import StudyError
from bayesterra.identifiability import evidence_page
from bayesterra.identifiability.structure import structure
from bayesterra.identifiability.verdicts import group_columns
from bayesterra.likelihood.forward import model_columns
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.likelihood.sensitivities import sensitivities
from bayesterra.models import M2L, LoadEffectSoil
from bayesterra.parameters import LOAD_EFFECT, MODEL_PARAMETERS, PRIOR_PARAMETERS, soil_array
from bayesterra.stats.laws import Law
from bayesterra.study.canonical import write_study
from bayesterra.study.study import Study, load_study

TRUTH = {
    "Ks": 1.796e6, "n0": 0.63, "n1": 0.72, "c": 300.0, "phi": 0.62, "K": 0.0105, "c1": 0.5, "c2": 0.0,
    "cP1": -0.276, "cP2": 0.633, "cDP": -0.304, "cM": 0.354,
}  # fmt: skip
NOISE = {"sinkage": 5e-4, "drawbar_pull": 0.5, "resistance_moment": 0.05, "normal_force": 1.0}
WHEELS = {"narrow": bt.Wheel(0.090, 0.080, 0.010, 24, 0.65), "wide": bt.Wheel(0.090, 0.110, 0.010, 24, 0.65)}


def table(loads: tuple[float, ...] = (32.0, 64.0, 96.0), drive: str = "load") -> pd.DataFrame:
    """Exact readings at four slips under each load, wheels in turn."""
    slips = np.tile([0.05, 0.2, 0.4, 0.6], len(loads))
    load = np.repeat(loads, 4)
    names = np.array(["narrow", "wide"])[np.arange(len(load)) % 2]
    model, rows = M2L(mean_load=64.0), []
    for slip, name, W in zip(slips, names, load, strict=True):
        z = model.sinkage(LoadEffectSoil(**TRUTH), WHEELS[name], float(slip), float(W))
        forces = model.forces(LoadEffectSoil(**TRUTH), WHEELS[name], float(slip), z)
        rows.append((z, forces.drawbar_pull, forces.resistance_moment))
    z, pull, moment = np.array(rows).T
    force = "load [N]" if drive == "load" else "normal_force [N]"
    return pd.DataFrame({"slip": slips, "wheel": names, force: load, "sinkage [m]": z,
                         "drawbar_pull [N]": pull, "resistance_moment [N m]": moment})  # fmt: skip


def make(
    data: pd.DataFrame | None = None, *, drive: str = "load", priors: Mapping[str, Any] | None = None, **more: Any
) -> Study:
    """A study with the model M2L."""
    data = table(drive=drive) if data is None else data
    given = "load" if drive == "load" else "sinkage" if drive == "sinkage" else ""
    noise = {n: v for n, v in NOISE.items() if n != given and any(n in str(column) for column in data)}
    options = {"model": "M2L", "model_options": {"mean_load": 64.0}, **more}
    return Study(
        data, WHEELS, slip_reference="shearing", drive=drive, noise=noise, kind="simulated",
        priors={"set": "paper-box", **(priors or {})}, **options,
    )  # fmt: skip


def test_the_load_effect_has_priors_and_the_angles_are_held() -> None:
    """Both sets know the four coefficients; c1 = 0.5 and c2 = c3 = 0 unless a study says otherwise."""
    for name, dist in (("paper-box", "uniform"), ("planetary", "norm")):
        study = make(priors={"set": name})
        assert [study.prior.laws[n].dist for n in LOAD_EFFECT] == [dist] * 4
        assert all(study.prior.laws[n].source.startswith("no independent source") for n in LOAD_EFFECT)
        assert {n: study.prior.fixed[n] for n in ("c1", "c2", "c3")} == {"c1": 0.5, "c2": 0.0, "c3": 0.0}
        assert "c1 = 0.5, c2 = 0 held, as in (42); an entry in [priors] frees them" in study.notes
    freed = make(priors={"c1": Law("uniform", lower=0.2, upper=0.8), "cM": 0.0})
    assert "c1" in freed.prior.names
    assert freed.prior.fixed["cM"] == 0.0
    assert "c2 = 0 held, as in (42); an entry in [priors] frees them" in freed.notes


def test_the_mean_load_comes_from_the_rows_once() -> None:
    """Left out, it is the mean of all rows' loads, used or not, and the study says so."""
    data = table().assign(use=[0, 0, 0, 0] + [1] * 8)
    study = make(data, model_options={})
    assert study.model == M2L(mean_load=64.0)
    assert "mean load per wheel W̄ = 64 N, the mean of all rows, as none is given" in study.notes
    assert make(model_options={"mean_load": 50.0}).model == M2L(mean_load=50.0)
    forced = make(drive="sinkage", model_options={})
    assert forced.model == M2L(mean_load=64.0)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            {"model": "M2", "model_options": {}, "priors": {"cM": 0.1}},
            r"\[priors\] 'cM' belongs to the load effect of the model 'M2L' \(got model 'M2'\): leave it "
            r"out, or set model = \"M2L\"",
        ),
        ({"model": "M1"}, r"\[model_options\] 'mean_load' belongs to the model 'M2L' \(got 'M1'\)"),
        (
            {"model_options": {"mean_load": -3.0}},
            r"\[model_options\] 'mean_load' must be positive and finite \(got -3.0\)",
        ),
        ({"priors": {"cM": 1.5}}, r"'cM' must be fixed inside the range of 'paper-box', -1 to 1 \(got 1.5\)"),
    ],
)
def test_mistakes_are_named(more: dict[str, Any], message: str) -> None:
    """One line says which key belongs to which model, and what was got."""
    with pytest.raises(StudyError, match=message):
        make(**more)


def test_a_mean_load_needs_loads() -> None:
    """Without loads or normal forces none can be taken from the rows."""
    data = table(drive="sinkage").drop(columns="normal_force [N]")
    with pytest.raises(StudyError, match="'mean_load' must be given with the model 'M2L', as no row has a load"):
        make(data, drive="sinkage", model_options={})


def test_a_study_written_out_is_the_same_study(tmp_path: Path) -> None:
    """The mean load has its unit in the file, and every prior comes back."""
    study = make(model_options={})
    write_study(study, tmp_path)
    assert 'mean_load = "64 N"' in (tmp_path / "study.toml").read_text()
    again = load_study(tmp_path)
    assert again.fingerprint["study"] == study.fingerprint["study"]
    assert again.model == study.model


def test_without_coefficients_the_posterior_is_that_of_m2() -> None:
    """With all four held at 0, the density of M2L is that of M2 with the same c1, c2."""
    zero = dict.fromkeys(LOAD_EFFECT, 0.0)
    ours = posterior(make(priors=zero))
    theirs = posterior(make(model="M2", model_options={}, priors={"c1": 0.5, "c2": 0.0}))
    x = draw_cut_prior(theirs, 20, np.random.default_rng(1)).x
    assert ours.names == theirs.names
    np.testing.assert_allclose(ours.log_density(x), theirs.log_density(x), rtol=1e-10)


KINDS: dict[str, dict[str, Any]] = {
    "thirteen columns": {"c1": Law("uniform", lower=0.3, upper=0.7)},
    "sixteen columns": {
        "kc": Law("uniform", lower=0.0, upper=2e4), "kphi": Law("uniform", lower=1e6, upper=3e6),
        "sinkage_offset": Law("norm", {"scale": 1e-3}),
    },
    "a tie": {"cP2": "cP1"},
}  # fmt: skip


@pytest.mark.parametrize("drive", ["load", "sinkage", "both"])
@pytest.mark.parametrize("kind", KINDS)
def test_sensitivities_equal_differences(kind: str, drive: str) -> None:
    """Derivatives by every free parameter of M2L agree with central differences, moduli and offset too."""
    study = make(drive=drive, priors=KINDS[kind])
    density = posterior(study)
    known = {**TRUTH, "kc": 8e3, "kphi": 1.7e6, "sinkage_offset": 2e-4}
    x = np.array([[known[name] for name in density.names]])
    found = sensitivities(density, x)
    forward = density.likelihood.forward
    for i, name in enumerate(density.names):
        step = 1e-4 * max(abs(x[0, i]), 1e-3 if name == "sinkage_offset" else 1e-2)
        ends = []
        for side in (-1, 1):
            moved = x.copy()
            moved[0, i] += side * step
            ends.append(forward(density.prior.soil_values(moved)).values)
        slope = (ends[1] - ends[0]) / (2 * step)
        scale = np.abs(slope).max(axis=(0, 1)) + 1e-12
        np.testing.assert_allclose(found.by_parameter[..., i] / scale, slope / scale, rtol=0, atol=2e-5)


def test_joint_finds_exact_readings_and_the_others_refuse() -> None:
    """Joint fits all ten parameters; IM1 to IM3 do not know the load effect, and are left out by default."""
    study = make(priors={"K": 0.0105})
    fits = bt.fit(study)
    assert tuple(fits) == ("joint",)
    assert isinstance(fits["joint"].soil, LoadEffectSoil)
    assert tuple(fits["joint"].values()) == tuple(MODEL_PARAMETERS[:13])
    for name in ("n0", "phi", *LOAD_EFFECT):
        assert fits["joint"].values()[name] == pytest.approx(TRUTH[name], rel=1e-3)
    assert "IM1, IM2 and IM3 know no load effect" in fits["joint"].notes
    with pytest.raises(StudyError, match="IM2 knows no load effect: with the model M2L only joint fits"):
        bt.fit(study, methods=("IM2",))
    with pytest.raises(StudyError, match="nothing can be fitted: with the model M2L only joint fits"):
        bt.fit(make(least_squares={"methods": ("IM1", "IM3")}))


def test_held_coefficients_are_held_and_strange_ones_refused() -> None:
    """[least_squares] takes the coefficients with M2L, and no other model does."""
    fits = bt.fit(make(), hold={"cM": 0.2, "Ks": 1.796e6})
    assert fits["joint"].values()["cM"] == 0.2
    with pytest.raises(StudyError, match="least squares: the model M2 knows no parameter 'cM'"):
        bt.fit(make(model="M2", model_options={}), methods=("joint",), hold={"cM": 0.2})


def test_the_mean_load_alone_leaves_both_load_effects_open() -> None:
    """Under W̄ alone no reading depends on c_DP and c_M, and the load is named as the reason."""
    for loads, open_names in (((64.0, 64.0), ("cDP", "cM")), ((32.0, 96.0), ())):
        density = posterior(make(table(loads)))
        prior = draw_cut_prior(density, 60, np.random.default_rng(2)).x
        found = structure(density, prior)
        assert tuple(name for null in found.nulls for name in null.parameters) == open_names
        if open_names:
            assert found.nulls[0].words == "no reading depends on c_DP and c_M; all rows have the load 64 N"


def test_the_load_effect_is_a_group() -> None:
    """Its columns, and its word in tables."""
    assert group_columns(("n0", "phi", *LOAD_EFFECT)) == {"P_I": [0], "P_II": [1], "load effect": [2, 3, 4, 5]}
    assert evidence_page.group("load effect") == "load effect"


def test_other_models_have_nine_parameters_still() -> None:
    """The columns of a posterior of M2 are what they were, and it takes nine of a soil array."""
    study = make(model="M2", model_options={})
    soil = soil_array({name: float(i) for i, name in enumerate(PRIOR_PARAMETERS)})
    assert model_columns(soil, study.model).tolist() == [[float(i) for i in range(9)]]
    assert posterior(study).names == ("Ks", "n0", "n1", "c", "phi", "K", "c1", "c2")
