"""Exact sensitivities against differences, and Fisher information against the spread of scores."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.likelihood.sensitivities import (
    load_information,
    score_and_information,
    sensitivities,
    weighted_sensitivities,
    without_load,
)
from bayesterra.models import MODELS, Soil, Wheel
from bayesterra.study.drive import Drive
from bayesterra.study.study import Study
from tests.support.fisher import fisher_information

WIDE, NARROW = Wheel(0.15735, 0.165, 0.010, 30, 0.65), Wheel(0.135, 0.11, 0.015, 24, 0.75)
TRUTH = {"Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 268.0, "phi": 0.51, "K": 0.01, "c1": 0.34, "c2": -0.02}
NOISE = {"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3, "normal_force": 2.0}
MIXED = {
    "sinkage": {"sd": 1e-3, "dof": 4},
    "normal_force": {"fraction": 0.03, "floor": 0.1, "dof": 5},
    "drawbar_pull": {"fraction": 0.05, "floor": 1.0},
    "resistance_moment": {"estimate": {"dist": "halfnorm", "scale": 0.5, "lower": 0.05}, "dof": 6},
}
"""Noise of every kind: Student-t, a fraction with a floor, estimated."""
MODULI = {
    "kc": {"dist": "uniform", "lower": 0.0, "upper": 5e4},
    "kphi": {"dist": "uniform", "lower": 5e5, "upper": 5e6},
}
KINDS: Mapping[str, Mapping[str, Any]] = {
    "nine soil parameters": {"c3": {"dist": "uniform", "lower": -0.5, "upper": 0.2}},
    "kc and kphi": MODULI,
    "kc, kphi held": {**MODULI, "kphi": 2e6},
    "ties": {"c2": "c1", "n1": "n0"},
    "sinkage offset": {"sinkage_offset": {"dist": "norm", "scale": 1e-3}, "n1": 1.06},
}


def make(
    model: str = "M2",
    drive: str = "load",
    priors: Mapping[str, Any] | None = None,
    noise: Mapping[str, Any] | None = None,
    **options: Any,
) -> Posterior:
    """Two wheels at four slips and two loads, all channels read but one reading, one sd of its own."""
    slip, load = np.array([0.1, 0.2, 0.4, 0.6] * 2), np.array([80.0] * 4 + [60.0] * 4)
    soil, table = Soil(**TRUTH), pd.DataFrame({"slip": slip, "wheel": ["wide"] * 4 + ["narrow"] * 4})
    if drive == "load":
        table["load [N]"] = load
    rows: list[FloatArray] = []
    for wheel, part in ((WIDE, slice(0, 4)), (NARROW, slice(4, 8))):
        z = MODELS[model]().sinkage(soil, wheel, slip[part], load[part])
        forces = MODELS[model]().forces(soil, wheel, slip[part], z)
        read = (z, forces.drawbar_pull, forces.resistance_moment, forces.normal)
        rows.append(np.array(read))
    columns = ("sinkage [m]", "drawbar_pull [N]", "resistance_moment [N m]", "normal_force [N]")
    for column, values in zip(columns, np.hstack(rows), strict=True):
        if drive != "load" or not column.startswith("normal"):
            table[column] = values
    table.loc[2, "drawbar_pull [N]"] = np.nan
    table["resistance_moment_sd [N m]"] = [0.2, *[np.nan] * 7]
    return posterior(
        Study(
            table,
            {"wide": WIDE, "narrow": NARROW},
            model=model,
            drive=drive,
            slip_reference="shearing",
            noise={name: each for name, each in (noise or NOISE).items() if name in _outcomes(drive)},
            priors={"set": "paper-box", **(priors or {})},
            **options,
        )
    )


def _outcomes(drive: str) -> tuple[str, ...]:
    left_out = {"load": "normal_force", "sinkage": "sinkage", "both": ""}[drive]
    return tuple(name for name in NOISE if name != left_out)


def differences(f: Callable[[FloatArray], FloatArray], x: FloatArray, steps: FloatArray) -> FloatArray:
    """Derivatives (..., d) of ``f``: (n, d) → (n, ...) at ``x`` (d,) by five-point differences."""
    columns = []
    for i, step in enumerate(steps):
        at = x + np.outer([-2.0, -1.0, 1.0, 2.0], np.eye(len(x))[i] * step)
        columns.append(np.tensordot([1.0, -8.0, 8.0, -1.0], f(at), axes=1) / (12.0 * step))
    return np.stack(columns, axis=-1)


def modelled(post: Posterior) -> Callable[[FloatArray], FloatArray]:
    """Outcomes of the drive, every row for itself, at the loads that the sensitivities use."""
    forward = post.likelihood.forward
    return lambda x: np.asarray(forward(post.prior.soil_values(x), every_row=True).values)


def inner_points(post: Posterior, n: int) -> FloatArray:
    """Draws of the cut prior around which the model has answers."""
    x = draw_cut_prior(post, 400, np.random.default_rng(2)).x
    steps = 1e-2 * x.std(axis=0)
    ends = np.array([law.range for law in post.prior.laws.values()]).T
    inside = (x - steps > ends[0]).all(axis=1) & (x + steps < ends[1]).all(axis=1)
    answered = np.isfinite(modelled(post)(x)).all(axis=(1, 2))
    return np.asarray(x[inside & answered][:n])


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("drive", ["load", "sinkage", "both"])
@pytest.mark.parametrize("model", ["M1", "M2", "M3"])
def test_sensitivities_are_the_derivatives(model: str, drive: str, kind: str) -> None:
    """For every model, drive and kind of parameters the exact derivatives agree with differences."""
    options = {"load_range": (40.0, 160.0)} if drive == "both" else {}
    post = make(model, drive, KINDS[kind], MIXED, **options)
    x, unit = inner_points(post, 3), draw_cut_prior(post, 400, np.random.default_rng(1)).x.std(axis=0)
    found = sensitivities(post, x)
    assert found.channels == post.likelihood.forward.outcomes
    for i, point in enumerate(x):
        expected = differences(modelled(post), point, 1e-4 * unit) * unit
        largest = np.abs(expected).max(axis=(0, 2), keepdims=True)
        size = np.maximum(largest, 1e-3 * np.abs(found.values[i]).max(axis=0)[:, None])
        np.testing.assert_allclose(found.by_parameter[i] * unit / size, expected / size, atol=2e-5)
    np.testing.assert_allclose(found.values, modelled(post)(x), rtol=1e-12)


@pytest.mark.parametrize("model", ["M1", "M2", "M3"])
def test_derivatives_by_a_latent_load(model: str) -> None:
    """With drive both, by_load is the change of each channel with the load of its row."""
    post = make(model, "both", {}, load_range=(40.0, 160.0))
    x, forward = inner_points(post, 1), post.likelihood.forward
    soil, given = post.prior.soil_values(x), post.likelihood.forward.given
    ahead, behind = (replace(forward, given=given + step)(soil).values for step in (0.01, -0.01))
    found = sensitivities(post, x)
    np.testing.assert_allclose(found.by_load, (ahead - behind) / 0.02, rtol=1e-4, atol=1e-9)
    np.testing.assert_array_equal(found.by_load[:, :, 1], 1.0)


def test_a_latent_load_is_taken_where_it_is_best_known() -> None:
    """Loads without any reading of force are taken in the middle of their range, read ones inside it."""
    post = make("M2", "both", {}, load_range=(70.0, 160.0))
    np.testing.assert_allclose(post.likelihood.forward.given, [80.0] * 4 + [70.0] * 4)


def numerical_information(post: Posterior, x: FloatArray, unit: FloatArray) -> FloatArray:
    """Fisher information (d, d) from differences of modelled values and of the likelihood's own scales."""
    likelihood = post.likelihood
    forward, ends = likelihood.forward, likelihood.load_range
    latent = ends is not None
    loads = forward.given if latent else np.empty(0)
    known = 0.0 if ends is None else load_information(ends)

    def place_and_scale(y: FloatArray) -> FloatArray:
        theta, given = y[:, : len(x)], y[:, len(x) :]
        held = replace(forward, given=given) if latent else forward
        predicted = likelihood.predicted(held(post.prior.soil_values(theta), every_row=True))
        if latent:
            predicted[:, :, 1] = given  # the force that the row reads is its load
        return np.stack([predicted, likelihood.scales(predicted, post.noise_values(theta))], axis=-1)

    point, steps = np.concatenate([x, loads]), np.concatenate([1e-4 * unit, 1e-4 * loads])
    slopes = differences(place_and_scale, point, steps)
    scale = place_and_scale(point[None])[0, ..., 1]
    total = np.diag(np.concatenate([0.0 * x, np.full(len(loads), known)]))
    for j, k in zip(*np.nonzero(~np.isnan(likelihood.measured)), strict=True):
        dof = likelihood.noise[k].dof
        place, width = (1.0, 2.0) if np.isinf(dof) else ((dof + 1) / (dof + 3), 2 * dof / (dof + 3))
        for weight, slope in zip((place, width), slopes[j, k], strict=True):
            total += weight * np.outer(slope, slope) / scale[j, k] ** 2
    d = len(x)
    return np.asarray(total[:d, :d] - total[:d, d:] @ np.linalg.pinv(total[d:, d:]) @ total[d:, :d])


@pytest.mark.parametrize("drive", ["load", "sinkage", "both"])
def test_fisher_information_is_the_sum_over_readings(drive: str) -> None:
    """Noise of every kind, missing readings, own sds and latent loads: as from differences, term by term."""
    options = {"load_range": (40.0, 160.0)} if drive == "both" else {}
    post = make("M2", drive, KINDS["kc and kphi"], MIXED, **options)
    x, unit = inner_points(post, 3), draw_cut_prior(post, 400, np.random.default_rng(1)).x.std(axis=0)
    assert post.names[-1] == "noise_resistance_moment"
    for point, found in zip(x, fisher_information(post, x), strict=True):
        expected = numerical_information(post, point, unit)
        size = np.sqrt(np.diagonal(expected))
        np.testing.assert_allclose(found / np.outer(size, size), expected / np.outer(size, size), atol=1e-4)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("drive", ["load", "sinkage"])
def test_the_score_is_the_gradient_of_the_log_likelihood(drive: str, kind: str) -> None:
    """Central differences of the log likelihood give the same gradient, whatever the noise."""
    target = make(drive=drive, priors=KINDS[kind], noise=MIXED)
    x = draw_cut_prior(target, 40, np.random.default_rng(4)).x
    gradient, information = score_and_information(target, x)
    np.testing.assert_allclose(information, fisher_information(target, x), rtol=1e-12)
    steps = 1e-6 * x.std(axis=0)
    for i, step in enumerate(steps):
        ahead, behind = x.copy(), x.copy()
        ahead[:, i] += step
        behind[:, i] -= step
        levels = [target.log_prior_and_likelihood(points)[1] for points in (ahead, behind)]
        inside = np.isfinite(levels).all(axis=0) & np.isfinite(gradient[:, i])
        slope = (levels[0] - levels[1])[inside] / (2 * step)
        size = np.abs(gradient[inside, i]).max()
        np.testing.assert_allclose(gradient[inside, i], slope, rtol=1e-4, atol=1e-6 * size)
        assert inside.sum() >= 20


def test_the_information_is_the_covariance_of_the_score() -> None:
    """Over simulated readings the likelihood's numerical score has the Fisher information for covariance."""
    held = {name: value for name, value in TRUTH.items() if name not in ("n0", "K")}
    post = make("M2", "load", held, {**MIXED, "sinkage": {"fraction": 0.2, "floor": 1e-4, "dof": 5}})
    x, unit = np.array([0.85, 0.01, 0.3]), np.array([0.1, 1e-3, 0.05])
    likelihood, copies, rng = post.likelihood, 20_000, np.random.default_rng(1)
    outcomes = post.outcomes(np.repeat(x[None], copies, axis=0))
    readings = likelihood.draw(outcomes, np.full((copies, 1), x[2]), rng)
    readings[:, np.isnan(likelihood.measured)] = np.nan

    def levels(y: FloatArray) -> FloatArray:
        predicted = likelihood.predicted(post.outcomes(y))
        scale = likelihood.scales(predicted, post.noise_values(y))
        laws = [
            noise.tails.log_density((readings[None, :, :, i] - predicted[:, None, :, i]) / scale[:, None, :, i])
            for i, noise in enumerate(likelihood.noise)
        ]
        density = np.stack(laws, axis=-1) - np.log(scale)[:, None]
        return np.asarray(np.nansum(density, axis=(2, 3)))

    score = differences(levels, x, 1e-3 * unit)
    root = np.linalg.inv(np.linalg.cholesky(fisher_information(post, x)[0]))
    np.testing.assert_allclose(root @ np.cov(score.T) @ root.T, np.eye(3), atol=0.05)
    np.testing.assert_allclose(root @ score.mean(axis=0), 0.0, atol=0.03)


def one_condition(columns: Mapping[str, FloatArray], noise: Mapping[str, float]) -> Posterior:
    """Rows of one slip with latent loads; n0 and K are free."""
    units = {"normal_force": "N", "sinkage": "m", "resistance_moment": "N m"}
    table = pd.DataFrame({f"{name} [{units[name]}]": column for name, column in columns.items()})
    held = {name: value for name, value in TRUTH.items() if name not in ("n0", "K")}
    return posterior(
        Study(
            table.assign(slip=0.3),
            {"wide": WIDE},
            model="M2",
            drive="both",
            slip_reference="shearing",
            noise=noise,
            load_range=(30.0, 160.0),
            priors={"set": "paper-box", **held},
        )
    )


@pytest.mark.slow
@pytest.mark.parametrize("force_noise", [1.0, 6.0])
def test_a_latent_load_costs_what_the_score_says(force_noise: float) -> None:
    """The score of the likelihood that integrates over the load has the Schur complement for covariance."""
    copies, rng, soil, model = 4000, np.random.default_rng(1), Soil(**TRUTH), MODELS["M2"]()
    z = float(model.sinkage(soil, WIDE, 0.3, 80.0))
    exact = {
        "normal_force": 80.0,
        "sinkage": z,
        "resistance_moment": float(model.forces(soil, WIDE, 0.3, z).resistance_moment),
    }
    noise = {"normal_force": force_noise, "sinkage": 2e-4, "resistance_moment": 0.05}
    x = np.array([0.85, 0.01])
    single = {name: np.array([value]) for name, value in exact.items()}
    information = fisher_information(one_condition(single, noise), x)[0]
    read = {n: value + noise[n] * rng.standard_normal(copies) for n, value in exact.items()}
    many, unit = one_condition(read, noise), 1.0 / np.sqrt(np.diagonal(information))
    score = differences(lambda y: many.log_terms(y)[:, :, 0], x, 0.2 * unit)
    root = np.linalg.inv(np.linalg.cholesky(information))
    np.testing.assert_allclose(root @ np.cov(score.T) @ root.T, np.eye(2), atol=0.1)


def test_taking_a_load_out_is_the_schur_complement() -> None:
    """AᵀA of the reduced rows is I_xx − I_xW I_Wx / (I_WW + known), also where nothing reads the load."""
    rng = np.random.default_rng(1)
    by_x, by_load = rng.standard_normal((2, 3, 4, 5)), rng.standard_normal((2, 3, 4))
    by_load[0, 1] = 0.0
    for known in (0.0, 0.7):
        reduced = without_load(by_x, by_load, known)
        cross, size = np.einsum("nmk,nmkd->nmd", by_load, by_x), (by_load**2).sum(axis=2)
        share = np.where(size > 0, 1.0 / np.maximum(size + known, 1e-300), 0.0)
        expected = np.einsum("nmki,nmkj->nmij", by_x, by_x)
        expected -= share[..., None, None] * cross[..., None] * cross[..., None, :]
        np.testing.assert_allclose(np.einsum("nmki,nmkj->nmij", reduced, reduced), expected, atol=1e-12)


def test_without_a_load_that_is_known_nothing_is_lost() -> None:
    """A load that the prior pins down costs no information: drive both becomes drive load."""
    latent = make("M2", "both", {}, load_range=(79.9999999, 80.0000001))
    x = inner_points(latent, 2)
    with_force = fisher_information(latent, x)
    forward = replace(latent.likelihood.forward, drive=Drive.LOAD, given=latent.likelihood.forward.given)
    rows = latent.likelihood
    plain = type(make("M2").likelihood)(
        forward, rows.observations, [n for n in rows.noise if n.channel != "normal_force"]
    )
    np.testing.assert_allclose(with_force, fisher_information(Posterior(latent.prior, plain), x), rtol=1e-6)


def test_a_set_without_an_answer_is_nan() -> None:
    """Where no sinkage carries the load, sensitivities and information are NaN, and those of others stand."""
    post = make("M2", "load", {name: value for name, value in TRUTH.items() if name != "Ks"})
    weighted = weighted_sensitivities(post, np.array([[2.5e6], [10.0]]))
    assert np.isfinite(weighted[0]).all()
    assert np.isnan(fisher_information(post, np.array([[2.5e6], [10.0]]))[1]).all()
