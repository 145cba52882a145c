"""Profiles against closed forms on linear and bent problems."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, cast

import numpy as np
import pytest
from scipy.optimize import lsq_linear

from bayesterra.arrays import FloatArray
from bayesterra.identifiability.profiles import LEVELS, Profile, Profiles, _Found, profiles
from bayesterra.identifiability.tracing import SOURCES, Traces, standing_out, trace
from bayesterra.likelihood.forward import Forward
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior
from bayesterra.likelihood.target import Target, chart
from bayesterra.models import M1, RANGES, SOIL_FIELDS, Conditions, ForwardModel
from bayesterra.parameters import SOIL_PARAMETERS
from bayesterra.stats.laws import Law
from bayesterra.study.drive import Drive
from bayesterra.study.noise import Noise
from bayesterra.study.observations import Observations
from bayesterra.study.priors import Prior

FORCES = ("normal_force", "drawbar_pull", "resistance_moment")


@dataclass(frozen=True)
class Toy:
    """A model whose three forces in every row are what a function of the nine soil parameters says."""

    values: Callable[[FloatArray], FloatArray]
    derivatives: Callable[[FloatArray], FloatArray]
    name: str = field(default="toy")
    parameters: ClassVar[tuple[str, ...]] = SOIL_FIELDS

    ranges: ClassVar[Mapping[str, tuple[float, float]]] = RANGES
    admits = ForwardModel.admits

    def limits(self, conditions: Conditions) -> Iterator[tuple[Mapping[str, float], float]]:
        """Those of the wheels' models at slip 0."""
        yield from M1().limits(conditions)

    def forces_at(self, theta: FloatArray, *_: Any, **__: Any) -> tuple[FloatArray, FloatArray]:
        """Forces (n, m, 3), all with an answer."""
        values = self.values(theta)
        return values, np.zeros(values.shape[:2], dtype=np.int8)

    def jacobian_at(self, theta: FloatArray, *_: Any) -> FloatArray:
        """Derivatives (n, m, 3, 10); sinkage does nothing."""
        return np.concatenate([self.derivatives(theta), np.zeros((*self.values(theta).shape, 1))], axis=3)


def toy_posterior(toy: Toy, laws: Mapping[str, Law], measured: FloatArray) -> Posterior:
    """Posterior of readings (m, 3) of a toy, of unit noise."""
    m = len(measured)
    size = np.ones(m)
    observations = Observations(
        wheel=("one",) * m, rows=tuple(range(1, m + 1)), slip=0 * size, load=np.nan * size,
        values={"sinkage": 0.01 * size, **dict(zip(FORCES, measured.T, strict=True))},
        given_sd={}, use=size > 0,
    )  # fmt: skip
    conditions = Conditions(0 * size, 0.15 * size, 0.15 * size, 0.01 * size, 0.15 * size)
    forward = Forward(cast(ForwardModel, toy), Drive.SINKAGE, conditions, 0.01 * size, as_read=True)
    held = {"Ks": 1e6, "n0": 1.0, "n1": 0.0, "c": 0.0, "phi": 0.5, "K": 0.01, "c1": 0.5, "c2": 0.0, "c3": 0.0}
    prior = Prior({**held, **laws})
    return Posterior(prior, Likelihood(forward, observations, [Noise(name, sd=1.0) for name in FORCES]))


def linear(laws: Mapping[str, Law], design: FloatArray, measured: FloatArray) -> Posterior:
    """Posterior of 3 m readings (3 m,) that are ``design`` (3 m, d) times the free parameters."""
    whole = np.zeros((len(design), len(SOIL_PARAMETERS)))
    whole[:, [SOIL_PARAMETERS.index(name) for name in laws]] = design
    shaped = whole.reshape(-1, 3, len(SOIL_PARAMETERS))
    toy = Toy(
        lambda theta: np.einsum("mcp,np->nmc", shaped, np.nan_to_num(theta)),
        lambda theta: np.repeat(shaped[None], len(theta), axis=0),
    )
    return toy_posterior(toy, laws, measured.reshape(-1, 3))


BOX = {
    "Ks": Law("uniform", {}, 1e5, 1e7), "n0": Law("uniform", {}, 0.1, 2.0),
    "n1": Law("uniform", {}, 0.0, 2.0), "c": Law("uniform", {}, 0.0, 5000.0),
    "phi": Law("uniform", {}, 0.1, 0.9), "K": Law("uniform", {}, 0.002, 0.05),
    "c1": Law("uniform", {}, 0.05, 0.95), "c2": Law("uniform", {}, -1.0, 1.0),
}  # fmt: skip


def ends_of(laws: Mapping[str, Law]) -> FloatArray:
    """Ranges (d, 2) of the laws."""
    return np.array([law.range for law in laws.values()])


def test_linear_gaussian_profiles_are_the_parabolas_of_the_covariance() -> None:
    """With eight coupled parameters well inside their ranges, 2 Δ log L = (θ − m)² / C_jj, to 1e-4."""
    rng, ends = np.random.default_rng(1), ends_of(BOX)
    width = np.diff(ends, axis=1)[:, 0]
    design = rng.normal(size=(24, 8)) * 12 / width
    centre = ends.mean(axis=1)
    found = profiles(linear(BOX, design, design @ centre), rng=np.random.default_rng(2))
    sd = np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    for i, profile in enumerate(found.found["likelihood"]):
        near = np.abs(profile.values - centre[i]) < 3 * sd[i]
        assert near.sum() >= 11
        expected = ((profile.values - centre[i]) / sd[i]) ** 2
        assert profile.rise[near] == pytest.approx(expected[near], abs=1e-4)
        for percent, level in LEVELS.items():
            reach = np.sqrt(level) * sd[i] * np.array([-1, 1])
            assert profile.interval(percent) == pytest.approx(centre[i] + reach, abs=2e-3 * sd[i])
        assert profile.shape == "two-sided"
        assert profile.trust == 1.0


def bounded_rise(design: FloatArray, measured: FloatArray, ends: FloatArray, held: int, value: float) -> float:
    """Least sum of squares inside the box with one parameter held, by bounded least squares."""
    others = np.arange(len(ends)) != held
    scale = np.diff(ends, axis=1)[:, 0]
    right = measured - design[:, held] * value - design[:, others] @ ends[others, 0]
    bounds = (np.zeros(others.sum()), np.ones(others.sum()))
    fit = lsq_linear(design[:, others] * scale[others], right, bounds, method="bvls", tol=1e-14)
    return float(2 * fit.cost)


@pytest.fixture(scope="module")
def mixed() -> tuple[Posterior, FloatArray, FloatArray, FloatArray]:
    """φ determined; c and n1 on a ridge; n0 pushed against its upper end; K without any effect."""
    names = ("n0", "n1", "c", "phi", "K")
    laws = {name: BOX[name] for name in names}
    ends = ends_of(laws)
    unit = np.array([[3.0, 0, 0, 0, 0], [0, 30.0, 30.0, 0, 0], [0, 0, 0, 40.0, 0], [0, 1.5, -1.5, 5.0, 0]])
    design = np.vstack([unit, np.zeros((2, 5))]) / np.diff(ends, axis=1)[:, 0]
    truth = ends[:, 0] + np.array([1.2, 0.5, 0.5, 0.5, 0.5]) * np.diff(ends, axis=1)[:, 0]
    measured = design @ truth
    return linear(laws, design, measured), design, measured, ends


@pytest.fixture(scope="module")
def mixed_profiles(mixed: tuple[Posterior, FloatArray, FloatArray, FloatArray]) -> Profiles:
    """Profiles of the mixed problem."""
    return profiles(mixed[0], rng=np.random.default_rng(3))


def test_profiles_inside_the_box_are_bounded_least_squares(
    mixed: tuple[Posterior, FloatArray, FloatArray, FloatArray], mixed_profiles: Profiles
) -> None:
    """Flat directions, ridges and bounds: every point is the bounded least squares fit, to 1e-4."""
    _, design, measured, ends = mixed
    for i, profile in enumerate(mixed_profiles.found["likelihood"]):
        squares = np.array([bounded_rise(design, measured, ends, i, value) for value in profile.values])
        least = min(squares.min(), float(2 * lsq_linear(design, measured, ends.T, tol=1e-14).cost))
        assert profile.rise == pytest.approx(squares - least, abs=2e-4, rel=1e-4)


def test_classes_name_flat_one_sided_two_sided_and_bounded(mixed_profiles: Profiles) -> None:
    """Each of the four words where it belongs, with open interval ends where nothing is crossed."""
    shapes = {profile.name: profile.shape for profile in mixed_profiles.found["likelihood"]}
    assert shapes == {
        "n0": "one-sided",
        "n1": "bounded only by the prior",
        "c": "bounded only by the prior",
        "phi": "two-sided",
        "K": "flat",
    }
    low, high = mixed_profiles.profile("n0").crossings(95)
    assert low > 0.1
    assert np.isnan(high)
    assert mixed_profiles.profile("n0").interval(95) == (low, 2.0)


def test_the_path_says_what_compensates_what(mixed_profiles: Profiles) -> None:
    """Along the ridge c and n1 move against each other by as much; what has no effect moves with nothing."""
    moves = mixed_profiles.compensation()
    assert moves.to_numpy()[1, 2] == pytest.approx(-moves.to_numpy()[1, 1], rel=0.05)
    assert moves.loc["K"].drop("K").abs().max() < 0.02
    assert moves["K"].drop("K").abs().max() < 0.02
    assert moves.loc["K", "K"] == pytest.approx(np.sqrt(12), rel=0.05)
    table = mixed_profiles.table.set_index(["kind", "parameter"])
    assert str(table.loc[("likelihood", "n1"), "compensated_by"]).startswith("c −")
    assert table.loc[("likelihood", "K"), "compensated_by"] == ""


def test_a_bent_ridge_is_followed_to_its_ends() -> None:
    """On the banana n0 = 1 + φ-parabola the profiles of both are the closed form."""
    laws = {"n0": BOX["n0"], "phi": Law("uniform", {}, 0.1, 0.9)}
    bend, across, along = 6.0, 100.0, 4.0

    def forces(theta: FloatArray) -> FloatArray:
        n0, phi = theta[:, 1], theta[:, 4]
        off = across * (n0 - 0.3 - bend * (phi - 0.5) ** 2)
        return np.stack([off, along * (phi - 0.5), 0 * off], axis=1)[:, None, :]

    def slopes(theta: FloatArray) -> FloatArray:
        out = np.zeros((len(theta), 1, 3, 9))
        out[:, 0, 0, 1] = across
        out[:, 0, 0, 4] = -2 * across * bend * (theta[:, 4] - 0.5)
        out[:, 0, 1, 4] = along
        return out

    found = profiles(toy_posterior(Toy(forces, slopes), laws, np.zeros((1, 3))), rng=np.random.default_rng(4))
    phi, n0 = found.profile("phi"), found.profile("n0")
    assert phi.rise == pytest.approx((along * (phi.values - 0.5)) ** 2, abs=1e-3)
    assert phi.path[:, 0] == pytest.approx(0.3 + bend * (phi.values - 0.5) ** 2, abs=1e-3)
    arm = (n0.values > 0.35) & (n0.values < 1.2)
    assert n0.rise[arm] == pytest.approx(along**2 * (n0.values[arm] - 0.3) / bend, abs=0.02)


def test_a_valley_apart_from_the_mode_is_found() -> None:
    """Of two valleys that nothing joins, n0 at 0.5 and at 1.5, the profile of φ follows the lower one."""
    laws = {"n0": BOX["n0"], "phi": Law("uniform", {}, 0.1, 0.9)}
    wall, along = 3000.0, 20.0

    def forces(theta: FloatArray) -> FloatArray:
        n0, phi = theta[:, 1], theta[:, 4]
        off = wall * (n0 - 0.5) * (n0 - 1.5)
        return np.stack([off, along * (phi - 0.1 - 0.4 * n0), 0 * off], axis=1)[:, None, :]

    def slopes(theta: FloatArray) -> FloatArray:
        out = np.zeros((len(theta), 1, 3, 9))
        out[:, 0, 0, 1] = wall * (2 * theta[:, 1] - 2.0)
        out[:, 0, 1, 1], out[:, 0, 1, 4] = -0.4 * along, along
        return out

    density = toy_posterior(Toy(forces, slopes), laws, np.zeros((1, 3)))
    phi = profiles(density, rng=np.random.default_rng(4)).profile("phi")
    lower = np.minimum((along * (phi.values - 0.3)) ** 2, (along * (phi.values - 0.7)) ** 2)
    assert phi.rise == pytest.approx(lower, abs=1e-3)
    assert phi.pieces == 2


def test_a_prior_adds_to_the_posterior_profile_only() -> None:
    """A normal prior multiplies a normal likelihood; the likelihood's profile does not know of it."""
    laws = {"phi": Law("norm", {"loc": 0.5, "scale": 0.05}, 0.1, 0.9)}
    design = np.array([[20.0], [0.0], [0.0]])
    found = profiles(linear(laws, design, design @ np.array([0.6])), rng=np.random.default_rng(5))
    likelihood, both = (found.profile("phi", kind) for kind in ("likelihood", "posterior"))
    assert likelihood.interval(68) == pytest.approx(0.6 + 0.05 * np.sqrt(0.99) * np.array([-1, 1]), abs=1e-4)
    sd = 0.05 / np.sqrt(2)
    assert both.interval(95) == pytest.approx(0.55 + sd * np.sqrt(3.84) * np.array([-1, 1]), abs=1e-4)


def test_a_point_above_the_profile_is_told() -> None:
    """``gain`` is how much the best point of all profiles lies above what was given as known."""
    laws = {"phi": BOX["phi"]}
    design = np.array([[20.0], [0.0], [0.0]])
    density = linear(laws, design, design @ np.array([0.6]))
    for known, gain in ((0.6, 0.0), (0.7, 2.0)):
        found = profiles(density, rng=np.random.default_rng(6), references=np.array([[known]]))
        assert found.gain["likelihood"] == pytest.approx(gain, abs=1e-4)


def made(rise: list[float], agreeing: list[int]) -> Profile:
    """A profile with given heights at 0, 1, 2, ..."""
    count = len(rise)
    path = np.arange(float(count))[:, None]
    tried = np.full(count, 7)
    failed = np.zeros(count, dtype=np.bool_)
    return Profile("n0", "likelihood", path[:, 0], np.array(rise), path, np.array(agreeing), tried, failed)


def test_separate_intervals_are_counted_and_their_outer_ends_taken() -> None:
    """Two valleys below the 95 % threshold are two pieces; the interval spans both."""
    profile = made([16.0, 1.0, 9.0, 0.0, 1.0, 16.0], [7] * 6)
    assert profile.pieces == 2
    low, high = profile.interval(95)
    assert (low, high) == pytest.approx(((4 - np.sqrt(3.84)) / 3, 4 + (np.sqrt(3.84) - 1) / 3))
    assert profile.shape == "two-sided"
    assert profile.best == 3.0


def test_an_end_of_what_is_possible_is_no_crossing() -> None:
    """Where the next point is impossible the profile is open; its interval ends at the last possible one."""
    profile = made([np.inf, 2.0, 0.0, 9.0], [7] * 4)
    assert np.isnan(profile.crossings(95)[0])
    assert profile.interval(95)[0] == 1.0
    assert profile.shape == "one-sided"


def test_trust_is_the_share_of_confirmed_points_that_matter() -> None:
    """Points that one descent alone reached count against a profile, unless they lie far above."""
    assert made([0.0, 1.0, 4.0, 7.0, 50.0], [7, 2, 1, 1, 1]).trust == 0.5


def test_nothing_is_read_off_a_point_that_failed() -> None:
    """Neither a spike that one descent alone reached nor a hole beside the threshold moves an interval."""
    whole = made([16.0, 1.0, 0.0, 1.0, 16.0], [7] * 5)
    spiked = replace(
        made([16.0, 1.0, 4.2, 0.0, 1.0, np.inf, 16.0], [7, 7, 1, 7, 7, 0, 7]),
        values=np.array([0.0, 1.0, 1.5, 2.0, 3.0, 3.5, 4.0]),
        failed=np.array([False, False, True, False, False, True, False]),
    )
    assert spiked.interval(95) == pytest.approx(whole.interval(95))
    assert (spiked.shape, spiked.pieces, spiked.trust) == ("two-sided", 1, 1.0)
    column, minus = np.zeros(7, dtype=np.int64), 0.5 * spiked.rise
    assert standing_out(column, minus).tolist() == spiked.failed.tolist()
    assert not standing_out(column, np.append([np.inf], minus[1:])).tolist()[0]


def traced() -> Traces:
    """Traces of two parameters, φ and n0, of a linear problem."""
    laws = {name: BOX[name] for name in ("phi", "n0")}
    design = np.array([[20.0, 5.0], [0.0, 9.0], [3.0, 1.0]])
    density = linear(laws, design, design @ np.array([0.6, 1.0]))
    target = Target(density, chart(density), False, anchor=np.full(2, 0.5))
    starts = np.random.default_rng(4).random((50, 2))
    return trace(target, starts, levels=[0.5, 1.92], rng=np.random.default_rng(5))


def test_points_that_no_descent_solved_are_marked() -> None:
    """A hole, and a spike that one descent alone reached; one that two agree on belongs to the profile."""
    traces = traced()
    own = np.flatnonzero(traces.column == 1)
    hole, alone, agreed = own[[3, 7, 11]]
    traces.value[hole], traces.y[hole] = np.inf, 0.0
    for spike, count in ((alone, 1), (agreed, 2)):
        traces.y[spike, 0] = 0.99 if traces.y[spike, 0] < 0.5 else 0.01
        traces.value[spike] = -traces.target.log_density(traces.y[spike][None])[0]
        traces.witnesses[spike] = np.append(np.full(count, traces.value[spike]), np.full(SOURCES - count, np.nan))
    first, second = _Found.of(("phi", "n0"), "likelihood", traces.target, traces, traces.y[:0]).profiles
    assert np.flatnonzero(second.failed).tolist() == [3, 7]
    assert not first.failed.any()


def test_points_that_stand_out_are_tried_from_between_their_neighbours() -> None:
    """A hole and a spike in a profile are gone once it has settled; the other points stay."""
    traces = traced()
    right, y = traces.value.copy(), traces.y.copy()
    assert not standing_out(traces.column, right).any()
    hole = np.flatnonzero(traces.column == 0)[4]
    spike = np.flatnonzero(traces.column == 1)[right[traces.column == 1].argmin()]
    traces.value[hole], traces.y[hole] = np.inf, 0.0
    traces.value[spike] += 3.0
    traces.improved[:] = False
    traces.settle()
    assert traces.value == pytest.approx(right, abs=1e-3)
    assert traces.y == pytest.approx(y, abs=1e-2)
