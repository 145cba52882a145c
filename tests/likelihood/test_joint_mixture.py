"""Mixtures of scores in a joint prior: density and draws by role; correlations for hierarchical values."""

from typing import Any

import numpy as np
import pytest
from numpy.random import default_rng
from scipy.stats import ks_2samp

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.joint import JointPosterior, draw_joint_prior, joint_posterior
from bayesterra.sampling.family import JointFamily
from bayesterra.sampling.moves import Walkers
from bayesterra.stats.dependence import GaussianCopula
from tests.support.two_wheels import HELD, MakeStudy

LAWS = {
    **{name: value for name, value in HELD.items() if name not in ("c", "phi", "K")},
    "c": {"dist": "norm", "loc": 1000.0, "scale": 300.0, "lower": 0.0},
    "phi": {"dist": "norm", "loc": np.radians(30.0), "scale": np.radians(4.0), "lower": 0.0, "upper": 1.0},
    "K": {"dist": "norm", "loc": 0.012, "scale": 0.003, "lower": 0.002, "upper": 0.05},
}
BENT = {
    "weights": [0.35, 0.35, 0.3],
    "means": [[-1.0, 0.8], [0.0, -0.8], [1.1, 0.6]],
    "covariances": [[[0.4, -0.3], [-0.3, 0.3]], [[0.3, 0.0], [0.0, 0.05]], [[0.4, 0.3], [0.3, 0.3]]],
}
MIXTURE: dict[str, Any] = {**LAWS, "mixture": {"c, phi": BENT}}
ROLES: dict[str, dict[str, Any]] = {
    "shared with shared": {"shared": ["c", "phi"], "separate": ["K"]},
    "shared with separate": {"shared": ["phi"], "separate": ["c", "K"]},
    "separate with separate": {"shared": ["K"], "separate": ["c", "phi"]},
    "beside a hierarchical one": {"shared": ["phi"], "separate": ["c"], "hierarchical": {"K": {}}},
}


def level(of: JointPosterior, shared: FloatArray, own: list[FloatArray]) -> FloatArray:
    """Log density of the joint prior before the physical cut."""
    groups = np.sum([of.log_prior_of_group(shared, one) for one in own], axis=0)
    return np.asarray(groups + of.log_prior_of_shared(shared))


@pytest.mark.parametrize("roles", ROLES)
def test_the_bend_is_in_the_joint_prior(make: MakeStudy, roles: str) -> None:
    """Values of any one group have the law of the plain prior; the density belongs to the draws."""
    joint = joint_posterior(make(priors=MIXTURE, pooling=ROLES[roles]))
    loose = joint_posterior(make(priors=LAWS, pooling=ROLES[roles]))
    rng = default_rng(1)
    D = joint.draw_shared(10_000, rng)
    own = [joint.draw_group(D, rng) for _ in joint.groups]
    plain = joint.first.prior.sample(10_000, rng)
    prior = joint.first.prior
    columns = [prior.names.index(name) for name in ("c", "phi")]
    for one in own:
        scores = [prior.scores(x)[:, columns] for x in (joint.of_group(D, one), plain)]
        for figure in ((1.0, 1.0, 0.0), (1.0, -1.0, 0.0), (0.0, -1.0, 1.0)):
            ours, theirs = (figure[0] * z[:, 0] + figure[1] * z[:, 1] + figure[2] * z[:, 0] ** 2 for z in scores)
            assert ks_2samp(ours, theirs).pvalue > 1e-3
    E = loose.draw_shared(20_000, rng)
    other = [loose.draw_group(E, rng) for _ in loose.groups]
    ratio = np.exp(level(joint, E, other) - level(loose, E, other))
    assert ratio.mean() == pytest.approx(1.0, abs=4.5 * ratio.std() / np.sqrt(len(ratio)))
    assert ratio.std() > 0.5


@pytest.mark.parametrize("roles", ROLES)
def test_moves_have_the_same_density(make: MakeStudy, roles: str) -> None:
    """Coordinates and ``log_density`` agree up to the Jacobian."""
    joint = joint_posterior(make(priors=MIXTURE, pooling=ROLES[roles]))
    family = JointFamily(joint)
    x = draw_joint_prior(joint, 200, default_rng(2))
    D, L = joint.split(x)
    u, v = family.shared_from_physical(D), np.stack([family.group_from_physical(g, L[g]) for g in range(2)])
    jacobian = family.shared_to_physical(u)[1] + sum(family.group_to_physical(g, v[g])[1] for g in range(2))
    density = Walkers.at(family, u, v).log_density - jacobian
    np.testing.assert_allclose(density, joint.log_density(x), rtol=1e-7)


def test_hierarchical_values_take_correlations_and_a_note_says_so(make: MakeStudy) -> None:
    """A population lies elsewhere than the prior's scores: the mixture's correlations stand in."""
    bent = {"shared": ["K"], "separate": ["c"], "hierarchical": {"phi": {}}}
    study = make(priors=MIXTURE, pooling=bent)
    said = "the mixture of c, phi is taken by its correlations where one of these is hierarchical: phi"
    assert said in study.notes
    joint = joint_posterior(study)
    assert joint.copula is not None
    assert isinstance(joint.copula.whole, GaussianCopula)
    rho = study.prior.mixed[0][1].correlation[0, 1]
    rng = default_rng(3)
    D = joint.draw_shared(20_000, rng)
    own = joint.draw_group(D, rng)
    assert np.corrcoef(*joint._own_scores(D, own).T)[0, 1] == pytest.approx(rho, abs=0.02)
    other = make(priors=MIXTURE, pooling=ROLES["shared with shared"])
    assert any(note.endswith("hierarchical: only in comparisons of what groups share") for note in other.notes)
    assert not any("mixture" in note for note in make(priors=LAWS, pooling=bent).notes)
