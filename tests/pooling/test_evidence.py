"""Laws that groups' locals are integrated out by: exact at every spread, and honest where they disagree."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.random import default_rng

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.joint import draw_joint_prior, joint_posterior
from bayesterra.pooling.degrees import OUTER, _evidence
from bayesterra.pooling.evidence import DefendedDrivers, OuterLaws, Weighed, outer_laws
from bayesterra.sampling.family import JointFamily
from bayesterra.sampling.joint import fit_laws
from bayesterra.study.groups import Pooling
from bayesterra.study.study import Study
from tests.support.two_wheels import COHESION, FREE, FRICTION, SHEAR

from .gaussian import STANDARD, gaussian

MakeStudy = Callable[..., Study]
ROLES: dict[str, dict[str, Any]] = {
    "two populations, one separate": {"separate": ["K"], "hierarchical": {"c": {}, "phi": {}}},
    "three populations": {"hierarchical": {"c": {}, "phi": {}, "K": {}}},
    "beside a shared one": {"shared": ["phi"], "separate": ["K"], "hierarchical": {"c": {}}},
}


def _prepared(make: MakeStudy, roles: str, correlation: float) -> tuple[JointFamily, OuterLaws]:
    """A family, and laws fitted to draws of its prior."""
    stated = {**FREE, "c": COHESION, "phi": FRICTION, "K": SHEAR}
    pooling = {"by": "wheel", **ROLES[roles]}
    joint = joint_posterior(make(priors={**stated, "correlation": {"c, phi": correlation}}, pooling=pooling))
    family, rng = JointFamily(joint), default_rng(3)
    drivers, own = joint.split(draw_joint_prior(joint, 2000, rng))
    D = family.shared_from_physical(drivers)
    L = np.stack([family.group_from_physical(g, x) for g, x in enumerate(own)])
    k = len(joint.shared)
    alone = [(D[:, :k], one) for one in L]
    return family, outer_laws(family, fit_laws(family, D, L, rng), alone, D, L, rng)


@pytest.mark.parametrize("correlation", [0.0, 0.8])
@pytest.mark.parametrize("roles", ROLES)
def test_a_population_is_integrated_at_any_spread(make: MakeStudy, roles: str, correlation: float) -> None:
    """Its density integrates to 1, from few draws, its spread a ten thousandth of the prior or all of it."""
    family, laws = _prepared(make, roles, correlation)
    joint, rng, n, inner = family.joint, default_rng(5), 500, 8
    x = joint.draw_shared(n, rng)
    k = len(joint.shared)
    for i, (name, (mean, _)) in enumerate(joint.hyper.items()):
        x[:, k + 2 * i] = mean.median
        x[:, k + 2 * i + 1] = 10.0 ** rng.uniform(-4.0, -0.3, n)
        x[:, k + 2 * i + 1] *= float(np.diff(joint.laws[name].quantile(np.array([0.16, 0.84])))[0])
    D = family.shared_from_physical(x)
    for g, law in enumerate(laws.locals):
        L, level = law.sample(D, inner, rng)
        weights = np.exp(family.log_population(g, np.repeat(x, inner, axis=0), L)[0] - level)
        each = weights.reshape(n, inner).mean(axis=1)
        assert each.mean() == pytest.approx(1.0, abs=4.5 * each.std() / np.sqrt(n))
        assert each.std() < 1.5


def test_drivers_reach_spreads_of_nothing(make: MakeStudy) -> None:
    """Their law integrates to 1 against the stated prior, of which the neck is a part."""
    family, laws = _prepared(make, "two populations, one separate", 0.0)
    assert isinstance(laws.drivers, DefendedDrivers)
    D = laws.drivers.sample(4000, default_rng(1))
    S, prior = family.placed(D)
    weights = np.exp(prior - laws.drivers.log_density(D))
    assert weights.mean() == pytest.approx(1.0, abs=4.5 * weights.std() / np.sqrt(len(D)))
    neck = S[:, 1] < 3.0
    assert weights[neck].sum() / weights.sum() == pytest.approx(0.016, abs=0.008)  # a 50th of 150 Pa


def test_adaptations_that_disagree_are_not_relied_on(make: MakeStudy) -> None:
    """Of two the pooled weights look sound, as one covers all; the other has seen something else."""
    case, rng = gaussian(3, 0.1, default_rng(2)), default_rng(0)
    held = {**FREE, "c": 268.0, "phi": 0.5, "K": 0.01, "n0": STANDARD, "n1": STANDARD}
    study = make(priors=held, pooling={"by": "wheel", "shared": ["n1"], "separate": ["n0"]})
    family = JointFamily(case.joint(study, Pooling("wheel", ("n0",), ("n1",))))
    chains = case.chains(1, 4000, rng)
    L = np.stack([family.group_from_physical(g, x.reshape(-1, 2)[:, 1:]) for g, x in enumerate(chains.values())])
    D = case.chains(1, 4000, rng)["g0"].reshape(-1, 2)[:, :1]
    fitted = [outer_laws(family, fit_laws(family, at, L, rng), [], at, L, rng) for at in (D, D + 8.0 * D.std())]
    alike = _evidence(family, [fitted[0], fitted[0]], OUTER, default_rng(1))
    apart = _evidence(family, fitted, OUTER, default_rng(1))
    assert alike is not None
    assert apart is not None
    assert alike.reliable
    assert not apart.reliable
    assert apart.error > 2 * alike.error


def test_strata_that_disagree_widen_the_error() -> None:
    """By how far they lie apart; where that is not known, the error is of the weights alone."""
    rng = default_rng(0)
    base: FloatArray = 0.1 * rng.standard_normal((2, 1000))
    groups: FloatArray = np.zeros((1, 2, 1000))
    plain = Weighed(base, groups, ()).evidence
    apart = Weighed(base, groups, (), base + np.array([[0.2], [-0.2]])).evidence
    far = Weighed(base, groups, (), base + np.array([[0.5], [-0.5]])).evidence
    assert (plain.log_z, plain.reliable, plain.spread) == (apart.log_z, True, 0.0)
    assert apart.error == pytest.approx(0.2 / np.sqrt(2), rel=0.1)
    assert apart.reliable
    assert not far.reliable
