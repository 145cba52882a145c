"""Sobol indices over the cut prior of studies: what the cut joins, and what each outcome answers to."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import pytest
from paper_wheels import WHEELS
from sensitivity.cut_prior import cut_coupling, forward_at, group_inputs, single_inputs, study_problem
from sensitivity.groups import SECTION_4, Setting
from sensitivity.problems import columns_of, draw_base
from sensitivity.shapley import shapley
from sensitivity.sobol import Sobol, sobol

from bayesterra.likelihood.forward import model_columns
from bayesterra.likelihood.posterior import INSIDE, Posterior, draw_cut_prior, posterior
from bayesterra.models import Soil, Wheel, WheelSoilModel
from bayesterra.stats.laws import Law
from bayesterra.study.noise import Noise
from bayesterra.study.priors import Tie
from bayesterra.study.study import Study


def make(
    drive: str = "load",
    priors: Mapping[str, Any] | None = None,
    own_noise: Mapping[str, Noise] | None = None,
    **options: Any,
) -> Posterior:
    """A study of Wh31 at five slips; readings do not matter here."""
    table = pd.DataFrame(
        {
            "slip": [0.05, 0.2, 0.4, 0.5, 0.6],
            "load [N]": 80.0,
            "sinkage [mm]": [4.0, 9.0, 18.0, 23.0, 29.0],
            "normal_force [N]": 80.0,
            "drawbar_pull [N]": [10.0, 24.0, 26.0, 26.0, 27.0],
            "resistance_moment [N m]": [3.0, 6.0, 7.0, 7.5, 8.0],
        }
    )
    noise: dict[str, float | Noise] = {
        "sinkage": 1e-3,
        "drawbar_pull": 1.5,
        "resistance_moment": 0.3,
        "normal_force": 2.0,
    }
    noise |= own_noise or {}
    if drive != "both":
        noise.pop({"load": "normal_force", "sinkage": "sinkage"}[drive])
    return posterior(
        Study(
            table, {"Wh31": WHEELS["Wh31"]}, model="M1", slip_reference="shearing", drive=drive, noise=noise,
            priors={"set": "paper-box", **(priors or {})}, **options,
        )
    )  # fmt: skip


@pytest.fixture(scope="module")
def study() -> Posterior:
    """The paper's box under 80 N."""
    return make()


@pytest.fixture(scope="module")
def grouped(study: Posterior) -> Sobol:
    """Indices of the parameter groups."""
    return sobol(study_problem(study, group_inputs(study)), 4096, np.random.default_rng(2))


def test_the_cut_joins_the_contact_angles(study: Posterior) -> None:
    """In the paper's box only θ2 < θm < θ1 joins: c1 with c2. The load refuses 7 % of the rest."""
    found = cut_coupling(study, np.random.default_rng(1))
    assert list(found.inputs) == ["Ks", "n0", "n1", "c", "phi", "K", "c1 + c2"]
    assert found.inputs["c1 + c2"] == (6, 7)
    assert found.refused["n0 + n1 s > 0"] == 0.0
    assert found.refused["θ2 < θm < θ1"] == pytest.approx(0.64, abs=0.02)
    assert found.carrying == pytest.approx(0.073, abs=0.01)


def test_rules_account_for_the_cut(study: Posterior) -> None:
    """What the rules and the load leave is the share of the prior that the posterior's own draws find."""
    found = cut_coupling(study, np.random.default_rng(1))
    left = (1 - found.refused["θ2 < θm < θ1"]) * (1 - found.carrying)
    own = draw_cut_prior(study, 20_000, np.random.default_rng(2)).shares["inside the support"]
    assert left == pytest.approx(own, abs=0.01)


def test_exponents_moduli_and_c3_are_joined_where_the_cut_does() -> None:
    """A prior that lets N, K_s and θm out of range joins n0 with n1, k_c with k_φ and c3 with c1, c2."""
    priors = {
        "n0": Law("uniform", lower=-0.5, upper=1.0),
        "n1": Law("uniform", lower=-1.0, upper=1.0),
        "c3": Law("uniform", lower=-0.5, upper=0.5),
        "kc": Law("uniform", lower=-1e5, upper=1e5),
        "kphi": Law("uniform", lower=0.1e6, upper=5e6),
    }
    study = make(priors=priors)
    found = cut_coupling(study, np.random.default_rng(1))
    assert set(found.inputs) == {"kc + kphi", "n0 + n1", "c", "phi", "K", "c1 + c2 + c3"}
    assert all(share > 0 for share in found.refused.values())
    assert group_inputs(study)["P_I"] == tuple(study.names.index(name) for name in ("kc", "kphi", "n0", "n1"))


def test_tied_parameters_are_one_input() -> None:
    """Where c2 is tied to c1 there is one column; c1 tied to n0 joins n0 with c2."""
    study = make(priors={"c2": Tie("c1")})
    found = cut_coupling(study, np.random.default_rng(1))
    assert "c1" in found.inputs
    assert len(found.inputs) == len(study.names)
    found = cut_coupling(make(priors={"c1": Tie("n0")}), np.random.default_rng(1))
    assert "n0 + c2" in found.inputs


def test_noise_is_no_input() -> None:
    """The estimated noise moves no outcome and is left out; a sinkage offset moves sinkages only."""
    priors = {"sinkage_offset": Law("norm", {"loc": 0.0, "scale": 2e-3})}
    unknown = Noise("sinkage", law=Law("loguniform", lower=1e-4, upper=1e-2))
    study = make(priors=priors, own_noise={"sinkage": unknown})
    assert "noise_sinkage" in study.names
    assert list(group_inputs(study)) == ["P_I", "P_II", "P_III", "sinkage_offset"]
    found = sobol(study_problem(study, group_inputs(study)), 500, np.random.default_rng(1))
    moved = found.total[3].reshape(5, 3)
    assert (moved[:, 0] > 1e-4).all()
    np.testing.assert_allclose(moved[:, 1:], 0.0, atol=1e-12)


def test_outputs_are_labelled_in_field_units(study: Posterior) -> None:
    """Each reading row has three outputs, in mm, N and N m, beside its slip and load."""
    problem = study_problem(study, single_inputs(study))
    assert list(problem.outputs["output"][:3]) == ["sinkage [mm]", "drawbar_pull [N]", "resistance_moment [N m]"]
    assert list(problem.outputs["slip"][::3]) == [0.05, 0.2, 0.4, 0.5, 0.6]
    base = draw_base(problem, 200, np.random.default_rng(1))
    depth = study.outcomes(base.x).values[:, :, 0]
    np.testing.assert_allclose(base.values[:, ::3], 1e3 * depth)
    assert (study.reasons(base.x) == INSIDE).all()


def test_sinkage_answers_to_bearing(grouped: Sobol) -> None:
    """At the highest slip P_I holds most of the variance of z, P_II of F_DP; both share M_DR."""
    last = grouped.table[grouped.table["row"] == 5].set_index(["output", "input"])["first"]
    assert last["sinkage [mm]", "P_I"] > 0.7
    assert abs(last["sinkage [mm]", "P_II"]) < 0.08
    assert last["drawbar_pull [N]", "P_II"] > 0.45
    assert last["resistance_moment [N m]", "P_I"] > last["resistance_moment [N m]", "P_II"] > 0.2


@pytest.mark.slow
def test_first_order_index_is_the_variance_of_a_regression(study: Posterior, grouped: Sobol) -> None:
    """The first-order index of K on F_DP is the variance of bin means over draws, to their errors."""
    single = sobol(study_problem(study, {"K": (5,)}), 16_384, np.random.default_rng(4))
    x = draw_cut_prior(study, 40_000, np.random.default_rng(5)).x
    pull = study.outcomes(x).values[:, :, 1]
    order = np.argsort(x[:, 5]).reshape(50, -1)
    means, within = pull[order].mean(axis=1), pull[order].var(axis=1).mean(axis=0)
    expected = (means.var(axis=0) - within / order.shape[1]) / pull.var(axis=0)
    error = np.hypot(single.first_error[0, 1::3], 0.005)
    assert (np.abs(single.first[0, 1::3] - expected) < 4 * error).all()
    assert single.unmatched == 0.0


def test_shapley_effects_of_the_groups(study: Posterior, grouped: Sobol) -> None:
    """Shapley effects add up to one and lie between first-order and total index where nothing is coupled."""
    found = shapley(study_problem(study, group_inputs(study)), 2048, np.random.default_rng(3))
    np.testing.assert_allclose(found.effect.sum(axis=0), 1.0)
    slack = 4 * np.hypot(found.error, np.hypot(grouped.first_error, grouped.total_error)) + 0.02
    assert (found.effect > np.minimum(grouped.first, grouped.total) - slack).all()
    assert (found.effect < np.maximum(grouped.first, grouped.total) + slack).all()


def test_other_conditions(study: Posterior) -> None:
    """Outputs at other slips and loads are the model's there, and what cannot carry them is cut too."""
    heavy = forward_at(study, Setting(WHEELS["Wh32"], 800.0, np.array([0.5])))
    problem = study_problem(study, single_inputs(study), heavy)
    base = draw_base(problem, 100, np.random.default_rng(1))
    x = base.x[0]
    soil = Soil(*model_columns(study.prior.soil_values(base.x), study.likelihood.forward.model)[0])
    model = study.likelihood.forward.model
    assert isinstance(model, WheelSoilModel)
    depth = model.sinkage(soil, WHEELS["Wh32"], 0.5, 800.0)
    assert base.values[0, 0] == pytest.approx(1e3 * float(depth))
    assert problem.outputs["load [N]"].eq(800.0).all()
    usual = draw_base(study_problem(study, single_inputs(study)), 5000, np.random.default_rng(1))
    assert base.accepted < usual.accepted
    assert columns_of(problem, ("Ks", "K"), len(x)).sum() == 2


@pytest.mark.parametrize(("drive", "outputs"), [("sinkage", 3), ("both", 3)])
def test_other_drives(drive: str, outputs: int) -> None:
    """Forces are outputs of given sinkages; a latent load is held at its reading and is no output."""
    options: dict[str, Any] = {"load_range": ("40 N", "120 N")} if drive == "both" else {}
    study = make(drive, **options)
    found = sobol(study_problem(study, group_inputs(study)), 200, np.random.default_rng(1))
    assert found.first.shape == (3, 5 * outputs)
    assert np.isfinite(found.total).all()
    names = set(found.outputs["output"])
    assert ("normal_force [N]" in names) == (drive == "sinkage")


def test_setting_of_the_paper() -> None:
    """Section 4 runs Wh31 under 80 N at six slips."""
    assert SECTION_4.wheel == Wheel(0.15735, 0.165, 0.015, 30, 0.75)
    assert SECTION_4.slips.tolist() == [0.0, 0.1, 0.2, 0.3, 0.4, 0.6]
