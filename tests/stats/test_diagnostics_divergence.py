"""Divergence from draws against closed forms, ends of ranges included."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from bayesterra.stats.diagnostics import divergence

Draw = Callable[[Generator], FloatArray]
N = 4000
ENTROPY = 0.5 * np.log(2 * np.pi * np.e)
"""Of the standard normal law."""


def gauss(mean: float, sd: float) -> Draw:
    """Normal draws."""
    return lambda rng: rng.normal(mean, sd, N)


def flat(low: float, high: float) -> Draw:
    """Uniform draws."""
    return lambda rng: rng.uniform(low, high, N)


CASES: dict[str, tuple[Draw, Draw, float]] = {
    "the same normal law": (gauss(0, 1), gauss(0, 1), 0.0),
    "the same flat law": (flat(0, 1), flat(0, 1), 0.0),
    "a shifted narrower normal law": (gauss(1, 0.5), gauss(0, 1), np.log(2) + (0.25 + 1) / 2 - 0.5),
    "half of a flat law": (flat(0, 0.5), flat(0, 1), np.log(2)),
    "a normal law within a flat one": (gauss(0.5, 0.05), flat(0, 1), np.log(20) - ENTROPY),
    "half a normal law at the end of a flat one": (
        lambda rng: np.abs(rng.normal(0, 0.1, N)), flat(0, 1), np.log(20) - ENTROPY
    ),
    "a thousandth of the width": (gauss(0.5, 1e-3), flat(0, 1), np.log(1e3) - ENTROPY),
}  # fmt: skip


@pytest.mark.parametrize("case", CASES)
def test_divergence_is_the_closed_form(case: str) -> None:
    """The mean over 20 seeds is within 0.03 nats, and single values scatter no more than the error says."""
    draws, reference, truth = CASES[case]
    streams = [np.random.default_rng(seed) for seed in range(20)]
    found = np.array([divergence(draws(rng), reference(rng)) for rng in streams])
    assert found[:, 0].mean() == pytest.approx(truth, abs=0.03)
    assert found[:, 0].std() < 1.5 * found[:, 1].mean() + 0.005


def test_units_do_not_matter() -> None:
    """Divergence in Pa is that in kPa."""
    rng = np.random.default_rng(1)
    x, y = rng.normal(1, 0.5, N), rng.normal(0, 1, N)
    assert divergence(1e3 * x, 1e3 * y) == pytest.approx(divergence(x, y))


def test_repeated_draws_do_no_harm() -> None:
    """A walker that stood still once leaves the same value twice; the divergence hardly changes."""
    rng = np.random.default_rng(1)
    x, y = rng.normal(0, 0.3, N), rng.normal(0, 1, N)
    again = np.where(rng.random(N) < 0.1, np.roll(x, 1), x)
    assert divergence(again, y)[0] == pytest.approx(divergence(x, y)[0], abs=0.03)
