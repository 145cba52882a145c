"""The [pooling] table: what is understood, and what people are told of what is not."""

from pathlib import Path
from typing import Any

import pytest

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.errors import StudyError
from bayesterra.stats.laws import Law
from bayesterra.study.canonical import write_study
from bayesterra.study.study import load_study
from tests.support.two_wheels import TABLE, WHEELS, MakeStudy


def test_parameters_in_no_list_are_shared(make: MakeStudy) -> None:
    """Also where nothing is said of the column."""
    pooling = make(pooling={"separate": ["K"]}).pooling
    assert pooling is not None
    assert (pooling.by, pooling.shared, pooling.separate) == ("wheel", ("phi",), ("K",))


def test_default_spread_is_half_the_priors_sd(make: MakeStudy) -> None:
    """And the mean has the parameter's own law."""
    pooling = make().pooling
    assert pooling is not None
    spread = pooling.hierarchical["K"].spread
    assert spread is not None
    assert spread.shape["scale"] == pytest.approx(0.5 * 0.048 / 12**0.5, rel=1e-3)
    assert pooling.hierarchical["K"].mean == Law("uniform", lower=0.002, upper=0.05)


def test_study_is_read_back_as_it_was_written(make: MakeStudy, tmp_path: Path) -> None:
    """With labels, roles and laws of populations."""
    study = make(pooling={"by": "site", "hierarchical": {"K": {"spread": {"dist": "halfnorm", "scale": 0.003}}}})
    write_study(study, tmp_path)
    assert load_study(tmp_path).fingerprint == study.fingerprint


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({"shard": ["c"]}, "unknown key 'shard' (did you mean 'shared'?)"),
        ({"by": "day"}, "'by' must be one of the columns wheel, site, run (got 'day')"),
        ({"separate": "K"}, "'separate' must be a list of parameters (got 'K')"),
        ({"separate": ["phii"]}, "unknown parameter 'phii' (did you mean 'phi'?)"),
        ({"separate": ["K"], "shared": ["K"]}, "'K' must stand in one list only"),
        ({"separate": ["n0"]}, "[pooling] 'n0' is fixed or tied: name free parameters (phi, K)"),
        ({"shared": ["K"]}, "[pooling] needs a 'separate' or 'hierarchical' parameter"),
        ({"separate": ["phi", "K"]}, "[pooling] needs a 'shared' or 'hierarchical' parameter"),
        ({"by": "run", "separate": ["K"]}, "[pooling] column 'run' is not in the table"),
        ({"hierarchical": {"K": {"sd": 1}}}, "'hierarchical.K' takes 'mean' and 'spread' (got 'sd')"),
        (
            {"hierarchical": {"K": {"spread": {"dist": "norm", "scale": 0.01}}}},
            "'K.spread' must be a law of numbers from 0 on (got one from -inf on)",
        ),
    ],
)
def test_mistakes_are_named(make: MakeStudy, table: dict[str, Any], message: str) -> None:
    """In one line, with what was expected."""
    with pytest.raises(StudyError) as raised:
        make(pooling=table)
    assert message in str(raised.value)


def test_each_group_is_a_study_of_its_own(make: MakeStudy) -> None:
    """With its rows in the fit and their wheels, under the same prior, and no groups."""
    alone = make(data=TABLE.assign(use=[1, 1, 0, 1, 1, 1])).by_group()
    assert list(alone) == ["Wh11", "Wh32"]
    for name, study in alone.items():
        assert study.pooling is None
        assert list(study.wheels) == [name]
        assert set(study.observations.wheel) == {name}
    assert len(alone["Wh11"].observations.used()) == 2
    assert alone["Wh32"].fingerprint == make(
        data=TABLE[TABLE["wheel"] == "Wh32"], wheels={"Wh32": WHEELS["Wh32"]}, pooling=None
    ).fingerprint | {"data": alone["Wh32"].fingerprint["data"]}
    sites = make(pooling={"by": "site", "separate": ["K"]}).by_group()
    assert {name: list(study.wheels) for name, study in sites.items()} == {"a": ["Wh11", "Wh32"], "b": list(WHEELS)}
    plain = make(pooling=None)
    assert plain.by_group() == {"": plain}


def test_least_squares_takes_groups_one_by_one(
    make: MakeStudy, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Each table under its group's name, with the fit to that group's rows alone."""
    study = make()
    write_study(study, tmp_path)
    assert main(["fit", str(tmp_path), "--method", "joint"]) == 0
    printed = capsys.readouterr().out
    parts = printed.split("Group ")[1:]
    assert [part.split(",")[0] for part in parts] == list(WHEELS)
    for part, alone in zip(parts, study.by_group().values(), strict=True):
        value = 1e3 * bt.fit(alone, ["joint"])["joint"].values()["K"]
        assert f"{value:.4g}" in next(line for line in part.splitlines() if line.split()[:1] == ["K"])
