"""The posterior density: its support, its constants, its names; and draws of the cut prior."""

import re
from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

from bayesterra.arrays import FloatArray
from bayesterra.errors import SupportError
from bayesterra.likelihood.forward import model_columns
from bayesterra.likelihood.posterior import (
    INSIDE,
    OUTSIDE_PHYSICS,
    OUTSIDE_PRIOR,
    REASONS,
    Posterior,
    draw_cut_prior,
    posterior,
)
from bayesterra.models import MODELS, Conditions, Soil, Status, Wheel
from bayesterra.stats.laws import Law
from bayesterra.study.noise import Noise
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]

UNBOUNDED: Mapping[str, Law] = {
    "Ks": Law("lognorm", {"s": 1.0, "scale": 2e6}),
    "n0": Law("norm", {"loc": 1.0, "scale": 0.3}),
    "n1": Law("norm", {"loc": 1.0, "scale": 0.5}),
    "c": Law("gamma", {"a": 0.5, "scale": 1000.0}),
    "phi": Law("norm", {"loc": 0.5, "scale": 0.1}),
    "K": Law("loguniform", lower=1e-3, upper=0.1),
    "c1": Law("norm", {"loc": 0.4, "scale": 0.2}),
    "c2": Law("cauchy", {"scale": 0.2}),
}
"""Laws that reach over every limit of the models, two of them with poles or heavy tails."""

MIXED_NOISE: Mapping[str, Noise] = {
    "drawbar_pull": Noise("drawbar_pull", fraction=0.05, floor=0.1),
    "resistance_moment": Noise("resistance_moment", law=Law("halfnorm", {"scale": 0.3}, lower=0.03)),
}
SOIL_VALUES = ("Ks", "n0", "n1", "c", "phi", "K", "c1", "c2")


def wild(density: Posterior, n: int, rng: np.random.Generator) -> FloatArray:
    """Draws of the cut prior with a third of all values replaced by anything a float can be."""
    x = draw_cut_prior(density, n, rng).x
    spoiled = rng.random(x.shape) < 0.1
    x[spoiled] = rng.standard_normal(spoiled.sum()) * 10.0 ** rng.uniform(-15, 15, spoiled.sum())
    for value in (np.nan, np.inf, -np.inf, 0.0, 1e300, -1e300, 1e-300, np.pi / 2):
        x[rng.random(x.shape) < 0.01] = value
    return x


@pytest.mark.parametrize("drive", ["load", "sinkage"])
@pytest.mark.parametrize("model", ["M1", "M2"])
def test_density_is_never_nan(model: str, drive: str, make_study: MakeStudy) -> None:
    """Over 1e5 wild points the density is a number or −inf, and a point with a reason has −inf."""
    density = posterior(make_study(model=model, drive=drive, priors=UNBOUNDED, noise=MIXED_NOISE))
    x = wild(density, 30_000, np.random.default_rng(1))
    level, reasons = density.log_density(x), density.reasons(x)
    assert not np.isnan(level).any()
    assert not np.isposinf(level).any()
    assert np.isneginf(level[reasons != INSIDE]).all()
    sane = np.isfinite(x).all(axis=1) & (np.abs(x) < 1e20).all(axis=1) & (x[:, 1] > 0.01)
    assert np.isfinite(level[(reasons == INSIDE) & sane]).all()
    assert set(reasons) >= {INSIDE, OUTSIDE_PRIOR, OUTSIDE_PHYSICS, Status.EXPONENT, Status.CONTACT_ANGLE}


@pytest.mark.parametrize(
    ("drive", "change", "reason"),
    [
        ("load", {}, INSIDE),
        ("load", {"K": 0.2}, OUTSIDE_PRIOR),
        ("load", {"phi": np.nan}, OUTSIDE_PRIOR),
        ("load", {"c": -1.0}, OUTSIDE_PHYSICS),
        ("load", {"phi": -0.1}, OUTSIDE_PHYSICS),
        ("load", {"phi": np.pi / 2}, OUTSIDE_PHYSICS),
        ("load", {"n0": 0.1, "n1": -1.0}, Status.EXPONENT),
        ("load", {"c1": 1.1}, Status.CONTACT_ANGLE),
        ("load", {"c1": 0.3, "c2": -0.6}, Status.CONTACT_ANGLE),
        ("load", {"Ks": 1e3, "n0": 2.0, "c": 0.0, "phi": 0.01}, Status.LOAD),
        ("sinkage", {"Ks": 1e3, "n0": 2.0, "c": 0.0, "phi": 0.01}, INSIDE),
    ],
)
def test_every_impossible_point_has_its_reason(
    drive: str, change: Mapping[str, float], reason: int, make_study: MakeStudy, truth: Mapping[str, float]
) -> None:
    """The truth lies inside; each change leaves the support for the reason it should, with density −inf."""
    wide = {**UNBOUNDED, "c": Law("norm", {"scale": 500.0}), "Ks": Law("loguniform", lower=100.0, upper=1e8)}
    wide["phi"] = Law("norm", {"loc": 0.5, "scale": 0.5})
    density = posterior(make_study(drive=drive, priors=wide))
    x = np.array([[{**truth, **change}[name] for name in density.names]])
    assert density.reasons(x)[0] == reason
    assert np.isfinite(density.log_density(x)[0]) == (reason == INSIDE)


def test_every_code_has_words() -> None:
    """Whatever the models or the prior object to can be said."""
    assert set(REASONS) == {INSIDE, OUTSIDE_PRIOR, OUTSIDE_PHYSICS, *(int(s) for s in Status)}


def test_names_and_columns(make_study: MakeStudy) -> None:
    """Free soil parameters in the package's order, then estimated noise; another width is refused."""
    density = posterior(make_study(free=("phi", "Ks"), noise=MIXED_NOISE))
    assert density.names == ("Ks", "phi", "noise_resistance_moment")
    assert density.noise_values(np.array([[1.0, 2.0, 3.0]])).tolist() == [[3.0]]
    with pytest.raises(ValueError, match=r"'x' must have shape \(n, 3\) \(got \(1, 2\)\)"):
        density.log_density(np.array([[1.0, 2.0]]))


@pytest.fixture(scope="module")
def two(make_study: MakeStudy) -> Study:
    """Only c and φ are free; the prior of φ is bounded above by nothing but its own law."""
    phi = Law("norm", {"loc": 0.55, "scale": 0.05})
    return make_study(free=("c", "phi"), priors={"phi": phi, "c": Law("uniform", lower=0.0, upper=2000.0)})


def evidence_by_hand(study: Study, wheel: Wheel, truth: Mapping[str, float]) -> float:
    """Log evidence by quadrature on a grid of c and φ, from the models and scipy.stats alone."""
    c, phi = np.linspace(0.0, 2000.0, 161), np.linspace(0.2, 0.9, 281)
    cc, pp = (grid.ravel() for grid in np.meshgrid(c, phi, indexing="ij"))
    held = {name: value for name, value in truth.items() if name not in ("c", "phi")}
    soil = Soil(c=cc[:, None], phi=pp[:, None], **held)
    rows, model = study.observations, MODELS["M2"]()
    z = model.sinkage(soil, wheel, rows.slip, rows.load)
    forces = model.forces(soil, wheel, rows.slip, z)
    level = norm.logpdf(pp, 0.55, 0.05) - np.log(2000.0)
    for name, value in (
        ("sinkage", z),
        ("drawbar_pull", forces.drawbar_pull),
        ("resistance_moment", forces.resistance_moment),
    ):
        level = level + norm.logpdf(rows.values[name], value, study.noise[name].sd).sum(axis=1)
    top = level.max()
    surface = np.exp(level - top).reshape(len(c), len(phi))
    return float(top + np.log(np.trapezoid(np.trapezoid(surface, phi, axis=1), c)))


def test_density_holds_every_constant(two: Study, wheel: Wheel, truth: Mapping[str, float]) -> None:
    """The mean likelihood over prior draws, and exp(log density) over a grid, are the evidence by hand."""
    density, expected = posterior(two), evidence_by_hand(two, wheel, truth)
    x = density.prior.sample(100_000, np.random.default_rng(1))
    _, likelihood = density.log_prior_and_likelihood(x)
    weights = np.exp(likelihood - likelihood.max())
    mean, error = weights.mean(), weights.std() / np.sqrt(len(x))
    assert abs(np.log(mean) + likelihood.max() - expected) < 4 * error / mean
    c, phi = np.linspace(1.0, 1999.0, 200), np.linspace(0.2, 0.9, 281)
    grid = np.stack(np.meshgrid(c, phi, indexing="ij"), axis=-1).reshape(-1, 2)
    cell = (c[1] - c[0]) * (phi[1] - phi[0])
    assert logsumexp(density.log_density(grid)) + np.log(cell) == pytest.approx(expected, abs=0.02)


def test_density_of_a_single_point_needs_no_second_axis(two: Study) -> None:
    """One parameter set may be given flat."""
    density, x = posterior(two), np.array([300.0, 0.5])
    assert density.log_density(x).shape == (1,)
    assert density.log_density(x)[0] == density.log_density(x[None])[0]


def reasons_by_hand(study: Study, wheel: Wheel, soil: FloatArray) -> FloatArray:
    """Which support condition a soil (n, p) breaks, from its definition and forces at many sinkages."""
    slip, load = study.observations.slip, study.observations.load
    reasons, theta = np.zeros(len(soil), dtype=int), model_columns(soil, study.model)
    exponent = soil[:, 1:2] + soil[:, 2:3] * slip
    ratio = soil[:, 6:7] + soil[:, 7:8] * slip
    depth = np.linspace(1e-4, wheel.radius * (1 - 1e-9), 400)
    for i in range(len(soil)):
        outside = (ratio[i] <= soil[i, 8]) | (ratio[i] >= 1)
        if (outside & (exponent[i] > 0)).any():
            reasons[i] = Status.CONTACT_ANGLE
        elif (exponent[i] <= 0).any():
            reasons[i] = Status.EXPONENT
        else:
            carried = study.model.forces_at(
                np.repeat(theta[i : i + 1], len(depth), axis=0),
                Conditions.of(wheel, slip),
                np.repeat(depth[:, None], len(slip), axis=1),
            )[0][..., 0]
            reasons[i] = Status.LOAD if (carried.max(axis=0) < load).any() else INSIDE
    return reasons


def test_shares_of_the_prior_agree_with_counting(make_study: MakeStudy, wheel: Wheel) -> None:
    """Shares sum to one and are what direct counting finds, the support itself and every reason."""
    priors = {"n0": Law("uniform", lower=-0.5, upper=2.0), "Ks": Law("loguniform", lower=1e4, upper=1e7)}
    study = make_study(model="M2", priors=priors)
    density = posterior(study)
    draws = draw_cut_prior(density, 5000, np.random.default_rng(1))
    assert sum(draws.shares.values()) == pytest.approx(1.0, abs=1e-12)
    assert np.isfinite(density.log_density(draws.x)).all()
    soil = density.prior.soil_values(density.prior.sample(1500, np.random.default_rng(2)))
    counted = reasons_by_hand(study, wheel, soil)
    for code in (INSIDE, Status.EXPONENT, Status.CONTACT_ANGLE, Status.LOAD):
        share, expected = draws.shares[REASONS[code]], np.mean(counted == code)
        error = np.sqrt(share * (1 - share) * (1 / 1500 + 1 / draws.tried))
        assert abs(share - expected) < 4 * error, REASONS[code]


def test_cut_prior_draws_depend_on_the_stream_only(make_study: MakeStudy) -> None:
    """The same stream gives the same draws, and as many as were asked for."""
    density = posterior(make_study())
    first, again = (draw_cut_prior(density, 777, np.random.default_rng(3)).x for _ in range(2))
    assert first.shape == (777, 8)
    np.testing.assert_array_equal(first, again)


def test_a_prior_without_support_says_which_condition_fails(make_study: MakeStudy) -> None:
    """Where no parameter set can explain the conditions, the error names all reasons; the shares add up."""
    study = make_study(free=("n0", "c1"), priors={"c1": Law("uniform", lower=1.1, upper=2.0)})
    with pytest.raises(SupportError, match=r"no parameter set .* draws 100 %: θm outside \(θ2, θ1\)$"):
        draw_cut_prior(posterior(study), 100, np.random.default_rng(1))


def test_all_reasons_that_leave_no_support_are_named(make_study: MakeStudy) -> None:
    """Three conditions fail, the most frequent first, and their shares add up."""
    laws = {
        "n0": Law("norm", {"loc": -0.3, "scale": 0.3}),
        "phi": Law("norm", {"loc": 0.1, "scale": 0.1}),
        "c1": Law("uniform", lower=1.1, upper=2.0),
    }
    with pytest.raises(SupportError) as caught:
        draw_cut_prior(posterior(make_study(free=tuple(laws), priors=laws)), 100, np.random.default_rng(1))
    listed = re.findall(r"([\d.]+) %: (.+?)(?:, (?=[\d.]+ %: )|$)", str(caught.value))
    shares = [float(share) for share, _ in listed]
    assert {reason for _, reason in listed} == {
        REASONS[code] for code in (OUTSIDE_PHYSICS, Status.EXPONENT, Status.CONTACT_ANGLE)
    }
    assert shares == sorted(shares, reverse=True)
    assert min(shares) > 1.0
    assert sum(shares) == pytest.approx(100.0, abs=1e-9)
