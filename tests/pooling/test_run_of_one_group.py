"""One group of a joint posterior as a result of its own, and predictions of groups that were not tested."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from numpy.random import default_rng
from scipy.stats import halfnorm, kstest, norm, truncnorm

import bayesterra as bt
from bayesterra.errors import StudyError
from bayesterra.likelihood.joint import draw_joint_prior, joint_posterior
from bayesterra.pooling.run import PooledResult, _dataset
from bayesterra.prediction import prediction
from bayesterra.prediction.outlook import RoverOutlook
from bayesterra.stats.laws import Law
from bayesterra.study.study import Study
from tests.support.two_wheels import WHEELS, MakeStudy

DRAWS = 3000
SAVED = "wheel.toml"


def _result(study: Study) -> PooledResult:
    """A result whose posterior is the joint prior: what is known of it is known exactly."""
    joint = joint_posterior(study)
    x = draw_joint_prior(joint, 2 * DRAWS, default_rng(4))
    tree = {"posterior": _dataset(joint, x[:DRAWS].reshape(4, DRAWS // 4, -1)), "prior": _dataset(joint, x[None])}
    empty = pd.DataFrame()
    return PooledResult(
        study=study, draws=xr.DataTree.from_dict(tree), summary=pd.DataFrame({"parameter": joint.names}),
        record={"verdict": {"converged": True}}, pooling=empty, sharing=empty, left_out=empty,
    )  # fmt: skip


@pytest.fixture(name="result", scope="module")
def fixture_result(make: MakeStudy) -> PooledResult:
    """φ shared, K of each wheel from one population."""
    return _result(make())


@pytest.fixture(name="file")
def fixture_file(tmp_path: Path) -> Path:
    """A wheel that was not tested, in a file."""
    lines = 'radius = "140 mm"\nwidth = "160 mm"\nlug_height = "5 mm"\nlug_count = 24\n'
    (tmp_path / SAVED).write_text(lines, encoding="utf-8")
    return tmp_path / SAVED


def test_a_group_has_its_own_values_and_the_shared_ones(result: PooledResult) -> None:
    """In the order of an ordinary result, with the group's rows and wheel."""
    alone, draws = result.of_group("Wh32"), result.draws["posterior"]
    assert alone.names == ("phi", "K")
    np.testing.assert_array_equal(alone.values()[:, 0], draws["phi"].to_numpy().ravel())
    np.testing.assert_array_equal(alone.values()[:, 1], draws["K"].sel(group="Wh32").to_numpy().ravel())
    assert set(alone.study.observations.wheel) == {"Wh32"}
    assert list(alone.study.wheels) == ["Wh32"]
    assert alone.study.pooling is None
    assert result.study.pooling is not None


def test_a_group_that_was_not_tested_is_drawn_from_the_population(result: PooledResult) -> None:
    """Given each draw's mean and spread its values are uniform under the population's law, and no wheel's."""
    alone, draws = result.of_group(), result.draws["posterior"]
    law = result.study.prior.laws["K"]
    mean, spread = (draws[f"K.{part}"].to_numpy().ravel() for part in ("mean", "spread"))
    ends = [(end - mean) / spread for end in law.range]
    K = alone.values()[:, 1]
    assert kstest(truncnorm.cdf((K - mean) / spread, *ends), "uniform").pvalue > 1e-3
    np.testing.assert_array_equal(alone.values()[:, 0], draws["phi"].to_numpy().ravel())
    assert not any((draws["K"].sel(group=group).to_numpy().ravel() == K).any() for group in result.groups)
    again = result.of_group(seed=1).values()
    np.testing.assert_array_equal(again, alone.values())
    assert (result.of_group(seed=2).values()[:, 1] != K).all()


def test_a_group_that_was_not_tested_has_a_summary_without_a_mode(result: PooledResult) -> None:
    """Of its own draws; shared rows are those of the joint posterior."""
    alone = result.of_group()
    row = alone.summary.set_index("parameter").loc["K"]
    assert row["median"] == pytest.approx(1e3 * np.median(alone.values()[:, 1]))
    assert np.isnan(row["mode"])
    assert row["unit"] == "mm"


def test_the_law_of_a_new_group_is_that_of_the_hierarchy(make: MakeStudy) -> None:
    """Mean and variance of a normal hierarchy without limits: those of its mean, and both variances."""
    mean, spread = Law("norm", {"loc": 0.012, "scale": 1e-4}), Law("halfnorm", {"scale": 3e-4})
    study = make(pooling={"shared": ["phi"], "hierarchical": {"K": {"mean": mean, "spread": spread}}})
    K = _result(study).of_group().values()[:, 1]
    rng, n = default_rng(7), 400_000
    exact = norm.rvs(0.012, 1e-4, n, random_state=rng) + halfnorm.rvs(0, 3e-4, n, random_state=rng) * norm.rvs(
        size=n, random_state=rng
    )
    assert kstest(K, np.sort(exact)).pvalue > 1e-3


def test_separate_values_of_a_new_group_are_those_of_the_prior(make: MakeStudy) -> None:
    """As no group tells anything of another."""
    study = make(pooling={"shared": ["phi"], "separate": ["K"]})
    K = _result(study).of_group().values()[:, 1]
    assert kstest(study.prior.laws["K"].cdf(K), "uniform").pvalue > 1e-3


def test_a_wheel_of_the_study_is_predicted_by_its_own_group(result: PooledResult) -> None:
    """As an ordinary result with these draws would predict it."""
    ours = bt.predict(result, [0.2, 0.4], wheel="Wh32")
    theirs = bt.predict(result.of_group("Wh32"), [0.2, 0.4], wheel="Wh32")
    np.testing.assert_array_equal(ours.modelled, theirs.modelled)
    assert ours.notes[0] == "parameters are those of Wh32 in the joint posterior of Wh11, Wh32"
    other = bt.predict(result, [0.2, 0.4], wheel="Wh32", group="Wh11")
    assert (other.modelled[:, 0, 1] != ours.modelled[:, 0, 1]).mean() > 0.9


def test_a_wheel_in_a_file_is_predicted_by_the_population(result: PooledResult, file: Path, tmp_path: Path) -> None:
    """And the first note says where its parameters are from."""
    found = bt.predict(result, [0.2, 0.4], wheel=file)
    untested = result.of_group()
    soil = untested.values()[:: -(-DRAWS // 2000)]
    assert len(found.index) == len(soil)
    assert found.notes[0] == "this wheel was not tested: K drawn from the population of Wh11, Wh32"
    assert not any("need not hold for another" in note for note in found.notes)
    named = bt.predict(untested, [0.2, 0.4], wheel=bt.Wheel(0.14, 0.16, 0.005, 24))
    np.testing.assert_array_equal(found.modelled, named.modelled)
    made = prediction.forecast(result, slips=[0.2], wheels=[str(file)])
    made.save(tmp_path / "out")
    assert "drawn from the population" in (tmp_path / "out" / "prediction.json").read_text(encoding="utf-8")


def test_a_rover_says_where_its_parameters_are_from(make: MakeStudy, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the wheel that it has at both axles, of a group by name, or of the population."""
    monkeypatch.setattr("bayesterra.prediction.outlook.DRAWS", 50)
    result = _result(make())
    wheels = result.study.wheels

    def driven(front: str, rear: str, group: str | None = None) -> RoverOutlook:
        rover = bt.Rover(
            name="r", weight=320.0, wheelbase=0.8, centre_height=0.3, centre_ahead=0.4, tow_height=0.2,
            wheels=(wheels[front], wheels[rear]),
        )  # fmt: skip
        return bt.predict_rover(result, rover, slopes=["5 deg"], group=group)

    own = driven("Wh32", "Wh32")
    assert own.notes[0] == "parameters are those of Wh32 in the joint posterior of Wh11, Wh32"
    alone = bt.predict_rover(result.of_group("Wh32"), own.rover, slopes=["5 deg"])
    pd.testing.assert_frame_equal(own.table, alone.table)
    assert driven("Wh32", "Wh32", "Wh11").notes[0].startswith("parameters are those of Wh11")
    mixed = driven("Wh11", "Wh32")
    assert mixed.notes[0] == "this wheel was not tested: K drawn from the population of Wh11, Wh32"
    assert not any("need not hold for another" in note for note in mixed.notes)
    with pytest.raises(StudyError, match=r"unknown group 'Wh23' \(.*Wh32"):
        driven("Wh32", "Wh32", "Wh23")


def test_a_rover_on_wheels_of_one_size_has_the_group_of_their_name(
    make: MakeStudy, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two groups' wheels at its axles, or none's by name, are told apart; the first only where no name says more."""
    monkeypatch.setattr("bayesterra.prediction.outlook.DRAWS", 50)
    result = _result(make(wheels=dict.fromkeys(WHEELS, WHEELS["Wh32"])))

    def told(front: str, rear: str) -> str:
        rover = bt.Rover(
            name="r", weight=320.0, wheelbase=0.8, centre_height=0.3, centre_ahead=0.4, tow_height=0.2,
            wheels=(WHEELS["Wh32"], WHEELS["Wh32"]), wheel_names=(front, rear),
        )  # fmt: skip
        return bt.predict_rover(result, rover, slopes=["5 deg"]).notes[0]

    assert told("Wh32", "Wh32").startswith("parameters are those of Wh32 ")
    assert told("front wheel", "rear wheel").startswith("parameters are those of Wh11 ")
    assert told("Wh11", "Wh32").startswith("this wheel was not tested")


def test_groups_by_site_take_a_name_or_none(make: MakeStudy) -> None:
    """A new site by default, one of those that were driven by name."""
    result = _result(make(pooling={"by": "site", "shared": ["phi"], "hierarchical": {"K": {}}}))
    assert bt.predict(result, 0.3).notes[0].startswith("this site was not tested: K drawn from the population of")
    assert "those of b in the joint" in bt.predict(result, 0.3, group="b").notes[0]


def test_an_unknown_group_is_refused(result: PooledResult) -> None:
    """And a group of a result that has none."""
    with pytest.raises(StudyError, match=r"unknown group 'Wh23' \(.*Wh32"):
        bt.predict(result, 0.3, group="Wh23")
    with pytest.raises(StudyError, match=r"'group' needs a result with groups, of a study with \[pooling\]"):
        bt.predict(result.of_group("Wh11"), 0.3, group="Wh11")
    assert list(WHEELS) == list(result.groups)
