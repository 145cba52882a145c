"""Contraction, divergence and the number of determined directions, on made-up draws and on a study."""

import numpy as np
import pytest

from bayesterra.arrays import FloatArray
from bayesterra.identifiability.information import MARGINAL, OTHERS_KNOWN, Compared, Information, effective, information
from bayesterra.identifiability.verdicts import group_columns, in_words, scores_under, within_groups
from bayesterra.likelihood.posterior import posterior
from bayesterra.study.result import Result

N = 12_000


def normal(covariance: FloatArray, seed: int) -> FloatArray:
    """Draws with this covariance."""
    z = np.random.default_rng(seed).standard_normal((N, len(covariance)))
    return np.asarray(z @ np.linalg.cholesky(covariance).T)


@pytest.fixture(scope="module")
def found(small_result: Result) -> Information:
    """What a short run on the shipped HIT study adds to its prior."""
    target = posterior(small_result.study)
    prior, draws = small_result.values("prior"), small_result.values()
    return information(target, prior, draws, np.random.default_rng(1))


def test_a_group_hidden_by_another_shows_when_that_is_known() -> None:
    """Two parameters of which the sum alone is known: each is determined once the other is known."""
    prior = normal(np.eye(2), 1)
    turn = np.array([[1.0, 1.0], [1.0, -1.0]]) / np.sqrt(2)
    both = Compared(prior, normal(turn @ np.diag([0.01, 0.9]) @ turn, 2))
    assert both.directions([0], MARGINAL)[0] == pytest.approx([1 - 0.455], abs=0.02)
    known = 1 / (0.5 / 0.01 + 0.5 / 0.9)  # conditional variance: one over the entry of the precision
    assert both.directions([0], OTHERS_KNOWN)[0] == pytest.approx([1 - known], abs=0.002)
    assert both.directions([0, 1], MARGINAL)[0] == pytest.approx([0.99, 0.1], abs=0.03)


def test_two_outermost_draws_that_nearly_meet_stretch_no_score() -> None:
    """Scores under a law's own draws keep a spread of 1, whatever the gaps between the last ones."""
    draws = np.sort(np.random.default_rng(5).uniform(size=(4000, 1)), axis=0)
    draws[-5:-2] = draws[-3] - np.array([[2e-12], [1e-12], [0.0]])
    scores = scores_under(draws, draws)
    assert scores.std() == pytest.approx(1.0, abs=0.01)
    assert np.abs(scores).max() < 4.5


def test_scores_do_not_depend_on_the_scale_of_a_parameter() -> None:
    """The directions of (K, n) and of (log K, n) are the same in scores and differ in plain parameters."""
    rng = np.random.default_rng(3)
    prior = np.column_stack([rng.uniform(0.1, 10, N), rng.uniform(0, 2, N)])
    ridge = prior[:, 0]
    draws = np.column_stack([ridge, 1.2 + 0.25 * np.log(ridge) + rng.normal(0, 0.01, N)])
    logs = (np.column_stack([np.log(x[:, 0]), x[:, 1]]) for x in (prior, draws))
    stated = (Compared.scores(prior, draws), Compared.scores(*logs))
    one, other = (each.directions([0, 1], MARGINAL)[0] for each in stated)
    np.testing.assert_allclose(one, other, atol=5e-3)
    assert one[0] > 0.95
    assert one[1] < 0.1


def test_scores_of_the_reference_are_normal_and_reach_beyond_it() -> None:
    """Scores of the reference have mean 0 and sd 1; draws outside it go on in a straight line."""
    reference = np.random.default_rng(4).gamma(2.0, size=(N, 1))
    scores = scores_under(reference, reference)
    assert scores.mean() == pytest.approx(0.0, abs=0.02)
    assert scores.std() == pytest.approx(1.0, abs=0.02)
    far = scores_under(reference, np.array([[20.0], [30.0], [40.0]]))[:, 0]
    assert np.diff(far) == pytest.approx([far[1] - far[0]] * 2)
    assert far[0] > 3


def test_effective_number_counts_no_direction_below_zero() -> None:
    """A direction that spreads counts as nothing known, not as less than nothing."""
    assert effective(np.array([0.99, 0.5, -0.2])) == pytest.approx(1.49)


def test_combinations_read_as_text() -> None:
    """The heaviest parameter first with the weight 1, signs kept relative to it, small weights left out."""
    assert in_words(("Ks", "n0", "c2"), np.array([-0.2, 0.4, 0.01])) == "n0 − 0.5 K_s"
    assert in_words(("c", "phi"), np.array([2.0, 1.999])) == "c + φ"


def test_moduli_belong_to_the_bearing_group() -> None:
    """k_c and k_φ are bearing parameters; noise and offset are in no group."""
    names = ("kc", "kphi", "n0", "c", "noise_sinkage", "sinkage_offset")
    assert group_columns(names) == {"P_I": [0, 1, 2], "P_II": [3]}


def test_coordinates_within_groups_do_not_mix_them(small_result: Result) -> None:
    """A change of c1 and c2 moves their own coordinates only, and the map can be inverted."""
    target = posterior(small_result.study)
    inner, x = within_groups(target), small_result.values()[:50]
    u, moved = inner.from_physical(x), x.copy()
    moved[:, -2:] *= 0.999
    assert (inner.from_physical(moved) != u).tolist() == [[False] * 6 + [True] * 2] * 50
    np.testing.assert_allclose(inner.to_physical(u)[0], x, rtol=1e-6)


def test_two_of_three_bearing_directions_are_known_on_the_study(found: Information) -> None:
    """The HIT set fixes two bearing directions, the third is K_s, of which it says nothing."""
    counts = found.counts.set_index(["scope", "view"])["determined"]
    assert counts["P_I", MARGINAL] == 2
    assert counts["P_I", OTHERS_KNOWN] == 2
    table = found.parameters.set_index("parameter")
    assert abs(table["contraction"]["Ks"]) < 0.12
    assert table["divergence"]["Ks"] < 0.05
    last = found.directions.query("scope == 'P_I' and view == 'marginal' and rank == 3").iloc[0]
    assert last["combination"].startswith("K_s")
    assert abs(last["contraction"]) < 0.15


def test_what_the_cut_contracts_is_not_counted_for_the_data(found: Information) -> None:
    """The cut takes three quarters of c1's variance; the counts of the data start after it."""
    table = found.parameters.set_index("parameter")
    assert table["cut_contraction"]["c1"] == pytest.approx(0.76, abs=0.02)
    assert table["cut_divergence"]["c1"] > 0.5
    assert table["cut_contraction"]["phi"] == pytest.approx(0.0, abs=0.05)
    row = found.counts.query("scope == 'P_III' and view == 'marginal'").iloc[0]
    assert row["cut_effective"] == pytest.approx(0.9, abs=0.1)
    assert row["determined"] <= row["directions"] == 2


def test_every_scope_and_view_is_counted(found: Information) -> None:
    """All parameters once, each group alone and with the others known; as many directions as parameters."""
    assert found.counts[["scope", "view", "directions"]].to_numpy().tolist() == [
        ["all", MARGINAL, 8],
        *([group, view, size] for group, size in (("P_I", 3), ("P_II", 3), ("P_III", 2))
          for view in (MARGINAL, OTHERS_KNOWN)),
    ]  # fmt: skip
    assert len(found.directions) == found.counts["directions"].sum()
    assert (found.counts["effective"] >= found.counts["determined"] * 0.9).all()
