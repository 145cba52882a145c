"""The [pooling] table: what is understood, and what people are told of what is not."""

from pathlib import Path
from typing import Any

import pytest

from bayesterra.errors import StudyError
from bayesterra.stats.laws import Law
from bayesterra.study.canonical import write_study
from bayesterra.study.study import load_study
from tests.support.two_wheels import MakeStudy, made


@pytest.fixture(scope="module")
def make() -> MakeStudy:
    """See :func:`made`."""
    return made


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
    study = make(
        pooling={"by": "site", "hierarchical": {"K": {"spread": {"dist": "halfnorm", "scale": 0.003}}}}
    )
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
