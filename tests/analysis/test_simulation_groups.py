"""Simulated measurements of groups: each by its own values, which are given or drawn from a population."""

from pathlib import Path

import numpy as np
import pytest

from bayesterra.__main__ import main
from bayesterra.analysis.simulation import simulate, true_values, write_simulated
from bayesterra.errors import StudyError
from bayesterra.likelihood.joint import joint_posterior
from bayesterra.likelihood.page import study_overview
from bayesterra.report.blocks import Table
from bayesterra.report.terminal import show
from bayesterra.study.canonical import write_study
from bayesterra.study.study import load_study
from tests.support.two_wheels import MakeStudy

OWN = {"phi": 0.5, "K[Wh11]": 0.006, "K[Wh32]": 0.02}
EXACT = {"drawbar_pull": 1e-9, "resistance_moment": 1e-9}


def test_rows_of_a_group_are_made_with_its_values(make: MakeStudy) -> None:
    """Without noise the readings of a wheel are those of a study of its own with its own K."""
    study = make(noise=EXACT)
    table = simulate(study, OWN)
    plain = make(noise=EXACT, pooling=None)
    for wheel in ("Wh11", "Wh32"):
        alone = simulate(plain, {"phi": 0.5, "K": OWN[f"K[{wheel}]"]})
        for column in ("drawbar_pull [N]", "resistance_moment [N m]"):
            mine = table["wheel"] == wheel
            np.testing.assert_allclose(table[column][mine], alone[column][mine], atol=1e-7)


def test_values_come_from_where_they_are_stated(make: MakeStudy) -> None:
    """A group's own before that of all; from the population where that is known; else medians."""
    study = make(truth={"K": 0.01, "phi": 0.52})
    found = true_values(study, {"K[Wh32]": "15 mm"})
    assert [found.values[name] for name in ("K[Wh11]", "K[Wh32]")] == pytest.approx([0.01, 0.015])
    assert [found.origins[name] for name in ("K[Wh11]", "K[Wh32]", "phi")] == ["truth", "given", "truth"]
    assert "K" not in found.values
    of_population = {"K.mean": 0.012, "K.spread": 0.001}
    drawn = [true_values(make(), of_population, seed=seed).values["K[Wh11]"] for seed in range(200)]
    assert np.mean(drawn) == pytest.approx(0.012, abs=4 * 0.001 / np.sqrt(200))
    assert np.std(drawn) == pytest.approx(0.001, rel=0.2)
    assert true_values(make(), of_population, seed=3) == true_values(make(), of_population, seed=3)
    assert set(true_values(make()).origins.values()) == {"fixed", "prior median"}


def test_a_simulated_study_is_read_back_with_its_truth(make: MakeStudy, tmp_path: Path) -> None:
    """By names of groups; the joint posterior is as dense there as its draws are."""
    (tmp_path / "made").mkdir()
    write_study(make(), tmp_path / "made")
    asked = ["--set", "phi=28 deg", "--set", "K.mean=12 mm", "--set", "K.spread=3 mm", "--seed", "5"]
    assert main(["simulate", str(tmp_path / "made"), *asked, "--out", str(tmp_path / "simulated")]) == 0
    back = load_study(tmp_path / "simulated")
    assert back.truth is not None
    joint = joint_posterior(back)
    truth = np.array([[back.truth.values[name] for name in joint.names]])
    log_likelihood = joint.log_prior_and_likelihood(truth)[1][0]
    sd = np.tile([1.0, 0.3], 6)
    expected = -0.5 * len(sd) - np.log(sd).sum() - 0.5 * len(sd) * np.log(2 * np.pi)
    assert log_likelihood == pytest.approx(expected, abs=4 * np.sqrt(len(sd) / 2))
    alone = back.by_group()["Wh11"].truth
    assert alone is not None
    assert alone.values["K"] == back.truth.values["K[Wh11]"]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("K[Wh99]", r"unknown parameter 'K\[Wh99\]' \(did you mean 'K\[Wh\d\d\]'\?\)"),
        ("phi[Wh11]", r"unknown parameter 'phi\[Wh11\]'"),
        ("c.mean", r"unknown parameter 'c.mean'"),
    ],
)
def test_unknown_names_are_refused(make: MakeStudy, name: str, message: str) -> None:
    """Of groups that do not exist, of what is shared, of what has no population; in [truth] as when given."""
    with pytest.raises(StudyError, match=f"^{message}"):
        simulate(make(), {name: 1.0})
    with pytest.raises(StudyError, match=rf"^\[truth\] {message}"):
        make(truth={name: 1.0})
    with pytest.raises(StudyError, match=r"^\[truth\] unknown parameter 'K\[Wh11\]'"):
        make(pooling=None, truth={"K[Wh11]": 0.01})


def test_nothing_is_written_twice(make: MakeStudy, tmp_path: Path) -> None:
    """What is written is what was drawn."""
    made = write_simulated(make(), tmp_path / "out", seed=4, truth={"phi": 0.5, "K.mean": 0.01, "K.spread": 0.002})
    truth = load_study(tmp_path / "out").truth
    assert truth is not None
    assert truth.values == pytest.approx(dict(made.values), rel=1e-12)


def test_check_shows_the_parameters_of_groups(make: MakeStudy, capsys: pytest.CaptureFixture[str]) -> None:
    """Their number, laws of populations, and the prior's support of each group."""
    overview = study_overview(make())
    show(overview)
    printed = " ".join(capsys.readouterr().out.split())
    assert "Prior: 5 free parameters" in printed
    roles = {row[0]: row[-1] for block in overview if isinstance(block, Table) for row in block.rows}
    spread = "hierarchical: mean flat from 2 to 50&nbsp;mm, spread halfnorm (scale 6.928203&nbsp;mm)"
    assert (roles["K"], roles["phi"]) == (spread, "shared")
    assert "Of the stated prior, Wh32 alone: 100 % inside the support" in printed
    show(study_overview(make(pooling=None)))
    assert "Of the stated prior: 100 % inside the support" in " ".join(capsys.readouterr().out.split())
