"""Steps inside linear inequalities against bounded least squares, and exact slopes against differences."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import lsq_linear

from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.likelihood.target import Target, chart
from bayesterra.models import Wheel
from bayesterra.stats.laws import Law
from bayesterra.stats.optimiser import steps
from bayesterra.study.noise import Noise
from bayesterra.study.priors import Tie
from bayesterra.study.study import Study

SIZE = 5


@pytest.mark.parametrize("held", [-1, 2])
def test_steps_minimise_inside_the_box(held: int) -> None:
    """200 ill-conditioned problems that touch edges: inside, and as low as bounded least squares."""
    rng, n = np.random.default_rng(1), 200
    root = rng.normal(size=(n, SIZE, SIZE)) * 10.0 ** rng.uniform(-1.5, 1.5, size=(n, 1, SIZE))
    curvature, slope = root.swapaxes(1, 2) @ root + 1e-4 * np.eye(SIZE), 10 * rng.normal(size=(n, SIZE))
    rows = np.vstack([np.eye(SIZE), -np.eye(SIZE)])
    slack = rng.uniform(0, 1, size=(n, 2 * SIZE)) * (rng.random((n, 2 * SIZE)) > 0.2)
    shift = np.zeros(n) if held < 0 else 0.5 * slack[:, held]
    others = np.arange(SIZE) != held
    moves, mask = np.where(others, 0.0, shift[:, None]), np.tile(~others, (n, 1))
    found = steps(curvature, slope, rows=rows, slack=slack, held=mask, shift=moves)
    assert (found @ rows.T <= slack + 1e-9).all()
    for i in range(n):
        p = found[i]
        given = np.where(others, 0.0, shift[i])
        factor = np.linalg.cholesky(curvature[i][np.ix_(others, others)])
        right = (slope[i] + curvature[i] @ given)[others]
        limits = (-slack[i, SIZE:][others] - 1e-10, slack[i, :SIZE][others] + 1e-10)
        best = lsq_linear(factor.T, -np.linalg.solve(factor, right), limits, method="bvls", tol=1e-14).x
        best = given + np.insert(best, held, 0.0) if held >= 0 else best
        levels = [0.5 * q @ curvature[i] @ q + slope[i] @ q for q in (p, best)]
        assert levels[0] <= levels[1] + 1e-6 * (1 + abs(levels[1]))
        if held >= 0:
            assert p[held] == shift[i]


def test_an_entry_held_just_outside_leaves_the_others_in_place() -> None:
    """Rounding may hold an entry a hair beyond its edge: the others step as if it lay on it."""
    curvature = np.array([[[2.0, 0.3, 0.1], [0.3, 1.0, 0.9], [0.1, 0.9, 1.0]]])
    slope, rows = np.array([[0.1, -1.0, 0.2]]), np.vstack([np.eye(3), -np.eye(3)])
    slack = np.array([[0.0, 0.5, 0.7, 1.0, 0.5, 0.3]])
    first = np.array([[True, False, False]])
    found = [
        steps(curvature, slope, rows=rows, slack=slack, held=first, shift=np.array([[shift, 0.0, 0.0]]))
        for shift in (0.0, 5e-10)
    ]
    np.testing.assert_allclose(found[0], [[0.0, 0.5, -0.3]], atol=1e-8)
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)


BENT = {
    "weights": [0.4, 0.35, 0.25],
    "means": [[-1.0, 0.8, 0.0], [0.0, -0.7, 0.2], [1.1, 0.6, -0.3]],
    "covariances": [
        [[0.4, -0.3, 0.1], [-0.3, 0.3, 0.0], [0.1, 0.0, 1.0]],
        [[0.3, 0.0, 0.0], [0.0, 0.05, 0.02], [0.0, 0.02, 0.7]],
        [[0.4, 0.3, 0.1], [0.3, 0.3, 0.05], [0.1, 0.05, 0.9]],
    ],
}
"""A mixture of scores along a ridge that bends."""


def study(drive: str, dependence: dict[str, Any] | None = None, **options: Any) -> Study:
    """Four rows of two wheels of different width, with noise of every kind."""
    wheels = {"narrow": Wheel(0.157, 0.165, 0.01, 30, 0.65), "wide": Wheel(0.157, 0.28, 0.01, 30, 0.65)}
    data: dict[str, list[Any]] = {
        "wheel": ["narrow", "wide", "narrow", "wide"],
        "slip": [0.1, 0.2, 0.35, 0.5],
        "load [N]": [80.0] * 4,
        "normal_force [N]": [80.0] * 4,
        "sinkage [mm]": [10.0, 11.0, 14.0, np.nan],
        "sinkage_sd [mm]": [1.0, np.nan, 2.0, np.nan],
        "drawbar_pull [N]": [5.0, 10.0, 12.0, 14.0],
        "resistance_moment [N m]": [5.0, 6.0, 7.0, 7.5],
    }
    if drive == "sinkage":
        data["sinkage [mm]"] = [10.0, 11.0, 14.0, 15.0]
    unused = {"load": ["normal_force [N]"], "sinkage": ["load [N]", "sinkage_sd [mm]"], "both": ["load [N]"]}
    noise: dict[str, float | Noise] = {
        "sinkage": 1e-3,
        "normal_force": 2.0,
        "drawbar_pull": Noise("drawbar_pull", law=Law("loguniform", {}, 0.1, 10.0)),
        "resistance_moment": Noise("resistance_moment", fraction=0.1, floor=0.6, dof=5.0),
    }
    if drive == "load":
        del noise["normal_force"]
    if drive == "sinkage":
        del noise["sinkage"]
    table = pd.DataFrame({name: column for name, column in data.items() if name not in unused[drive]})
    priors = {
        "set": "planetary",
        "kc": Law("uniform", {}, -1e4, 1e5),
        "kphi": Law("uniform", {}, 1e6, 3e6),
        "c2": Tie("n1"),
        "n1": Law("uniform", {}, 0.0, 0.5),
        "sinkage_offset": Law("norm", {"loc": 0.0, "scale": 1e-3}),
        **(dependence or {}),
    }
    return Study(table, wheels, slip_reference="shearing", drive=drive, noise=noise, priors=priors, **options)


@pytest.mark.parametrize(
    ("drive", "dependence"),
    [
        ("load", {}),
        ("load", {"correlation": {"c, phi": -0.8, "phi, K": 0.5, "kc, kphi": -0.9}}),
        ("load", {"correlation": {"kc, kphi": -0.9}, "mixture": {"phi, c, K": BENT}}),
        ("sinkage", {}),
        ("both", {}),
    ],
)
def test_slopes_are_those_of_the_density(drive: str, dependence: dict[str, Any]) -> None:
    """Moduli, ties, noise of every kind, correlated and bent laws: slopes are those of the log density."""
    options: dict[str, Any] = {"load_range": (20.0, 200.0)} if drive == "both" else {}
    density = posterior(study(drive, dependence, **options))
    scaled = chart(density)
    y = scaled.from_physical(draw_cut_prior(density, 20, np.random.default_rng(1)).x)
    target = Target(density, scaled, with_prior=True, anchor=np.full(y.shape[1], 0.5))
    local, step = target.local(y), 1e-6 if drive != "both" else 1e-3
    for i, unit in enumerate(np.eye(y.shape[1])):
        with np.errstate(invalid="ignore"):
            expected = (target.value(y + step * unit) - target.value(y - step * unit)) / (2 * step)
        inside = np.isfinite(expected)
        size = np.sqrt(local.curvature[:, i, i])
        assert inside.sum() >= 15
        tolerance = 1e-3 if drive != "both" else 0.02
        assert (np.abs(local.slope[:, i] - expected) < tolerance * (size + np.abs(expected)))[inside].all()


def test_the_support_is_inside_the_inequalities() -> None:
    """All draws from the cut prior satisfy them; those of the stated prior that do not have no density."""
    density = posterior(study("load"))
    scaled = chart(density)
    x = draw_cut_prior(density, 500, np.random.default_rng(2)).x
    y = scaled.from_physical(x)
    assert (scaled.slack(y) >= 0).all()
    assert scaled.to_physical(y) == pytest.approx(x)
    stated = density.prior.quantile(np.random.default_rng(3).uniform(1e-3, 1 - 1e-3, (500, y.shape[1])))
    outside = (scaled.slack(scaled.from_physical(stated)) < 0).any(axis=1)
    assert (density.log_density(stated[outside]) == -np.inf).all()
    assert outside.any()
