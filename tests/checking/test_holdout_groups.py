"""Levels of several wheels: panels, refits of joint posteriors, groups that are left out whole."""

import json
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.random import SeedSequence, default_rng
from scipy.stats import kstest, truncnorm

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.checking.folds import GROUP_REFITS, REFITS, levels, refits
from bayesterra.checking.holdout import Holdout
from bayesterra.checking.holdout_page import _panels, bands_without
from bayesterra.checking.short_runs import Fitted
from bayesterra.errors import StudyError
from bayesterra.likelihood.joint import draw_joint_prior, joint_posterior, whole_posterior
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.study.canonical import write_study
from bayesterra.study.study import Study
from tests.support.pages import unpainted
from tests.support.two_wheels import TABLE, MakeStudy

SENTENCE = "Refits are of the joint posterior; a wheel that is left out whole is predicted from the population."


def weighed(study: Study, seed: SeedSequence, n: int = 4000, kept: int = 300) -> Fitted:
    """Draws of the prior, drawn again by their likelihood: cheap, and near the posterior."""
    target, rng = whole_posterior(study, fewest=1), default_rng(seed)
    x = _prior(study, rng, n)
    level = target.log_prior_and_likelihood(x)[1]
    weights = np.exp(level - level.max())
    return Fitted(x[rng.choice(n, kept, p=weights / weights.sum())], float(kept), 1.0, True)


def _prior(study: Study, rng: np.random.Generator, n: int) -> np.ndarray[Any, Any]:
    if study.pooling is None:
        return draw_cut_prior(posterior(study), n, rng).x
    return draw_joint_prior(joint_posterior(study, fewest=1), n, rng, batch=n)


@pytest.fixture(name="by_slip", scope="module")
def fixture_by_slip(make: MakeStudy) -> Holdout:
    """Slip levels of two wheels with a population."""
    return bt.leave_out(make(), fit=weighed)


@pytest.fixture(name="by_wheel", scope="module")
def fixture_by_wheel(make: MakeStudy) -> Holdout:
    """Each of the two wheels left out whole."""
    return bt.leave_out(make(), "wheel", fit=weighed)


def test_every_wheel_of_a_level_has_a_panel(make: MakeStudy, by_slip: Holdout) -> None:
    """With its own band, training rows as dots, left-out rows as rings; one for a level that is a wheel."""
    plain = bt.leave_out(make(pooling=None), fit=weighed)
    for found in (plain, by_slip):
        titles = [title for title, _, _ in _panels(found)]
        assert titles[:3] == ["Wh11 without slip 0.100", "Wh32 without slip 0.100", "Wh11 without slip 0.250"]
        assert len(titles) == 6
        second = bands_without(found)[0, 1]
        dots, rings = (line.get_xydata().tolist() for line in second.lines[1:])
        assert rings == [[0.1, 14.0]]
        assert dots == [[0.25, 20.5], [0.5, 24.5]]
    by_wheel = bt.leave_out(make(pooling=None), "wheel", fit=weighed)
    assert [title for title, _, _ in _panels(by_wheel)] == ["without Wh11", "without Wh32"]


def test_a_wheel_at_several_sites_has_a_panel_for_each(make: MakeStudy) -> None:
    """Named by site and wheel, with the rows of both."""
    pooling = {"by": "site", "shared": ["phi"], "hierarchical": {"K": {}}}
    found = bt.leave_out(make(pooling=pooling), [[1, 3], [5]], fit=weighed)
    (first, fold, bands), (second, _, others), (last, _, _) = _panels(found)
    assert (first, second, last) == ("a Wh11 without row 1, 3", "b Wh11 without row 1, 3", "without row 5")
    assert fold.left.nonzero()[0].tolist() == [0, 2]
    assert bands["drawbar_pull"].rows.nonzero()[0].tolist() == [0, 1]
    assert others["drawbar_pull"].rows.nonzero()[0].tolist() == [2]


def test_rows_are_predicted_by_the_values_of_their_group(make: MakeStudy) -> None:
    """Draws with a K for each wheel give each wheel's rows what the model says for its own K."""
    study = make()
    own = {"Wh11": 0.006, "Wh32": 0.03}

    def apart(training: Study, seed: SeedSequence) -> Fitted:
        names = joint_posterior(training).names
        values = {"phi": 0.52, "K.mean": 0.012, "K.spread": 0.003}
        values |= {f"K[{wheel}]": K for wheel, K in own.items()}
        return Fitted(np.tile([values[name] for name in names], (100, 1)), 100.0, 1.0, True)

    table = bt.leave_out(study, fit=apart).table
    alone = posterior(study)
    for wheel, K in own.items():
        outcomes = alone.outcomes(np.array([[0.52, K]]))["drawbar_pull"][0]
        rows = table[(table["predictor"] == "M2") & (table["channel"] == "drawbar_pull")]
        rows = rows[rows["wheel"] == wheel].sort_values("row")
        np.testing.assert_allclose(rows["q50"], outcomes[rows["row"].to_numpy() - 1], rtol=1e-9)


def test_values_of_an_absent_group_come_from_the_population(make: MakeStudy) -> None:
    """Given each draw's mean and spread; those of a group in the fit, and what is shared, are as drawn."""
    study = make()
    training = study.with_use(np.array(study.observations.wheel) == "Wh11")
    joint, rng = joint_posterior(training, fewest=1), default_rng(2)
    x = draw_joint_prior(joint, 3000, rng, batch=3000)
    assert joint.names == ("phi", "K.mean", "K.spread", "K[Wh11]")
    np.testing.assert_array_equal(joint.one_group("Wh11", x, rng)[1], x[:, [0, 3]])
    values = joint.one_group("Wh32", x, rng)[1]
    np.testing.assert_array_equal(values[:, 0], x[:, 0])
    mean, spread = x[:, 1], x[:, 2]
    ends = [(end - mean) / spread for end in study.prior.laws["K"].range]
    assert kstest(truncnorm.cdf((values[:, 1] - mean) / spread, *ends), "uniform").pvalue > 1e-3


def test_a_wheel_that_is_left_out_whole_is_predicted_more_widely(by_slip: Holdout, by_wheel: Holdout) -> None:
    """By the population that the other wheel tells of; the table of refits says which wheel has no rows."""
    assert [*by_wheel.refits["note"]] == ["not in the fit: Wh11", "not in the fit: Wh32"]
    assert [*by_slip.refits["note"]] == [""] * 3
    widths = []
    for found in (by_slip, by_wheel):
        own = found.table[(found.table["predictor"] == "M2") & (found.table["channel"] == "drawbar_pull")]
        assert len(own) == 6
        widths.append((own["q95"] - own["q05"]).mean())
    assert widths[1] > 2 * widths[0]


def test_page_record_and_terminal_say_how_groups_were_treated(
    make: MakeStudy, by_wheel: Holdout, tmp_path: Path
) -> None:
    """In one sentence, which names the prior where values are separate; nothing of it without groups."""
    with unpainted():
        page = by_wheel.save(tmp_path / "out").read_text(encoding="utf-8")
    assert SENTENCE in page
    assert "not in the fit: Wh32" in page
    assert json.loads((tmp_path / "out" / Holdout.MARK).read_text(encoding="utf-8"))["basis"] == SENTENCE
    assert any(SENTENCE in str(block) for block in by_wheel.overview())
    assert by_wheel.study.notes[-1].startswith("groups by wheel: Wh11, Wh32; least squares and 'follow'")
    separate = make(pooling={"shared": [], "separate": ["K"], "hierarchical": {"phi": {}}}).pooling
    assert separate is not None
    assert separate.left_out.endswith("is predicted from the population and the prior.")
    plain = bt.leave_out(make(pooling=None), "wheel", fit=weighed)
    assert "basis" not in plain.record
    assert "joint posterior" not in plain.page().html()


def test_the_command_takes_a_study_with_groups(
    make: MakeStudy, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """From a folder with its study, as a study or a result is."""
    monkeypatch.setattr("bayesterra.checking.holdout.refits", lambda study: weighed)
    (tmp_path / "pooled").mkdir()
    write_study(make(), tmp_path / "pooled")
    asked = ["holdout", str(tmp_path / "pooled"), "--by", "wheel", "--workers", "1", "--quiet"]
    with unpainted():
        assert main([*asked, "--out", str(tmp_path / "out")]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert SENTENCE in printed
    assert "not in the fit: Wh11" in (tmp_path / "out" / "refits.csv").read_text(encoding="utf-8")


def test_rows_of_one_group_only_are_refused(make: MakeStudy) -> None:
    """Before anything is sampled: there is nothing that groups could share."""
    study = make(data=TABLE.assign(use=[1, 1, 1, 0, 0, 0]))
    message = r"^\[pooling\] needs rows in use of at least two groups in 'wheel' \(got one\)$"
    with pytest.raises(StudyError, match=message):
        bt.leave_out(study, fit=weighed)


def test_refits_have_the_sampler_of_their_kind(make: MakeStudy) -> None:
    """Chosen by the [pooling] table; both ask for the same effective draws."""
    assert refits(make()) is GROUP_REFITS
    assert refits(make(pooling=None)) is REFITS
    assert GROUP_REFITS.short.target_ess == REFITS.short.target_ess == 1000


READ = TABLE.rename(columns={"load [N]": "normal_force [N]"})
PULL = {"drawbar_pull": 1.0, "resistance_moment": 0.3}
FORCE = {**PULL, "normal_force": 2.0}
KINDS: dict[str, dict[str, Any]] = {
    "both": {"drive": "both", "load_range": ["20 N", "160 N"], "data": READ, "noise": FORCE},
    "steps": {"noise": {**PULL, "drawbar_pull": {"sd": 1.0, "resolution": 2.0}}},
    "limits": {"data": TABLE.assign(**{"drawbar_pull [N]": ["14.5", "21.5", ">23", "14", "20.5", "24.5"]})},
    "discrepancy": {"discrepancy": {"drawbar_pull": {"sd": 1.0, "length": 0.3}}},
    "ripple": {"ripple": {"drawbar_pull": {"sd": 1.0, "memory": 2.0}}},
    "slip": {"slip": {"sd": 0.01}},
}


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_reading_is_predicted_with_groups(make: MakeStudy, kind: str) -> None:
    """Of a wheel that is in the fit, and of one that is not: all refits run, all rows have a law."""
    study = make(**KINDS[kind])
    for by in ("wheel", [[1, 4]]):
        found = bt.leave_out(study, by, fit=weighed)
        assert [outcome.status for outcome in found.outcomes] == ["converged"] * len(levels(study, by))
        own = found.table[found.table["predictor"] == "M2"]
        assert own["crps"].notna().all()
        assert all(np.isfinite(band.middle).all() for outcome in found.outcomes for band in outcome.bands)


@pytest.mark.slow
def test_a_refit_samples_the_joint_posterior_of_the_wheel_that_is_left(make: MakeStudy) -> None:
    """By the default sampler: converged, and quantiles as from weighted draws of the prior."""
    study = make()
    sampled = bt.leave_out(study, "wheel")
    assert sampled.converged
    assert sampled.refits["ess"].min() >= 1000
    by_weights = bt.leave_out(study, "wheel", fit=partial(weighed, n=200_000, kept=1000)).table
    keys = ["predictor", "row", "channel"]
    ours, theirs = (t[t["predictor"] == "M2"].set_index(keys) for t in (sampled.table, by_weights))
    width = ours["q95"] - ours["q05"]
    for name in ("q05", "q50", "q95"):
        assert (((ours[name] - theirs[name]) / width).abs() < 0.15).all()
