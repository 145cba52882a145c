"""What data of several groups determine: joint parameters, populations, and what only some of them read."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence, default_rng

from bayesterra.__main__ import main
from bayesterra.identifiability.analysis import Analysis, Identified, _record, analyse, foresee
from bayesterra.identifiability.profiles import NO_PROFILES
from bayesterra.identifiability.structure import design_of, structure
from bayesterra.likelihood.joint import JointPosterior, joint_posterior
from bayesterra.likelihood.posterior import posterior
from bayesterra.likelihood.sensitivities import read_where
from bayesterra.study.canonical import write_study
from bayesterra.study.study import Study
from tests.support.fisher import fisher_information
from tests.support.two_wheels import FRICTION, HELD, SHEAR, TABLE, MakeStudy

CORRELATED = {"phi, K": 0.6}
NARROW = {**HELD, "phi": FRICTION, "K": SHEAR}
"""Priors of which many draws count."""


def weighed(joint: JointPosterior, n: int = 40_000, kept: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """Draws of the cut prior, and of the posterior by weights."""
    rng = default_rng(1)
    x = joint.cut_prior(n, rng)
    level = joint.log_prior_and_likelihood(x)[1]
    weights = np.exp(level - level.max())
    return x[:kept], x[rng.choice(n, kept, p=weights / weights.sum())]


def analysed(study: Study) -> Analysis:
    """Analysis of a joint posterior whose draws cost nothing."""
    joint = joint_posterior(study)
    return analyse(joint, *weighed(joint), SeedSequence(2))


def contractions_by_weights(joint: JointPosterior, sets: int) -> np.ndarray:
    """Contractions (sets, p) of independent sets of weighted draws of the prior."""
    found = []
    for seed in range(sets):
        x = joint.cut_prior(40_000, default_rng(seed))
        level = joint.log_prior_and_likelihood(x)[1]
        weights = np.exp(level - level.max())
        spread = np.average((x - np.average(x, axis=0, weights=weights)) ** 2, axis=0, weights=weights)
        found.append(1 - spread / x.var(axis=0))
    return np.array(found)


@pytest.fixture(name="found", scope="module")
def fixture_found(make: MakeStudy) -> Analysis:
    """Two wheels, φ shared, K of a population."""
    return analysed(make(priors=NARROW))


def test_information_is_the_sum_over_groups(make: MakeStudy) -> None:
    """Each group's own, in the columns of its parameters: against differences of all modelled readings."""
    joint = joint_posterior(make())
    x = joint.cut_prior(1, default_rng(3))

    def standard(at: np.ndarray) -> np.ndarray:
        parts = []
        for own, values in zip(joint.groups.values(), joint.values_of_groups(at), strict=True):
            parts.append(own.likelihood.standardised(own.likelihood.predicted(own.outcomes(values)), np.empty((1, 0))))
        return np.concatenate([part.ravel() for part in parts])

    steps = 1e-5 * np.abs(x[0])
    slopes = [
        (standard(x + step * unit) - standard(x - step * unit)) / (2 * step)
        for step, unit in zip(steps, np.eye(x.shape[1]), strict=True)
    ]
    expected = np.array(slopes) @ np.array(slopes).T
    np.testing.assert_allclose(fisher_information(joint, x)[0], expected, rtol=1e-5, atol=1e-6 * expected.max())


def test_what_one_group_reads_and_another_does_not(make: MakeStudy) -> None:
    """A channel without a reading in one group is not yet to be measured there."""
    table = TABLE.copy()
    table.loc[:2, "resistance_moment [N m]"] = np.nan
    first, second = read_where(joint_posterior(make(data=table)))
    assert first.tolist() == [[True, False]] * 3
    assert second.all()
    alone = TABLE.assign(**{"resistance_moment [N m]": np.nan}).drop(columns="resistance_moment [N m]")
    assert read_where(posterior(make(data=alone, pooling=None, noise={"drawbar_pull": 1.0})))[0].all()


def test_the_design_is_that_of_all_groups(make: MakeStudy) -> None:
    """Rows and readings of both; means and spreads of populations are no parameters of readings."""
    joint = joint_posterior(make())
    design = design_of(joint)
    assert (design.rows, design.readings, len(design.slips), len(design.widths)) == (6, 12, 3, 1)
    seen = structure(joint, joint.cut_prior(100, default_rng(1)))
    assert seen.determined == joint.names
    assert (seen.rank, seen.nulls) == (5, ())


def test_a_parameter_that_no_reading_touches_is_told(make: MakeStudy) -> None:
    """At slip 0 nothing depends on n1: it is open for the wheel driven there only, and for no other."""
    table = TABLE.assign(slip=[0.0] * 3 + [0.1, 0.25, 0.5])
    n1 = {"dist": "norm", "loc": 1.06, "scale": 0.2}
    pooling = {"shared": ["phi"], "separate": ["n1"]}
    joint = joint_posterior(make(data=table, priors={**NARROW, "K": 0.012, "n1": n1}, pooling=pooling))
    seen = structure(joint, joint.cut_prior(100, default_rng(1)))
    assert [null.parameters for null in seen.nulls] == [("n1[Wh11]",)]
    assert seen.nulls[0].words.startswith("no reading depends on n1[Wh11]")


def test_verdicts_are_those_of_joint_parameters(found: Analysis) -> None:
    """By name; what is shared is known at least as well as from one wheel alone; the spread hardly at all."""
    table = found.verdicts.set_index("parameter")
    assert list(table.index) == ["phi", "K.mean", "K.spread", "K[Wh11]", "K[Wh32]"]
    assert set(table["profile"]) == {""}
    spread = table.loc["K.spread"]
    assert spread["verdict"] not in ("determined", "coupled")
    assert spread["contraction"] < 0.5
    assert (table.loc[["K[Wh11]", "K[Wh32]"], "contraction"] > table["contraction"]["K.mean"]).all()
    assert found.profiles.found == {}
    assert found.profiles.table.empty


def test_shared_readings_narrow_what_is_shared(make: MakeStudy, found: Analysis) -> None:
    """φ of the joint posterior is as narrow as that of either wheel alone, or narrower."""
    study = make(priors=NARROW)
    alone = posterior(study.by_group()["Wh11"])
    x = alone.cut_prior(20_000, default_rng(1))
    level = alone.log_prior_and_likelihood(x)[1]
    weights = np.exp(level - level.max())
    weights /= weights.sum()
    phi = x[:, alone.names.index("phi")]
    spread = np.sqrt(weights @ (phi - weights @ phi) ** 2)
    joint = found.verdicts.set_index("parameter")["posterior_sd"]["phi"]
    assert joint < 1.05 * spread


def test_the_prior_of_all_parameters_has_independent_or_stated_scores(make: MakeStudy) -> None:
    """Scores of prior draws are standard normal with the stated correlations; groups by what they share."""
    priors = {**NARROW, "correlation": CORRELATED}
    for pooling in ({"shared": ["phi"], "hierarchical": {"K": {}}}, {"shared": ["phi"], "separate": ["K"]}):
        joint = joint_posterior(make(priors=priors, pooling=pooling))
        prior = joint.prior
        z = prior.scores(prior.sample(40_000, default_rng(4)))
        np.testing.assert_allclose(np.corrcoef(z.T), prior.score_correlation, atol=0.03)
        np.testing.assert_allclose(z.std(axis=0), 1.0, atol=0.03)
    assert list(prior.laws) == list(joint.names)


def test_impossible_sets_have_a_reason(make: MakeStudy) -> None:
    """The same as a group's own; inside the support there is none."""
    joint = joint_posterior(make())
    x = joint.prior.sample(500, default_rng(5))
    x[0, joint.names.index("K.spread")] = -1.0
    inside = np.isfinite(joint.log_density(x))
    np.testing.assert_array_equal(joint.reasons(x) == 0, inside)
    assert joint.reasons(x)[0] == -1


def test_a_design_is_foreseen(make: MakeStudy) -> None:
    """Before its readings, by draws of the joint prior."""
    expected = foresee(make()).spread.table.set_index("parameter")["expected"]
    assert expected["K[Wh11]"] > 0.6
    assert expected["K.spread"] < 0.1


def test_page_tables_and_terminal_name_the_groups(make: MakeStudy, found: Analysis, tmp_path: Path) -> None:
    """In symbols and units; the page says why there are no profiles, in place of a figure."""
    source = {"draws_from": "here", "draws": 4000, "converged": True}
    record = _record(make(), 1, {}, source)
    made = Identified(make(), found, record)
    page = made.save(tmp_path / "out").read_text(encoding="utf-8")
    assert NO_PROFILES in page
    assert "<i>K</i>[Wh11]" in page
    verdicts = made.verdicts.set_index("parameter")
    assert verdicts["unit"]["K[Wh11]"] == "mm"
    sd = found.verdicts.set_index("parameter")["posterior_sd"]["K[Wh11]"]
    assert verdicts["posterior_sd"]["K[Wh11]"] == pytest.approx(1e3 * sd)
    assert "K[Wh32]" in str(made.overview())
    assert (tmp_path / "out" / "profile_points.csv").read_text(encoding="utf-8").count("\n") == 1


@pytest.mark.slow
def test_a_study_is_sampled_by_its_joint_posterior(make: MakeStudy, tmp_path: Path) -> None:
    """By the command; contractions as from weights, within four errors of either.

    Ten sets of weights count about as 350 draws each, the run as three of them at least.
    """
    (tmp_path / "two").mkdir()
    study = make(priors=NARROW)
    write_study(study, tmp_path / "two")
    out = tmp_path / "out"
    words = ["identify", str(tmp_path / "two"), "--seed", "2", "--workers", "1", "--quiet", "--out", str(out)]
    assert main(words) == 0
    by_weights = contractions_by_weights(joint_posterior(study), 10)
    error = by_weights.std(axis=0, ddof=1) * np.sqrt(1 / 10 + 1 / 3)
    sampled = pd.read_csv(out / "verdicts.csv")["contraction"]
    np.testing.assert_array_less(np.abs(sampled - by_weights.mean(axis=0)), 4 * error)
