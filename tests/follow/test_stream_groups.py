"""Rows of several groups, one after the other: what they share, and what each has from its first row on."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from scipy.special import logsumexp

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError
from bayesterra.follow.session import follow
from bayesterra.follow.stream import load_stream
from bayesterra.likelihood.joint import JointPosterior, joint_posterior
from bayesterra.stats.mixture import normalised, weighted_quantiles
from bayesterra.study.study import Study
from tests.support.joint_rows import HELD, joined

ROWS = pd.DataFrame(
    {
        "wheel": ["A", "A", "B", "A", "B", "B"],
        "site": ["x", "x", "y", "x", "y", "y"],
        "slip": [0.15, 0.3, 0.2, 0.4, 0.35, 0.45],
        "load [N]": 80.0,
        "sinkage [mm]": [8.2, 14.0, 13.0, 19.0, 20.0, 26.0],
        "drawbar_pull [N]": [16.5, 20.5, 17.0, 21.2, 19.0, 19.5],
        "resistance_moment [N m]": [4.2, 5.3, 4.5, 5.5, 5.3, 5.6],
    }
)
NOISE = {"sinkage": 2e-3, "drawbar_pull": 1.5, "resistance_moment": 0.4}
LAWS = {
    "phi": {"dist": "norm", "loc": 0.5, "scale": 0.05},
    "K": {"dist": "norm", "loc": 0.0131, "scale": 0.003, "lower": 1e-3, "upper": 0.05},
}
KNOWN = {name: value for name, value in HELD.items() if name not in LAWS}
CASES: dict[str, dict[str, Any]] = {
    "own": {"pooling": {"shared": ["phi"], "separate": ["K"]}},
    "population": {"pooling": {"hierarchical": {"K": {}}}},
    "own, curve": {
        "pooling": {"shared": ["phi"], "separate": ["K"]},
        "discrepancy": {"drawbar_pull": {"sd": 1.0, "length": 0.3}},
    },
    "own, limits": {
        "pooling": {"by": "site", "separate": ["K"]},
        "data": ROWS.assign(**{"drawbar_pull [N]": pd.Series([16.5, 20.5, 17.0, ">20.5", "<20", 19.5], dtype=object)}),
    },
    "limits under latent loads": {
        "pooling": {"separate": ["K"]},
        "drive": "both",
        "load_range": ["40 N", "120 N"],
        "noise": {**NOISE, "normal_force": 4.0},
        "data": ROWS.rename(columns={"load [N]": "normal_force [N]"}).assign(
            **{"normal_force [N]": pd.Series([80.0, ">75", 80.0, 82.0, "<79", 80.0], dtype=object)}
        ),
    },
}


def study(**tables: Any) -> Study:
    """Two wheels with φ and K free."""
    given = {"data": ROWS, "noise": NOISE, **tables}
    return joined(**given, priors={**KNOWN, **LAWS})


def weighed(joint: JointPosterior, n: int = 60_000) -> tuple[float, FloatArray]:
    """Log evidence, and quantiles (3, d), by draws of the stated prior and their weights."""
    x = joint.prior.sample(n, default_rng(1))
    prior, level = joint.log_prior_and_likelihood(x)
    level = np.where(np.isfinite(prior), level, -np.inf)
    weights = normalised(level)
    assert 1 / (weights**2).sum() > 300
    return float(logsumexp(level) - np.log(n)), weighted_quantiles(x, weights, (0.05, 0.5, 0.95))


@pytest.mark.parametrize("name", list(CASES))
def test_rows_of_groups_add_up_to_their_joint_posterior(name: str) -> None:
    """Evidence and quantiles after all rows, against weighted draws of the joint prior."""
    whole = study(**CASES[name])
    joint = joint_posterior(whole)
    evidence, expected = weighed(joint)
    stream = bt.Stream(whole, particles=2000, seed=2)
    table = CASES[name].get("data", ROWS)
    for number, (_, row) in enumerate(table.iterrows()):
        update = stream.add(row)
        seen = dict.fromkeys(table["wheel"][: number + 1])
        own = [name for name in update.names if name.startswith("K[")]
        assert len(own) == len(seen)
    assert stream.names == joint.names
    assert stream.log_evidence == pytest.approx(evidence, abs=4 * stream.log_evidence_error + 0.1)
    width = expected[2] - expected[0]
    assert (np.abs(update.quantiles - expected) < 0.1 * width).all()
    level = joint.log_prior_and_likelihood(stream.cloud.x)[1]
    np.testing.assert_allclose(stream.cloud.log_likelihood, level, atol=1e-7)
    assert stream.alarm is None
    assert stream.watch.rate is None


def test_a_group_begins_with_what_the_others_share() -> None:
    """What is expected of its first row comes from the shared values, and from the prior of its own."""
    stream = bt.Stream(study(**CASES["own"]), particles=2000)
    with pytest.raises(StudyError, match=r"has parameters from its first row on \(it has no row yet\)"):
        _ = stream.draws
    for index in (0, 1, 3):
        stream.add(ROWS.iloc[index])
    before = stream.draws
    update = stream.add(ROWS.iloc[2])
    assert list(before.columns) == ["phi", "K[A]", "weight"]
    assert update.names == ("phi", "K[A]", "K[B]")
    alone = bt.Stream(study(**CASES["own"]), particles=2000).add(ROWS.iloc[2])
    width, untold = (each.forecast.quantiles[2] - each.forecast.quantiles[0] for each in (update, alone))
    pull = update.forecast.channels.index("drawbar_pull")
    assert width[pull] < 0.8 * untold[pull]
    below = update.forecast.quantiles[0] < update.forecast.observed
    assert (below & (update.forecast.observed < update.forecast.quantiles[2])).all()


@pytest.mark.parametrize("name", ["own, curve", "own, limits"])
def test_a_stream_of_groups_is_put_down_and_taken_up(name: str, tmp_path: Path) -> None:
    """It goes on to the last bit, labels and limits too."""
    table = CASES[name].get("data", ROWS)
    stream = bt.Stream(study(**CASES[name]), particles=200)
    for index in (0, 1, 2, 3):
        stream.add(table.iloc[index])
    stream.save(tmp_path / "stream")
    again = load_stream(tmp_path / "stream")
    assert again.names == stream.names
    updates = [each.add(table.iloc[4]) for each in (stream, again)]
    np.testing.assert_array_equal(updates[0].quantiles, updates[1].quantiles)
    assert updates[0].log_evidence == updates[1].log_evidence


def test_a_table_of_groups_is_followed(tmp_path: Path) -> None:
    """Row by row from a file; the table names the group, whose values have columns from its first row on."""
    tables = CASES["own, limits"]
    file = tmp_path / "rows.csv"
    tables["data"].to_csv(file, index=False)
    whole = study(**tables)
    folder = tmp_path / "study"
    folder.mkdir()
    from bayesterra.study.canonical import write_study

    write_study(whole, folder)
    found = follow(folder, file, out=tmp_path / "followed", particles=200)
    updates = pd.read_csv(tmp_path / "followed" / "updates.csv")
    assert updates["site"].tolist() == ["x", "x", "y", "x", "y", "y"]
    assert updates["K[y]_q50 [mm]"].notna().tolist() == [False, False, True, True, True, True]
    assert found.left_out == 0
    text = (tmp_path / "followed" / "stream.json").read_text(encoding="utf-8")
    assert '"rows": 6' in text
    assert "K[y]" in str(found.overview())
    assert (tmp_path / "followed" / "rows.png").stat().st_size > 10_000


def test_limits_are_given_as_text() -> None:
    """In a call as in a table; a reading known by a limit is not held against what was expected of it."""
    one = joined("phi", data=ROWS.assign(wheel="A"))
    stream = bt.Stream(one, particles=200)
    told: dict[str, Any] = {"slip": 0.2, "load": 80.0, "wheel": "A", "sinkage": "10.2 mm", "resistance_moment": 4.8}
    update = stream.add(**told, drawbar_pull=">18 N")
    assert np.isnan(update.pit["drawbar_pull"])
    assert stream.rows.first().limits["drawbar_pull"].tolist() == [[-np.inf, 18.0]]
    with pytest.raises(StudyError, match="'drawbar_pull' must be"):
        stream.add(**told, drawbar_pull=">much")


def test_a_row_with_a_limit_is_not_watched() -> None:
    """The filters of a change of soil know nothing of limits: no candidate begins there, and none is told."""
    one = joined("phi", data=ROWS.assign(wheel="A"))
    stream = bt.Stream(one, particles=400)
    for index in (0, 1, 3, 0, 1, 3):
        stream.add(ROWS.iloc[index].drop("site"))
    before = stream.watch.candidates
    assert len(before) > 0
    told = ROWS.iloc[1].drop(["site", "drawbar_pull [N]"])
    stream.add({**told, "drawbar_pull [N]": ">18"})
    assert stream.watch.candidates is before
    stream.add({**told, "drawbar_pull [N]": 20.5})
    assert len(stream.watch.candidates) == len(before) + 1


def test_values_that_no_soil_has_get_no_weight() -> None:
    """Of a group that comes later, whose stated law reaches outside the physical range."""
    laws = {"c": {"dist": "norm", "loc": 100.0, "scale": 300.0}, "phi": LAWS["phi"]}
    held = {name: value for name, value in HELD.items() if name not in laws}
    pooling = {"shared": ["phi"], "separate": ["c"]}
    whole = joined(data=ROWS, noise=NOISE, pooling=pooling, priors={**held, **laws})
    stream = bt.Stream(whole, particles=1000)
    for index in (0, 1, 2):
        stream.add(ROWS.iloc[index])
    draws = stream.draws
    outside = (draws[["c[A]", "c[B]"]] < 0).any(axis=1)
    assert draws["weight"][outside].sum() == 0
    joint = joint_posterior(whole)
    x = draws[list(joint.names)].to_numpy()
    assert np.isneginf(joint.log_prior(np.where(x == x[:, [1]], -1.0, x))).all()
    inside = np.flatnonzero(~outside)
    prior = joint.log_prior_and_likelihood(x[inside])[0]
    np.testing.assert_allclose(joint.log_prior(x[inside]), prior, rtol=1e-12)
