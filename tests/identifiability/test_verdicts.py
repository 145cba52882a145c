"""Words for contraction and coupling, on draws made up to have them."""

from collections.abc import Callable

import numpy as np
import pytest

from bayesterra.arrays import FloatArray
from bayesterra.identifiability.verdicts import (
    COUPLED_TO_ALL,
    DETERMINED,
    MOVED,
    SHIFT,
    STRUCTURAL,
    WEAK,
    Evidence,
    bound,
    disagreements,
    identifiability,
    multiple_correlation,
    word,
)
from bayesterra.study.result import COUPLED

N = 40_000
ANYWHERE = (-np.inf, np.inf)


def normal(covariance: FloatArray, seed: int = 1) -> FloatArray:
    """Draws with exactly this covariance."""
    z = np.random.default_rng(seed).standard_normal((N, len(covariance)))
    z -= z.mean(axis=0)
    z = z @ np.linalg.inv(np.linalg.cholesky(np.atleast_2d(np.cov(z.T)))).T
    return np.asarray(z @ np.linalg.cholesky(covariance).T)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (Evidence(DETERMINED), "determined"),
        (Evidence(DETERMINED, tie=0.99, multiple=0.99), "determined"),
        (Evidence(DETERMINED, bound="upper"), "one-sided"),
        (Evidence(DETERMINED, bound="upper", profile="two-sided"), "one-sided"),
        (Evidence(DETERMINED, bound="upper", tie=COUPLED), "coupled"),
        (Evidence(0.99, structural=False), STRUCTURAL),
        (Evidence(DETERMINED - 1e-9), "weakly"),
        (Evidence(DETERMINED - 1e-9, tie=COUPLED), "coupled"),
        (Evidence(0.1, tie=-COUPLED), "coupled"),
        (Evidence(0.1, multiple=COUPLED_TO_ALL), "coupled"),
        (Evidence(0.1, multiple=COUPLED_TO_ALL, given_others=WEAK - 1e-9), "repeats its prior"),
        (Evidence(0.1, tie=COUPLED - 1e-9, multiple=COUPLED_TO_ALL - 1e-9), "repeats its prior"),
        (Evidence(WEAK), "weakly"),
        (Evidence(WEAK, bound="lower"), "one-sided"),
        (Evidence(WEAK, bound="both"), "weakly"),
        (Evidence(WEAK, bound="lower", profile="two-sided"), "weakly"),
        (Evidence(0.1, profile="one-sided", excluded=0.1), "one-sided"),
        (Evidence(0.1, profile="one-sided", excluded=0.09), "repeats its prior"),
        (Evidence(WEAK - 1e-9), "repeats its prior"),
        (Evidence(WEAK - 1e-9, shift=-SHIFT), "moved"),
        (Evidence(WEAK, shift=-SHIFT), "weakly"),
        (Evidence(-0.2, divergence=MOVED), "moved"),
        (Evidence(0.1, shift=SHIFT - 1e-9, divergence=MOVED - 1e-9), "repeats its prior"),
        (Evidence(-0.2), "repeats its prior"),
    ],
)
def test_words_change_at_their_thresholds(found: Evidence, expected: str) -> None:
    """A determined parameter is so whatever it couples to; coupling comes before weakness."""
    assert word(found) == expected


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (Evidence(0.95, profile="two-sided"), 0),
        (Evidence(0.95, profile="bounded only by the prior"), 1),
        (Evidence(0.95, profile="one-sided"), 1),
        (Evidence(0.95, structural=False, profile="two-sided"), 1),
        (Evidence(0.1, profile="flat", divergence=0.01), 0),
        (Evidence(0.1, profile="two-sided", excluded=0.5, divergence=0.12), 2),
        (Evidence(0.5, profile="two-sided"), 0),
    ],
)
def test_methods_that_disagree_are_named(found: Evidence, expected: int) -> None:
    """What a profile or the divergence says against the word is listed, and nothing else."""
    assert len(list(disagreements(found, word(found)))) == expected


def test_the_multiple_correlation_is_that_of_the_best_combination() -> None:
    """Of three variables with a known sum each is the others' combination, though no pair is close."""
    correlation = np.full((3, 3), -0.49) + 1.49 * np.eye(3)
    share = 2 * 0.49**2 / (1 - 0.49)  # of the variance that regression on the other two explains
    np.testing.assert_allclose(multiple_correlation(correlation), np.sqrt(share), rtol=1e-6)
    np.testing.assert_array_equal(multiple_correlation(np.eye(1)), [0.0])


def test_what_the_prior_ties_is_no_coupling() -> None:
    """Two parameters as strongly correlated before the data as after repeat their prior."""
    tied = np.array([[1.0, 0.95], [0.95, 1.0]])
    found = identifiability(("a", "b"), [ANYWHERE] * 2, normal(tied), normal(tied, seed=2))
    assert found.table["verdict"].tolist() == ["repeats its prior"] * 2


def test_a_prior_that_the_data_contradict_is_not_repeated() -> None:
    """25 ± 1° and readings that say 34.7 ± 3.8°: hardly narrowed, moved by 0.65 sd; piled up at both ends."""
    rng = np.random.default_rng(8)
    precision = 1.0 / np.array([1.0, 3.8]) ** 2
    after = rng.normal(precision @ [25.0, 34.7] / precision.sum(), precision.sum() ** -0.5, N)
    prior = np.column_stack([rng.normal(25.0, 1.0, N), rng.random((N, 2))])
    posterior = np.column_stack([after, rng.beta(0.5, 0.5, N), rng.random(N)])
    found = identifiability(("a", "b", "c"), [ANYWHERE, (0.0, 1.0), (0.0, 1.0)], prior, posterior).table
    assert found["contraction"].max() < WEAK
    assert found["verdict"].tolist() == ["moved", "moved", "repeats its prior"]
    np.testing.assert_allclose(found["shift"], [9.7 / (1 + 3.8**2), 0.0, 0.0], atol=0.02)


def test_a_law_of_ratios_is_counted_in_ratios() -> None:
    """The data exclude half of the decades: three quarters of the variance, not what the top holds."""
    rng = np.random.default_rng(9)
    prior, posterior = 10.0 ** rng.uniform(0, 4, (N, 1)), 10.0 ** rng.uniform(2, 4, (N, 1))
    found = identifiability(("a",), [(1.0, 1e4)], prior, posterior, logs=np.array([True])).table.loc[0]
    np.testing.assert_allclose(found["contraction"], 0.75, atol=0.01)
    np.testing.assert_allclose(found["posterior_sd"], posterior.std())
    assert found["bound"] == "upper"
    linear = identifiability(("a",), [(1.0, 1e4)], prior, posterior).table.loc[0]
    assert linear["contraction"] < 0.0


def test_a_determined_partner_ties_nothing() -> None:
    """A parameter left wholly open beside one that is determined, however correlated, repeats its prior."""
    tied = np.array([[1.0, 0.95 * np.sqrt(0.05)], [0.95 * np.sqrt(0.05), 0.05]])
    found = identifiability(("a", "b"), [ANYWHERE] * 2, normal(np.eye(2)), normal(tied, seed=2)).table
    np.testing.assert_allclose(found["correlation"], 0.95, atol=1e-6)
    assert found["verdict"].tolist() == ["repeats its prior", "determined"]
    assert found["tied_to"].tolist() == ["a", "a"]  # the first to nothing but itself


def test_a_partner_held_by_its_bound_alone_still_ties() -> None:
    """A ridge pressed against the end of one prior: both are coupled, though that one hardly varies."""
    rng = np.random.default_rng(4)
    held = rng.exponential(size=N)
    posterior = np.column_stack([0.05 * held, held + 0.02 * rng.standard_normal(N)])
    prior = np.column_stack([rng.uniform(0, 1.5, N), rng.uniform(-2, 3, N)])
    found = identifiability(("a", "b"), [(0.0, 1.5), ANYWHERE], prior, posterior).table
    assert found["contraction"][0] > DETERMINED
    assert found["bound"].tolist() == ["lower", "none"]
    assert found["verdict"].tolist() == ["coupled", "coupled"]


def test_a_known_sum_of_three_couples_all_three() -> None:
    """Where only a sum is known, each is coupled, though pairs are weakly correlated."""
    posterior = normal(np.eye(3) - 0.33 * np.ones((3, 3)), seed=2)
    found = identifiability(("a", "b", "c"), [ANYWHERE] * 3, normal(np.eye(3)), posterior).table
    assert (found["tie"].abs() < 0.6).all()
    assert found["verdict"].tolist() == ["coupled"] * 3


@pytest.mark.parametrize(
    ("draws", "leans"),
    [
        (lambda z: z, "none"),
        (lambda z: z[z > -2.0], "none"),
        (lambda z: z[z > -1.0], "lower"),
        (lambda z: -z[z > 0.0], "upper"),
        (lambda z: np.linspace(-4, 4, len(z)), "both"),
    ],
)
def test_a_law_that_a_bound_cuts_off_leans_on_it(draws: Callable[[FloatArray], FloatArray], leans: str) -> None:
    """Half a normal law leans on its end, a whole one does not, however far the bound."""
    values = draws(np.random.default_rng(3).standard_normal(N))
    ends = (float(values.min()), float(values.max()))
    assert bound(values, *ends) == leans
    assert bound(1e6 * values, 1e6 * ends[0], 1e6 * ends[1]) == leans
    assert bound(values, *ANYWHERE) == "none"


def test_contraction_is_the_loss_of_variance() -> None:
    """Contraction, partner, correlation and spreads are those of the draws, scale and order kept."""
    prior = normal(np.diag([4.0, 1e-6, 100.0]))
    posterior = normal(np.array([[0.04, 0.0, 0.0], [0.0, 0.8e-6, 0.85 * np.sqrt(0.8e-6 * 36)],
                                 [0.0, 0.85 * np.sqrt(0.8e-6 * 36), 36.0]]), seed=2)  # fmt: skip
    table = identifiability(("a", "b", "c"), [ANYWHERE] * 3, prior, posterior).table.set_index("parameter")
    np.testing.assert_allclose(table["contraction"], [0.99, 0.2, 0.64], atol=1e-3)
    assert table["verdict"].tolist() == ["determined", "coupled", "coupled"]
    assert table["partner"][["b", "c"]].tolist() == ["c", "b"]
    np.testing.assert_allclose(table["correlation"][["b", "c"]], 0.85, atol=1e-6)
    np.testing.assert_allclose(table["prior_sd"], [2.0, 1e-3, 10.0], rtol=1e-3)
    np.testing.assert_allclose(table["posterior_sd"], [0.2, np.sqrt(0.8e-6), 6.0], rtol=1e-3)


def test_determined_directions_are_counted() -> None:
    """Two parameters of which only the sum is known: one direction determined, none of the parameters."""
    prior = normal(np.eye(2))
    known, unknown = 0.01, 0.9
    rotation = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2)
    posterior = normal(rotation @ np.diag([known, unknown]) @ rotation.T, seed=2)
    found = identifiability(("a", "b"), [ANYWHERE] * 2, prior, posterior)
    assert found.determined == 1
    np.testing.assert_allclose(found.contractions, [1 - known, 1 - unknown], atol=1e-6)
    best = found.directions[:, 0] / np.linalg.norm(found.directions[:, 0])
    np.testing.assert_allclose(np.abs(best), np.sqrt(0.5), atol=1e-4)
    assert best[0] * best[1] > 0
    assert found.table["verdict"].tolist() == ["coupled", "coupled"]


def test_directions_allow_for_the_correlation_of_the_prior() -> None:
    """What the prior already ties together does not count as learnt from the data."""
    tied = np.array([[1.0, 0.95], [0.95, 1.0]])
    found = identifiability(("a", "b"), [ANYWHERE] * 2, normal(tied), normal(tied, seed=2))
    np.testing.assert_allclose(found.contractions, 0.0, atol=1e-6)
    assert found.determined == 0


def test_directions_have_unit_spread_under_the_prior() -> None:
    """Seen along the directions the prior is uncorrelated with spread 1, and the posterior as contracted."""
    tied = np.array([[4.0, 1.8], [1.8, 1.0]])
    prior, posterior = normal(tied), normal(np.array([[0.4, -0.05], [-0.05, 0.3]]), seed=2)
    found = identifiability(("a", "b"), [ANYWHERE] * 2, prior, posterior)
    along = prior / prior.std(axis=0) @ found.directions
    np.testing.assert_allclose(np.cov(along.T), np.eye(2), atol=1e-3)
    along = posterior / prior.std(axis=0) @ found.directions
    np.testing.assert_allclose(np.cov(along.T), np.diag(1 - found.contractions), atol=1e-3)


def test_one_parameter_has_no_partner_to_couple_with() -> None:
    """A single parameter is judged by its contraction alone."""
    found = identifiability(("a",), [ANYWHERE] * 1, normal(np.eye(1)), normal(0.5 * np.eye(1), seed=2))
    assert found.table["verdict"].tolist() == ["weakly"]
    assert found.table["correlation"][0] == 0.0
    np.testing.assert_allclose(found.contractions, [0.5], atol=1e-6)
