"""Sobol indices and Shapley effects where they are known in closed form."""

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd
import pytest
from numpy.random import Generator
from sensitivity.problems import Problem, draw_base, partners
from sensitivity.shapley import shapley
from sensitivity.sobol import closed_index, sobol, total_index

from bayesterra.arrays import BoolArray, FloatArray

Draw = Callable[[int, Generator], FloatArray]


def problem(
    inputs: Mapping[str, tuple[int, ...]],
    draw: Draw,
    function: Callable[[FloatArray], FloatArray],
    inside: Callable[[FloatArray], BoolArray] | None = None,
) -> Problem:
    """A problem with outputs named by number."""
    count = function(draw(1, np.random.default_rng(0))).shape[1]

    def answer(x: FloatArray) -> tuple[FloatArray, BoolArray]:
        return function(x), np.ones(len(x), dtype=np.bool_) if inside is None else inside(x)

    return Problem(inputs, pd.DataFrame({"output": np.arange(count)}), draw, answer)


def uniform(d: int, low: float = 0.0, high: float = 1.0) -> Draw:
    """Draws of d independent uniform inputs."""
    return lambda n, rng: rng.uniform(low, high, size=(n, d))


def within(value: FloatArray, error: FloatArray, expected: FloatArray | list[float]) -> bool:
    """Whether estimates are within four standard errors of what is expected."""
    return bool((np.abs(value - np.asarray(expected)) < 4 * error + 1e-9).all())


def ishigami(x: FloatArray) -> FloatArray:
    """The function of Ishigami and Homma with a = 7, b = 0.1, and one output that does not vary."""
    y = np.sin(x[:, 0]) + 7 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])
    return np.column_stack([y, np.ones(len(x))])


SINGLE = {"x1": (0,), "x2": (1,), "x3": (2,)}


def test_ishigami() -> None:
    """First-order and total indices of the Ishigami function are those in closed form."""
    found = sobol(problem(SINGLE, uniform(3, -np.pi, np.pi), ishigami), 20_000, np.random.default_rng(3))
    assert within(found.first[:, 0], found.first_error[:, 0], [0.3139, 0.4424, 0.0])
    assert within(found.total[:, 0], found.total_error[:, 0], [0.5576, 0.4424, 0.2437])
    assert found.first_error[:, 0].max() < 0.01
    assert found.accepted == 1.0
    assert found.unmatched == 0.0


def test_output_that_does_not_vary() -> None:
    """An output that does not vary has no indices: NaN, without a warning."""
    found = sobol(problem(SINGLE, uniform(3, -np.pi, np.pi), ishigami), 100, np.random.default_rng(3))
    assert np.isnan(found.first[:, 1]).all()
    assert found.table["total"].isna().sum() == 3


def test_additive_linear_model() -> None:
    """In an additive model both indices and the Shapley effect are the input's share of the variance."""
    weights = np.array([3.0, 2.0, 1.0])
    linear = problem(SINGLE, uniform(3), lambda x: x @ weights[:, None])
    shares = weights**2 / (weights**2).sum()
    found, effects = (sobol(linear, 8192, np.random.default_rng(4)), shapley(linear, 8192, np.random.default_rng(4)))
    assert within(found.first[:, 0], found.first_error[:, 0], shares.tolist())
    assert within(found.total[:, 0], found.total_error[:, 0], shares.tolist())
    assert within(effects.effect[:, 0], effects.error[:, 0], shares.tolist())
    assert found.mean[0] == pytest.approx(3.0, abs=0.05)
    assert found.sd[0] == pytest.approx(np.sqrt(14 / 12), abs=0.03)


def test_errors_are_honest() -> None:
    """Over 200 repetitions the spread of each estimate is its standard error within a fifth."""
    small = problem(SINGLE, uniform(3, -np.pi, np.pi), lambda x: ishigami(x)[:, :1])
    runs = [sobol(small, 500, np.random.default_rng(seed)) for seed in range(200)]
    for name in ("first", "total"):
        spread = np.std([getattr(run, name) for run in runs], axis=0)
        stated = np.mean([getattr(run, f"{name}_error") for run in runs], axis=0)
        np.testing.assert_allclose(stated, spread, rtol=0.2)


def test_shapley_errors_are_honest() -> None:
    """The same holds for Shapley effects, whose subsets share base draws (five inputs, to a tenth)."""
    names = {f"x{i}": (i,) for i in range(5)}
    total = problem(names, uniform(5), lambda x: x.sum(axis=1, keepdims=True))
    runs = [shapley(total, 500, np.random.default_rng(seed)) for seed in range(100)]
    spread = np.sqrt(np.var([run.effect for run in runs], axis=0).mean())
    assert np.mean([run.error for run in runs]) == pytest.approx(spread, rel=0.1)
    np.testing.assert_allclose([run.effect.sum() for run in runs], 1.0)


def test_correlated_inputs_as_one() -> None:
    """Two inputs with correlation 0.8 taken as one hold 3.6 of 4.6 of the variance of a sum of three."""

    def draw(n: int, rng: Generator) -> FloatArray:
        z = rng.standard_normal((n, 3))
        z[:, 1] = 0.8 * z[:, 0] + 0.6 * z[:, 1]
        return z

    grouped = problem({"x1, x2": (0, 1), "x3": (2,)}, draw, lambda x: x.sum(axis=1, keepdims=True))
    found = sobol(grouped, 8192, np.random.default_rng(5))
    expected = [3.6 / 4.6, 1.0 / 4.6]
    assert within(found.first[:, 0], found.first_error[:, 0], expected)
    assert within(found.total[:, 0], found.total_error[:, 0], expected)


def triangle() -> Problem:
    """x1 and x2 uniform where x1 + x2 < 1, and x1 + 2 x2."""
    return problem(
        {"x1": (0,), "x2": (1,)}, uniform(2), lambda x: x @ np.array([[1.0], [2.0]]), lambda x: x.sum(axis=1) < 1
    )


def test_inputs_joined_by_a_cut() -> None:
    """On a triangle the indices of dependent inputs are exact: 0 and 3/4 first, 1/4 and 1 in total."""
    found = sobol(triangle(), 20_000, np.random.default_rng(6))
    assert within(found.first[:, 0], found.first_error[:, 0], [0.0, 0.75])
    assert within(found.total[:, 0], found.total_error[:, 0], [0.25, 1.0])
    assert found.accepted == pytest.approx(0.5, abs=0.02)


def test_shapley_effects_on_the_triangle() -> None:
    """On the triangle the Shapley effects are 1/8 and 7/8."""
    found = shapley(triangle(), 20_000, np.random.default_rng(7))
    assert within(found.effect[:, 0], found.error[:, 0], [0.125, 0.875])
    assert list(found.table["input"]) == ["x1", "x2"]


def test_partners_follow_the_conditional_law() -> None:
    """Partners that share x1 are uniform on [0, 1 − x1], however little room is left."""
    cut = problem({"x1": (0,), "x2": (1,)}, uniform(2), lambda x: x, lambda x: x.sum(axis=1) < 1)
    rng = np.random.default_rng(8)
    base = draw_base(cut, 20_000, rng)
    found = partners(cut, base, np.array([True, False]), rng)
    room = found[:, 1] / (1.0 - base.x[:, 0])
    np.testing.assert_array_equal(found[:, 0], base.x[:, 0])
    np.testing.assert_allclose(np.quantile(room, [0.1, 0.5, 0.9]), [0.1, 0.5, 0.9], atol=0.015)
    narrow = base.x[:, 0] > 0.95
    assert room[narrow].mean() == pytest.approx(0.5, abs=4 * 0.29 / np.sqrt(narrow.sum()))


def test_pairs_that_are_missing_are_left_out() -> None:
    """Indices of pairs with gaps are those of the pairs that are left."""
    rng = np.random.default_rng(9)
    values = rng.normal(size=(500, 1))
    others = 0.6 * values + 0.8 * rng.normal(size=(500, 1))
    gappy = np.where(np.arange(500)[:, None] % 5 == 0, np.nan, others)
    kept = ~np.isnan(gappy[:, 0])
    for index in (closed_index, total_index):
        ours, theirs = index(values, gappy), index(values[kept], others[kept])
        np.testing.assert_allclose(ours.value, theirs.value)
        np.testing.assert_allclose(ours.error, theirs.error)


def test_impossible_requests_are_refused() -> None:
    """A cut that leaves nothing, a sample of one, and too many subsets are refused in words."""
    rng = np.random.default_rng(1)
    empty = problem({"x1": (0,)}, uniform(1), lambda x: x, lambda x: x[:, 0] > 2)
    with pytest.raises(ValueError, match=r"the cut must leave more than one draw in 50000 \(got 0 of"):
        sobol(empty, 1000, rng)
    with pytest.raises(ValueError, match=r"'n' must be at least 2 \(got 1\)"):
        sobol(empty, 1, rng)
    many = problem({f"x{i}": (i,) for i in range(11)}, uniform(11), lambda x: x)
    with pytest.raises(ValueError, match=r"'inputs' must be at most 10.*\(got 11\)"):
        shapley(many, 100, rng)
