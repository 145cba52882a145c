"""Mutual information by both estimators against closed forms, and the coupling of a real study."""

import numpy as np
import pytest
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from bayesterra.identifiability.information import (
    Coupling,
    copula_information,
    coupling,
    disagree,
    nearest_information,
    strength,
    whitened,
)
from bayesterra.identifiability.verdicts import ranked
from bayesterra.likelihood.posterior import posterior
from bayesterra.study.result import Result


@pytest.fixture
def rng() -> Generator:
    """Seeded afresh for every test."""
    return np.random.default_rng(1)


@pytest.fixture(scope="module")
def found(small_result: Result) -> Coupling:
    """The coupling in a short run on the shipped HIT study."""
    target = posterior(small_result.study)
    prior, draws = small_result.values("prior"), small_result.values()
    return coupling(target, prior, draws, np.random.default_rng(1))


def normal(covariance: FloatArray, n: int, rng: Generator) -> FloatArray:
    """Normal draws (n, d)."""
    return np.asarray(rng.standard_normal((n, len(covariance))) @ np.linalg.cholesky(covariance).T)


@pytest.mark.parametrize("rho", [0.0, 0.3, -0.7, 0.95])
def test_both_estimates_of_a_normal_pair_are_the_closed_form(rho: float, rng: Generator) -> None:
    """Mutual information is −½ log(1 − ρ²), whatever monotone scale the two are stated in."""
    x = normal(np.array([[1.0, rho], [rho, 1.0]]), 4000, rng)
    truth = -0.5 * np.log(1.0 - rho**2)
    scores = ranked(np.column_stack([np.exp(x[:, 0]), x[:, 1] ** 3]))
    assert copula_information(scores[:, :1], scores[:, 1:]) == pytest.approx(truth, abs=0.05)
    value, error = nearest_information(scores[:2000, :1], scores[:2000, 1:])
    assert value == pytest.approx(truth, abs=4 * error)
    assert error < 0.03


def test_groups_have_the_information_of_their_blocks(rng: Generator) -> None:
    """Two normal groups: ½ log(|Σ_A| |Σ_B| / |Σ|), found also through strong coupling within a group."""
    root = rng.standard_normal((5, 5))
    covariance = root @ root.T + 0.3 * np.eye(5)
    x = normal(covariance, 4000, rng)
    blocks = np.linalg.det(covariance[:3, :3]) * np.linalg.det(covariance[3:, 3:])
    truth = 0.5 * np.log(blocks / np.linalg.det(covariance))
    scores = ranked(x)
    assert copula_information(scores[:, :3], scores[:, 3:]) == pytest.approx(truth, abs=0.08)
    value, _ = nearest_information(whitened(x[:2000, :3]), whitened(x[:2000, 3:]))
    assert value == pytest.approx(truth, abs=0.12)


def test_a_bent_ridge_is_found_by_neighbours_only(rng: Generator) -> None:
    """A parabola has no correlation: the copula reads nothing, neighbours much, and they disagree."""
    x = rng.standard_normal(2000)
    scores = ranked(np.column_stack([x, x**2 + 0.3 * rng.standard_normal(2000)]))
    figure = copula_information(scores[:, :1], scores[:, 1:])
    check, error = nearest_information(scores[:, :1], scores[:, 1:])
    assert figure < 0.01
    assert check > 0.5
    assert disagree(figure, check, error)


def test_estimates_that_agree_are_not_flagged() -> None:
    """A small difference, one within three errors, or one below a quarter of both is none."""
    assert not disagree(0.0, 0.09, 0.001)
    assert not disagree(0.0, 0.2, 0.07)
    assert not disagree(2.0, 2.4, 0.01)
    assert disagree(2.0, 2.9, 0.01)


def test_strength_is_the_correlation_behind_the_information() -> None:
    """A normal pair's information leads back to its correlation; a negative estimate to none."""
    assert strength(-0.5 * np.log(1 - 0.6**2)) == pytest.approx(0.6)
    assert strength(-0.02) == 0.0


def test_every_pair_and_every_pair_of_groups_has_a_row(found: Coupling) -> None:
    """Eight parameters make 28 pairs, three groups make three."""
    assert len(found.pairs) == 28
    assert list(found.groups) == ["P_I", "P_II", "P_III"]
    assert found.between[["first", "second"]].to_numpy().tolist() == [
        ["P_I", "P_II"], ["P_I", "P_III"], ["P_II", "P_III"]
    ]  # fmt: skip
    assert not found.pairs.isna().any(axis=None)


def test_the_cut_alone_couples_c1_to_c2(found: Coupling) -> None:
    """The cut prior's correlation of c1 with c2 is −0.64; no other pair has one."""
    pairs = found.pairs.set_index(["first", "second"])
    assert pairs["prior_pearson"][("c1", "c2")] == pytest.approx(-0.64, abs=0.04)
    assert pairs.drop(("c1", "c2"))["prior_strength"].max() < 0.1
    assert found.between["prior_strength"].max() < 0.15


def test_both_estimates_see_the_ridges_of_the_study(found: Coupling) -> None:
    """φ with K and c, and K_s with n0, are coupled far beyond chance under both estimates."""
    pairs = found.pairs.set_index(["first", "second"])
    for pair in (("phi", "K"), ("c", "phi"), ("Ks", "n0")):
        assert pairs["information"][pair] > 100 * pairs["null"][pair]
        assert pairs["nearest"][pair] > 10 * pairs["nearest_null"][pair]


def test_chance_is_what_permutation_gives(found: Coupling) -> None:
    """The 95 % point of n independent pairs is that of χ²₁/(2n); the groups' has more degrees of freedom."""
    draws = 3.84 / 2 / found.pairs["null"]
    assert draws.between(2500, 6000).all()
    assert (found.between["null"] > 2 * found.pairs["null"].iloc[0]).all()
    assert found.pairs["nearest_null"].between(0.0, 0.05).all()
