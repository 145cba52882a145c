"""Calibrations of studies with groups: truths and readings of the joint prior, ranks by group."""

from pathlib import Path

import numpy as np
import pytest
from numpy.random import SeedSequence, default_rng

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.checking.calibration import quantities, quantity_names, replicated
from bayesterra.checking.short_runs import Fitted, ShortGroupRuns, ShortRuns, short_runs
from bayesterra.errors import SupportError
from bayesterra.likelihood.joint import draw_joint_prior, joint_posterior
from bayesterra.study.canonical import write_study
from bayesterra.study.study import Study
from tests.support.two_wheels import COHESION, FREE, FRICTION, MakeStudy

PREDICTED = [f"{name}_at_largest_slip" for name in ("sinkage", "drawbar_pull")]
UNTOLD = {"drawbar_pull": 1e6, "resistance_moment": 1e6}
"""Noise of readings that say nothing."""


@pytest.fixture(name="study", scope="module")
def fixture_study(make: MakeStudy) -> Study:
    """C and φ shared and correlated, K from a population; readings of pull and moment."""
    return make(
        priors={**FREE, "c": COHESION, "phi": FRICTION, "correlation": {"c, phi": 0.8}},
        pooling={"shared": ["c", "phi"], "hierarchical": {"K": {}}},
    )


def prior_draws(study: Study, seed: SeedSequence) -> Fitted:
    """Draws of the joint prior: the posterior where readings say nothing."""
    return Fitted(draw_joint_prior(joint_posterior(study), 200, default_rng(seed), batch=200), 200.0, 1.0, True)


def without_correlation(study: Study, seed: SeedSequence) -> Fitted:
    """A wrong posterior: c and φ are independent, and twice as far from their means."""
    draws = prior_draws(study, seed).draws
    draws[:, :1] = COHESION["loc"] + 2.0 * (default_rng(seed).permutation(draws[:, :1]) - COHESION["loc"])
    return Fitted(draws, 200.0, 1.0, True)


def test_truths_are_draws_of_the_joint_prior(study: Study) -> None:
    """With its correlation, a value of K for each group, and readings that scatter around their own."""
    rng, truths, residuals = default_rng(3), [], []
    for _ in range(150):
        truth, made = replicated(study, rng)
        joint = joint_posterior(made)
        truths.append(truth[0])
        for alone, own in zip(joint.groups.values(), joint.values_of_groups(truth), strict=True):
            outcomes, likelihood = alone.outcomes(own), alone.likelihood
            for i, name in enumerate(likelihood.channels):
                sd = made.noise[name].sd
                residuals.append((likelihood.measured[:, i] - outcomes[name][0]) / sd)
    x = np.array(truths)
    assert joint_posterior(study).names == ("c", "phi", "K.mean", "K.spread", "K[Wh11]", "K[Wh32]")
    assert np.corrcoef(x[:, :2].T)[0, 1] == pytest.approx(0.8, abs=0.1)
    assert (x[:, 4] != x[:, 5]).all()
    z = np.concatenate(residuals)
    assert z.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * z.size))
    assert abs(z.mean()) < 4 / np.sqrt(z.size)


def test_the_quantities_are_those_of_the_joint_posterior(study: Study) -> None:
    """Every parameter, log likelihood and prior, and what the model says of each group's last row."""
    joint = joint_posterior(study)
    x = draw_joint_prior(joint, 20, default_rng(5))
    values = quantities(joint, x)
    groups = [f"{name}[{group}]" for group in joint.groups for name in PREDICTED]
    assert tuple(values) == quantity_names(study) == (*joint.names, "log_likelihood", "log_prior", *groups)
    np.testing.assert_allclose(values["log_likelihood"] + values["log_prior"], joint.log_density(x))
    for group, own in zip(joint.groups, joint.values_of_groups(x), strict=True):
        pull = joint.groups[group].outcomes(own)["drawbar_pull"][:, -1]
        np.testing.assert_array_equal(values[f"drawbar_pull_at_largest_slip[{group}]"], pull)


def test_a_right_posterior_passes_and_its_page_names_groups(make: MakeStudy, tmp_path: Path) -> None:
    """Where readings say nothing the joint prior is the posterior; the file and the page say whose values."""
    untold = make(noise=UNTOLD)
    found = bt.calibrate(untold, n=40, seed=2, fit=prior_draws)
    assert found.verdict == "calibrated"
    assert found.parameters == joint_posterior(untold).names
    assert found.tests.set_index("quantity").loc["K[Wh32]", "ranks"] == 40
    report = found.save(tmp_path / "out").read_text(encoding="utf-8")
    assert "<i>K</i>[Wh32]" in report
    assert "in all 5, at least" in report
    assert "<i>F</i><sub>DP</sub>[Wh11] at the largest slip" in report


def test_a_wrong_joint_posterior_is_found_out(make: MakeStudy) -> None:
    """Cohesion without its correlation, and spread out."""
    untold = make(
        noise=UNTOLD,
        priors={**FREE, "c": COHESION, "phi": FRICTION, "correlation": {"c, phi": 0.8}},
        pooling={"shared": ["c", "phi"], "hierarchical": {"K": {}}},
    )
    assert "log_prior" in bt.calibrate(untold, n=60, fit=without_correlation).failing


def test_the_sampler_of_a_study_with_groups_is_theirs(study: Study, make: MakeStudy) -> None:
    """Chosen by the [pooling] table, and stated in the record with its sizes."""
    assert isinstance(short_runs(study), ShortGroupRuns)
    assert type(short_runs(make(pooling=None))) is ShortRuns
    made = bt.calibrate(make(noise=UNTOLD), n=20, fit=prior_draws)
    assert made.record["settings"] == {"ranked_among": 99, "fit": "prior_draws"}


@pytest.mark.slow
def test_a_replication_samples_the_joint_posterior(study: Study) -> None:
    """By the default sampler: draws of all parameters, enough of them, that lie where the density is."""
    joint = joint_posterior(study)
    fitted = ShortGroupRuns()(study, SeedSequence(1))
    assert fitted.converged
    assert fitted.ess >= 400
    assert fitted.draws.shape[1] == len(joint.names)
    prior = prior_draws(study, SeedSequence(2)).draws
    assert np.median(joint.log_density(fitted.draws)) > np.median(joint.log_density(prior)) + 3.0
    assert fitted.draws[:, 1].std() < 0.5 * prior[:, 1].std()


def test_the_command_calibrates_groups(
    make: MakeStudy, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder and a table by group."""
    monkeypatch.setattr("bayesterra.checking.calibration.short_runs", lambda study: prior_draws)
    (tmp_path / "study").mkdir()
    write_study(make(noise=UNTOLD), tmp_path / "study")
    out = tmp_path / "out"
    asked = ["calibrate", str(tmp_path / "study"), "-n", "20", "--workers", "1", "--out", str(out), "--quiet"]
    assert main(asked) == 0
    printed = capsys.readouterr().out
    assert "K[Wh32]" in printed
    assert "Posterior calibrated" in printed
    assert "K[Wh32]" in (out / "ranks.csv").read_text(encoding="utf-8")


def test_a_prior_that_no_group_bears_is_refused(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    """In words, however the draws are made."""
    joint = joint_posterior(study)
    monkeypatch.setattr("bayesterra.likelihood.joint.MOST_BATCHES", 3)
    monkeypatch.setattr(type(joint.first), "reasons", lambda self, x: np.ones(len(x), dtype=int))
    with pytest.raises(SupportError, match=r"^none of 24 draws of the prior fits the conditions of all group"):
        draw_joint_prior(joint, 1, default_rng(0), batch=8, most=None)
    monkeypatch.setattr("bayesterra.likelihood.joint.MOST_BATCHES", 100)
    with pytest.raises(SupportError, match=r"^no draw of the prior fits the conditions of group Wh11$"):
        draw_joint_prior(joint, 1, default_rng(0), batch=8)
