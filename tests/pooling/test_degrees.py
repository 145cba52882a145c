"""The verdict on a parameter beside closed forms for normal posteriors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.random import default_rng

from bayesterra.likelihood.joint import JointPosterior
from bayesterra.pooling.degrees import Evidences, Level, Sharing, judged_alone, judged_as_stated, level_of, with_roles
from bayesterra.study.groups import Pooling, Population
from bayesterra.study.study import Study
from tests.support.choice import some
from tests.support.two_wheels import HELD

from .gaussian import STANDARD, Gaussian, gaussian
from .linear_soils import COMMON, POPULATION, linear_soils

MakeStudy = Callable[..., Study]
FIXED = {**HELD, "phi": 0.5, "K": 0.01, "n0": STANDARD, "n1": STANDARD}
KNOWN: dict[str, Any] = {
    "complete": Level(-1.0, 0.01, True),
    "stated": Level(-2.0, 0.01, True),
    "none": Level(-3.0, 0.01, True),
}


@pytest.fixture(scope="module")
def made(make: MakeStudy) -> Callable[..., JointPosterior]:
    """The joint posterior of a conjugate case, with roles and priors."""

    def joint(case: Gaussian, pooling: Pooling, **priors: Any) -> JointPosterior:
        roles = {"shared": ["n1"], "separate": ["n0"]}
        return case.joint(make(priors={**FIXED, **priors}, pooling=roles), pooling)

    return joint


def _sharing(log_z: float, *, error: float = 0.1, reliable: bool = True) -> Sharing:
    """Common values with a log Bayes factor against the better of two alternatives."""
    common = Level(log_z, error, reliable)
    return Sharing(("n0",), common, Level(-2.0, 0.0, True), Level(0.0, 0.0, True), "wheel")


def test_words() -> None:
    """Two errors beyond the threshold, against the better alternative, and only where weights allow it."""
    assert _sharing(3.3).verdict == "soil constant"
    assert _sharing(3.3, error=0.2).verdict == "cannot tell"
    assert _sharing(-3.3).verdict == "wheel-dependent"
    assert _sharing(-3.3, error=0.2).verdict == "cannot tell"
    assert _sharing(-50.0, reliable=False).verdict == "cannot tell"
    assert (_sharing(1.0).against_own, _sharing(1.0).log_factor) == (3.0, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("groups", "draws", "sd", "factor"),
    some([(2, 1000, 0.1, -3.0), (4, 400, 0.2, -6.0), (3, 4000, 0.05, -30.0), (12, 4000, 0.05, 2.0)], 3),
)
def test_factors_are_those_of_normal_laws(
    made: Callable[..., JointPosterior], groups: int, draws: int, sd: float, factor: float
) -> None:
    """Within stated errors, also where groups are so far apart that none has a draw at the common value."""
    case, rng = gaussian(groups, sd, default_rng(groups)), default_rng(11)
    case = case.spread_to(factor)
    joint = made(case, Pooling("wheel", ("n1",), ("n0",)))
    chains = case.chains(4, draws, rng)
    alone = Level(case.own, 0.0, True)
    found = judged_alone(Evidences(joint, chains, rng, alone, alone, alone), ["n0"])
    assert found.reliable
    for level, exact in ((found.common, case.common), (found.population, case.population)):
        assert level.error < 0.1
        assert abs(level.log_z - exact) < 4.5 * level.error + 0.005
    assert case.log_factor == pytest.approx(factor, abs=1e-6)
    assert found.verdict == ("wheel-dependent" if factor < -3.0 else "cannot tell")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("common", "populations", "spread"),
    some([(("c",), (), 0.3), ((), ("c",), 0.3), (("c", "phi"), ("K",), 0.3), (("c", "phi"), (), 2.0)], 2),
)
def test_six_groups_of_eight_parameters_have_the_evidence_of_normal_laws(
    common: tuple[str, ...], populations: tuple[str, ...], spread: float
) -> None:
    """Some 40 parameters: the laws of locals are good enough, in the far tails of all groups too."""
    soils, rng = linear_soils(6, default_rng(1), spread), default_rng(2)
    exact = soils.log_evidence(dict.fromkeys(common, COMMON) | dict.fromkeys(populations, POPULATION))
    joint = with_roles(soils.joint(), common, {name: Population() for name in populations})
    level = level_of(joint, soils.chains(2, 4000, rng), rng)
    assert level.reliable
    assert level.error < 0.1
    assert abs(level.log_z - exact) < 4.5 * level.error + 0.005
    if spread > 1.0:
        assert exact - soils.log_evidence({}) < -100.0


@pytest.mark.slow
def test_as_stated_other_parameters_keep_their_roles(made: Callable[..., JointPosterior]) -> None:
    """One n1 for all: values of n0 and their evidence are those of a joint normal law."""
    case, rng = gaussian(3, 0.1, default_rng(2)).spread_to(-8.0), default_rng(4)
    joint = made(case, Pooling("wheel", ("n1",), (), {"n0": Population()}))
    found = judged_as_stated(Evidences(joint, case.chains(2, 2000, rng), rng, **KNOWN), "n0")
    one = np.ones((3, 3))
    assert (found.common, found.population) == (KNOWN["complete"], KNOWN["stated"])
    assert abs(found.own.log_z - case.log_evidence(np.eye(3), one)) < 4.5 * found.own.error + 0.005


@pytest.mark.slow
def test_the_prior_of_a_factor_has_its_correlations(made: Callable[..., JointPosterior]) -> None:
    """A common n0 of which each group's n1 depends: evidence of the joint normal law of all."""
    case, rng = gaussian(3, 0.1, default_rng(5)), default_rng(6)
    joint = made(case, Pooling("wheel", ("n0",), ("n1",)), correlation={"n0, n1": 0.8})
    loose = made(case, Pooling("wheel", ("n0",), ("n1",)))
    found = level_of(joint, case.chains(2, 2000, rng), rng)
    one = np.ones((3, 3))
    exact = case.log_evidence(one, 0.64 * one + 0.36 * np.eye(3), 0.8 * one)
    assert abs(found.log_z - exact) < 4.5 * found.error + 0.005
    assert abs(exact - case.common) > 0.1  # and not that of independent laws
    assert loose.copula is None


def test_evidences_that_are_known_are_not_computed_again(made: Callable[..., JointPosterior]) -> None:
    """All shared, nothing shared, the study's own roles; a population of other laws is another study."""
    case = gaussian(2, 0.1, default_rng(0))
    joint = made(case, Pooling("wheel", ("n1",), (), {"n0": Population()}))
    evidences = Evidences(joint, {}, default_rng(0), **KNOWN)
    assert evidences.of(["n0", "n1"], {}) == KNOWN["complete"]
    assert evidences.of([], {}) == KNOWN["none"]
    assert evidences.of(["n1"], {"n0": Population()}) == KNOWN["stated"]
    spread = replace(joint.hyper["n0"][1], shape={"scale": 2.0})
    with pytest.raises(StopIteration):  # there are no draws of groups here to begin with
        evidences.of(["n1"], {"n0": Population(spread=spread)})
    assert with_roles(joint, ["n0"], {}).names == ("n0", "n1[g0]", "n1[g1]")
