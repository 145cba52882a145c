"""Fit and prediction of a joint posterior: against weighted prior draws, and by what cards, sentence and exit say."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from bayesterra.analysis.run import fit_of_groups, judged, prediction_of_levels
from bayesterra.checking.levels import places, ways
from bayesterra.checking.loo import Without, without_levels
from bayesterra.likelihood.joint import JointPosterior, joint_posterior
from bayesterra.pooling.run import PooledResult, run_pooled
from bayesterra.sampling.joint import PoolingOptions
from bayesterra.study.study import Study
from tests.support.two_wheels import FRICTION, HELD, SHEAR, TABLE, MakeStudy, few_walkers

PRIORS = {**HELD, "phi": FRICTION, "K": SHEAR}
NOISE = {"drawbar_pull": 3.0, "resistance_moment": 0.6}


def weighted(joint: JointPosterior, n: int, seed: int) -> np.ndarray:
    """Draws (k, d) of a joint posterior from its cut prior by their likelihoods."""
    rng = np.random.default_rng(seed)
    x = joint.cut_prior(n, rng)
    likelihood = joint.log_prior_and_likelihood(x)[1]
    weights = np.exp(likelihood - likelihood.max())
    assert weights.sum() ** 2 / (weights**2).sum() > 300
    return np.asarray(x[rng.choice(n, 4000, p=weights / weights.sum())])


@pytest.fixture(scope="module")
def posterior(make: MakeStudy) -> tuple[Study, JointPosterior, np.ndarray]:
    """A study, its joint posterior and draws of it."""
    study = make(priors=PRIORS, noise=NOISE)
    joint = joint_posterior(study)
    return study, joint, weighted(joint, 100_000, 1)


def test_the_posterior_without_a_level_is_that_of_the_other_rows(
    posterior: tuple[Study, JointPosterior, np.ndarray],
) -> None:
    """Means and spreads of all parameters, of the wheel left out whole as well."""
    study, joint, draws = posterior
    for fold in (ways(study)["slip"][2], ways(study)["wheel"][1]):
        level = places(study, fold)
        found = without_levels(joint, draws, np.random.SeedSequence(1), [level])[level]
        assert found.reliable
        rest = joint_posterior(study.with_use(study.observations.use & ~fold.left), fewest=1)
        truth = weighted(rest, 100_000, 2)
        places_ = [joint.names.index(name) for name in rest.names]
        own, sd = found.x[:, places_], truth.std(axis=0)
        np.testing.assert_allclose((own.mean(axis=0) - truth.mean(axis=0)) / sd, 0.0, atol=0.2)
        np.testing.assert_allclose(own.std(axis=0) / sd, 1.0, atol=0.15)


def test_a_misfit_of_one_group_is_named(make: MakeStudy, posterior: tuple[Study, JointPosterior, np.ndarray]) -> None:
    """Pulls of one wheel halved: its name and channel; without that no group looks strange."""
    study, joint, draws = posterior
    rng = np.random.default_rng(1)
    sound = fit_of_groups(study, joint, draws, ways(study), rng)
    assert (sound.word, sound.grade) == ("fits", "good")
    table = TABLE.copy()
    table.loc[3:, "drawbar_pull [N]"] *= 0.5
    halved = make(data=table, priors=PRIORS, noise=NOISE)
    bad = fit_of_groups(halved, joint_posterior(halved), draws, ways(halved), rng)
    assert (bad.word, bad.grade) == ("does not fit", "bad")
    assert bad.claim.startswith("the model does not fit Wh32: drawbar pull")


def test_levels_that_no_draws_reach_are_named(
    posterior: tuple[Study, JointPosterior, np.ndarray], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where all weights fail nothing is claimed; where some do, the others are counted."""
    study, joint, draws = posterior
    draws, kept = draws[:1000], dict[tuple[int, ...], Without]()
    monkeypatch.setattr("bayesterra.analysis.run.without_levels", reached(lambda level: False, kept))
    none = prediction_of_levels(study, joint, draws, ways(study), np.random.SeedSequence(1))
    assert (none.word, none.grade) == ("not tested", "note")
    assert "slip 0.100" in str(none.sentence)
    assert str(none.sentence).endswith("`bayesterra holdout` makes each fit anew.")
    monkeypatch.setattr("bayesterra.analysis.run.without_levels", reached(lambda level: level != (0, 3), kept))
    some = prediction_of_levels(study, joint, draws, ways(study), np.random.SeedSequence(1))
    assert "of 4 pulls" in str(some.sentence)
    assert "Not tested: slip 0.100: the posterior without it is quite another one" in str(some.sentence)


def reached(reliable: Callable[[tuple[int, ...]], bool], kept: dict[tuple[int, ...], Without]) -> Callable[..., object]:
    """Levels left out, of which some are said to be reliable; found once, and ``kept``."""

    def without(*given: object) -> object:
        if not kept:
            kept.update(without_levels(*given))  # type: ignore[arg-type]
        return {level: replace(each, reliable=reliable(level)) for level, each in kept.items()}

    return without


@pytest.mark.slow
def test_card_sentence_and_terminal_say_it(
    make: MakeStudy, small: PoolingOptions, capsys: pytest.CaptureFixture[str]
) -> None:
    """The page of a misfit says in its first line that it is none to use."""
    from bayesterra.report.terminal import show

    table = TABLE.copy()
    table.loc[3:, "drawbar_pull [N]"] *= 0.5
    with few_walkers():
        result = judged(run_pooled(make(data=table), seed=1, plan=small), 1)
    assert isinstance(result, PooledResult)
    assert [verdict.name for verdict in result.verdicts] == ["Sampling", "Fit", "Prediction"]
    assert result.sentence.startswith("Do not use: the model does not fit Wh32")
    html = result.page().html()
    assert "Do not use: the model does not fit Wh32" in html.split('class="verdicts"')[0]
    show(result.overview())
    printed = capsys.readouterr()
    assert "Fit: does not fit. Wh32: " in printed.err + printed.out
    assert "Do not use: the model does not fit Wh32" in " ".join(printed.out.split())
