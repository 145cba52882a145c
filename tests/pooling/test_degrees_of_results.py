"""Degrees of pooling: what rows, groups and their errors add up to, and whose convergence counts."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng

from bayesterra.likelihood.joint import JointPosterior, joint_posterior
from bayesterra.pooling import degrees
from bayesterra.pooling.degrees import LEFT_OUT_COLUMNS, Degree, degrees_of
from bayesterra.pooling.evidence import PriorShares, Weighed
from bayesterra.sampling.evidence import Evidence
from tests.support.two_wheels import made


def test_a_row_of_the_table_sums_its_own_entries() -> None:
    """Elpd of rows apart from that of groups; errors of the parts are independent, so squares add up."""
    rows = [("row", "1", -2.0, 0.3, True), ("row", "2", -3.0, 0.4, False), ("row", "4", -7.0, 1.2, False)]
    groups = [("group", "a", -5.0, 0.6, True), ("group", "b", -8.0, 0.8, True)]
    entries = [("none", what, label, elpd, error, 0.1, good) for what, label, elpd, error, good in rows + groups]
    table = pd.DataFrame(entries, columns=list(LEFT_OUT_COLUMNS))
    found = Degree(-13.0, 0.2, reliable=True, name="none", converged=True, left_out=table).row()
    assert (found["elpd_rows"], found["elpd_groups"]) == (-12.0, -13.0)
    assert (found["error_rows"], found["error_groups"]) == pytest.approx((1.3, 1.0))
    assert (found["se_rows"], found["se_groups"]) == pytest.approx((np.sqrt(3 * 7.0), 3.0))
    assert (found["unreliable_rows"], found["unreliable_groups"]) == (2, 0)
    assert (found["log_evidence"], found["log_evidence_error"]) == (-13.0, 0.2)


@pytest.fixture
def joint() -> JointPosterior:
    """Two wheels of three rows each."""
    return joint_posterior(made())


def samples(*, converged: bool, log_z: float) -> Any:
    """Two ensembles that found the same evidence."""
    adaptation = SimpleNamespace(proposal=None, log_evidence=log_z)
    return SimpleNamespace(
        diagnosis=SimpleNamespace(converged=converged),
        adaptations=[adaptation] * 2,
        target=SimpleNamespace(coordinates=None),
    )


@pytest.fixture
def weighing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Weights of draws that are known: the evidence of one group −5 or −8, of all together −12."""

    def weighed(log_z: float, groups: int) -> Weighed:
        levels = np.full((groups, 2, 50), log_z / groups)
        return Weighed(np.zeros((2, 50)), levels, tuple(np.full((3, 2, 50), -1.0) for _ in range(groups)))

    def plain(joint: JointPosterior, names: list[str], *_: object) -> Weighed:
        return weighed({"Wh11": -5.0, "Wh32": -8.0}.get(" ".join(names), -12.0), len(names))

    def shares(joint: JointPosterior, names: list[str], rng: object) -> PriorShares:
        error = {"Wh11": 0.3, "Wh32": 0.4}.get(" ".join(names), 1.2)
        return PriorShares(-1.0, error, (0.0,) * len(names))

    monkeypatch.setattr(degrees, "weigh_plain", plain)
    monkeypatch.setattr(degrees, "weigh_joint", lambda samples, rng: weighed(-11.0, 2))
    monkeypatch.setattr(degrees, "plain_shares", shares)
    monkeypatch.setattr(degrees, "joint_shares", lambda joint, rng: PriorShares(-0.5, 0.2, (0.0, 0.0)))


@pytest.mark.usefixtures("weighing")
@pytest.mark.parametrize(("first", "second"), [(True, True), (True, False), (False, True)])
def test_no_pooling_has_converged_where_every_group_has(joint: JointPosterior, *, first: bool, second: bool) -> None:
    """Whichever it is that did not; evidences of the groups add up, their errors by squares."""
    lone = {"Wh11": samples(converged=first, log_z=-5.0), "Wh32": samples(converged=second, log_z=-8.0)}
    drawn: Any = SimpleNamespace(lone=lone, diagnosis=SimpleNamespace(converged=True))
    found = degrees_of(joint, drawn, samples(converged=True, log_z=-12.0), default_rng(1))
    assert [degree.name for degree in found] == ["complete", "as stated", "none"]
    assert [degree.converged for degree in found] == [True, True, first and second]
    assert [degree.log_z for degree in found] == pytest.approx([-11.0, -10.5, -11.0])
    assert [degree.error for degree in found] == pytest.approx([1.2, 0.2, 0.5])
    groups = found[2].left_out.query("what == 'group'")
    assert groups["label"].tolist() == ["Wh11", "Wh32"]
    assert groups["elpd"].tolist() == pytest.approx([-4.0, -7.0])
    assert groups["error"].tolist() == pytest.approx([0.3, 0.4])


@pytest.mark.usefixtures("weighing")
def test_both_sources_of_an_error_join_by_squares(joint: JointPosterior, monkeypatch: pytest.MonkeyPatch) -> None:
    """Error of the integral and of the prior's share: 0.3 and 0.4 in each group are 0.5, of both √0.5."""
    known = Evidence(-5.0, 0.3, 0.5, 0.1, 0.7, 100)
    monkeypatch.setattr(degrees, "_own", lambda weighed, samples: known)
    monkeypatch.setattr(degrees, "plain_shares", lambda joint, names, rng: PriorShares(-1.0, 0.4, (0.0, 0.0)))
    lone = {name: samples(converged=True, log_z=-5.0) for name in ("Wh11", "Wh32")}
    drawn: Any = SimpleNamespace(lone=lone, diagnosis=SimpleNamespace(converged=True))
    complete, _, none = degrees_of(joint, drawn, samples(converged=True, log_z=-5.0), default_rng(1))
    assert complete.error == pytest.approx(0.5)
    assert none.error == pytest.approx(np.sqrt(0.5))
