"""Correlations of the prior in a joint posterior: draws and evidence beside sums over a grid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from numpy.random import SeedSequence, default_rng
from scipy.special import logsumexp

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.joint import JointPosterior, draw_joint_prior, joint_posterior
from bayesterra.pooling.evidence import weigh_joint
from bayesterra.pooling.page import joined_laws
from bayesterra.sampling.family import JointFamily
from bayesterra.sampling.joint import PoolingOptions, sample_joint
from bayesterra.sampling.moves import Walkers
from bayesterra.stats.laws import log_population, population_score, population_value
from bayesterra.study.priors import Prior
from bayesterra.study.study import Study
from tests.support.choice import some
from tests.support.two_wheels import COHESION, FREE, FRICTION, SHEAR

MakeStudy = Callable[..., Study]
Grid = Callable[[float, float, int], FloatArray]
STATED = {**FREE, "c": COHESION, "phi": FRICTION, "K": SHEAR}
ROLES = {
    "shared with shared": {"shared": ["c", "phi"], "separate": ["K"]},
    "shared with separate": {"shared": ["phi"], "separate": ["c", "K"]},
    "separate with separate": {"shared": ["K"], "separate": ["c", "phi"]},
    "shared with hierarchical": {"shared": ["phi"], "separate": ["K"], "hierarchical": {"c": {}}},
    "separate with hierarchical": {"shared": ["K"], "separate": ["c"], "hierarchical": {"phi": {}}},
    "hierarchical with hierarchical": {"shared": ["K"], "hierarchical": {"c": {}, "phi": {}}},
}
"""Roles of c and φ, which correlate."""


def _earlier(correlation: float) -> Any:
    """A result whose posterior has the laws of c and φ above and a Gaussian copula."""
    z = default_rng(3).multivariate_normal([0, 0], [[1, correlation], [correlation, 1]], size=(4, 4000))
    columns = {"c": 1000.0 + 300.0 * z[..., 0], "phi": np.radians(30.0 + 4.0 * z[..., 1])}
    units = {"c": "Pa", "phi": "rad"}
    posterior = {n: (("chain", "draw"), x, {"units": units[n]}) for n, x in columns.items()}
    draws = xr.DataTree.from_dict({"/posterior": xr.Dataset(posterior)})
    return SimpleNamespace(draws=draws, record={})


def _priors(how: str, correlation: float) -> dict[str, Any]:
    """Laws of c, φ and K with a correlation of c and φ, stated by hand or taken from a result."""
    if how == "by hand":
        return {**STATED, "correlation": {"c, phi": correlation}}
    return {**FREE, "K": SHEAR, "from": [{"result": _earlier(correlation)}]}


@pytest.mark.parametrize("roles", ROLES)
def test_a_cube_of_probabilities_is_the_prior(make: MakeStudy, roles: str) -> None:
    """Uniform ones give draws with the scores, the dependence and the ranges of the stated prior."""
    joint = joint_posterior(make(priors=_priors("by hand", 0.8), pooling=ROLES[roles]))
    q = default_rng(4).random((100_000, len(joint.names)))
    x = joint.prior.quantile(q)
    assert np.isfinite(joint.log_prior(x)).mean() > 0.9  # but for the physical cut
    scores = joint.prior.scores(x)
    np.testing.assert_allclose(scores.mean(axis=0), 0.0, atol=0.03)
    np.testing.assert_allclose(np.cov(scores.T), joint.prior.score_correlation, atol=0.04)
    drawn = joint.prior.sample(100_000, default_rng(5))
    levels = [0.05, 0.5, 0.95]
    spread = drawn.std(axis=0)
    assert (np.abs(np.quantile(x, levels, axis=0) - np.quantile(drawn, levels, axis=0)) < 0.04 * spread).all()


def _pairs(joint: JointPosterior, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values of c and φ (n,) in the first group."""
    columns = [joint.names.index(n if n in joint.names else f"{n}[Wh11]") for n in ("c", "phi")]
    return x[:, columns[0]], x[:, columns[1]]


@pytest.mark.parametrize("how", ["by hand", "from a result"])
@pytest.mark.parametrize("roles", ROLES)
def test_every_dependence_is_in_the_prior(make: MakeStudy, roles: str, how: str) -> None:
    """Density and draws alike, whatever the roles of the two parameters and wherever it comes from."""
    joint = joint_posterior(make(priors=_priors(how, 0.8), pooling=ROLES[roles]))
    loose = joint_posterior(make(priors=STATED, pooling=ROLES[roles]))
    rng = default_rng(0)
    D = joint.draw_shared(20_000, rng)
    own = [joint.draw_group(D, rng) for _ in joint.groups]
    for one in own:
        z = np.concatenate([joint._shared_scores(D), joint._own_scores(D, one)], axis=1)
        assert np.corrcoef(z.T)[0, 1] == pytest.approx(0.8, abs=0.015)
        np.testing.assert_allclose(z.std(axis=0), 1.0, atol=0.03)

    def level(of: JointPosterior, drivers: FloatArray, values: Sequence[FloatArray]) -> FloatArray:
        own = np.sum([of.log_prior_of_group(drivers, one) for one in values], axis=0)
        return np.asarray(own + of.log_prior_of_shared(drivers))

    assert np.abs(level(joint, D, own) - level(loose, D, own)).mean() > 0.2
    if how == "by hand":  # the laws are then the same, so that the ratio of the densities has the mean 1
        E = loose.draw_shared(20_000, rng)
        other = [loose.draw_group(E, rng) for _ in loose.groups]
        ratio = np.exp(level(joint, E, other) - level(loose, E, other))
        assert ratio.mean() == pytest.approx(1.0, abs=4.5 * ratio.std() / np.sqrt(len(ratio)))


def test_a_prior_has_no_other_dependence() -> None:
    """A new one needs its place in the joint prior, and in the test above; that of plates is refused beside groups."""
    of_plates = {"reference", "exponent", "reads"}
    assert {field.name for field in fields(Prior)} == {"entries", "width", "correlation", "mixtures", *of_plates}


@pytest.mark.parametrize("roles", ROLES)
def test_moves_have_the_same_density(make: MakeStudy, roles: str) -> None:
    """Coordinates and ``log_density`` agree up to the Jacobian; refreshed populations keep their law."""
    joint = joint_posterior(make(priors=_priors("by hand", 0.8), pooling=ROLES[roles]))
    family, rng = JointFamily(joint), default_rng(2)
    x = draw_joint_prior(joint, 4000, rng)
    D, L = joint.split(x)
    u, v = family.shared_from_physical(D), np.stack([family.group_from_physical(g, L[g]) for g in range(2)])
    jacobian = family.shared_to_physical(u)[1] + sum(family.group_to_physical(g, v[g])[1] for g in range(2))
    walkers = Walkers.at(family, u, v)
    np.testing.assert_allclose(walkers.log_density - jacobian, joint.log_density(x), rtol=1e-8)
    if joint.populations:
        (new,) = family.refreshed(u, D, np.moveaxis(v, 0, 1), rng.random((len(u), family.chances)))
        after = joint.log_dependence(family.shared_to_physical(new)[0], L[0])
        before = joint.log_dependence(D, L[0])
        error = np.hypot(before.std(), after.std()) / np.sqrt(len(x))
        assert after.mean() == pytest.approx(before.mean(), abs=4.5 * error)


def test_scores_of_a_population_are_inverted() -> None:
    """Also far out, with the mean outside the range; a score is normal in the law's own measure."""
    limits = (0.002, 0.05)
    score = np.linspace(-5.0, 5.0, 4001)
    for mean, spread in ((0.01, 0.003), (0.002, 0.01), (0.03, 5.0), (0.07, 0.004), (0.02, 1e-5)):
        at, width = np.full(4001, mean), np.full(4001, spread)
        values = population_value(score, at, width, limits)
        np.testing.assert_allclose(population_score(values, at, width, limits), score, atol=1e-4)
        middle = (values[1:] + values[:-1]) / 2
        density = log_population(middle, at[1:], width[1:], limits)
        z = population_score(middle, at[1:], width[1:], limits)
        slope = np.diff(score) / np.diff(values)
        np.testing.assert_allclose(np.exp(density), np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi) * slope, rtol=1e-3)


@dataclass(frozen=True)
class _Exact:
    """Sums over a grid: mean and sd of c and φ of the first group, their correlation, log evidence."""

    mean: FloatArray
    sd: FloatArray
    correlation: float
    log_z: float

    @classmethod
    def of(cls, log_weights: FloatArray, c: FloatArray, phi: FloatArray) -> _Exact:
        log_z = float(logsumexp(log_weights))
        weights = np.exp(log_weights - log_z)
        at = np.stack(np.broadcast_arrays(c, phi))
        axes = tuple(range(1, at.ndim))
        mean = (weights * at).sum(axis=axes)
        apart = at - mean.reshape(2, *[1] * (at.ndim - 1))
        sd = np.sqrt((weights * apart**2).sum(axis=axes))
        return cls(mean, sd, float((weights * apart[0] * apart[1]).sum() / sd.prod()), log_z)


def _grids(joint: JointPosterior, grid: Grid, sizes: tuple[int, int, int]) -> tuple[FloatArray, ...]:
    """Values of c, φ and K, and the logs of their cells."""
    laws = (joint.laws.get(name, joint.laws["c"]) for name in ("c", "phi", "K"))
    ends = [law.quantile(np.array([1e-7, 1 - 1e-7])) for law in laws]
    columns = [grid(float(low), float(high), n) for (low, high), n in zip(ends, sizes, strict=True)]
    return (*columns, np.array([np.log(column[1] - column[0]) for column in columns]))


def _copula(joint: JointPosterior, c: FloatArray, phi: FloatArray, r: float) -> FloatArray:
    """Log of the copula density of c and φ, written out."""
    x, y = joint.laws["c"].score(c), joint.laws["phi"].score(phi)
    return np.asarray(-0.5 * np.log(1 - r**2) - (r**2 * (x**2 + y**2) - 2 * r * x * y) / (2 * (1 - r**2)))


def _three(joint: JointPosterior, grid: Grid, r: float) -> _Exact:
    """Both shared, K of each group: three parameters at a time."""
    c, phi, K, cells = _grids(joint, grid, (70, 70, 90))
    x = np.stack(np.meshgrid(c, phi, K, indexing="ij"), axis=-1).reshape(-1, 3)
    names = joint.first.names
    x = x[:, [("c", "phi", "K").index(name) for name in names]]
    own = joint.laws["K"].log_density(K) + cells[2]
    prior = joint.laws["c"].log_density(c)[:, None] + joint.laws["phi"].log_density(phi) + cells[:2].sum()
    total = prior + _copula(joint, c[:, None], phi, r)
    for posterior in joint.groups.values():
        level = posterior.log_prior_and_likelihood(x)[1].reshape(len(c), len(phi), len(K))
        total = total + logsumexp(level + own, axis=2)
    return _Exact.of(total, c[:, None], phi[None])


def _two(joint: JointPosterior, grid: Grid, r: float) -> _Exact:
    """φ shared, c of each group: two parameters at a time."""
    c, phi, _, cells = _grids(joint, grid, (160, 160, 2))
    x = np.stack(np.meshgrid(c, phi, indexing="ij"), axis=-1).reshape(-1, 2)
    given = joint.laws["c"].log_density(c)[:, None] + _copula(joint, c[:, None], phi, r) + cells[0]
    levels = [p.log_prior_and_likelihood(x)[1].reshape(len(c), len(phi)) + given for p in joint.groups.values()]
    total = levels[0] + logsumexp(levels[1], axis=0) + joint.laws["phi"].log_density(phi) + cells[1]
    return _Exact.of(total, c[:, None], phi[None])


def _population(joint: JointPosterior, grid: Grid, r: float) -> _Exact:
    """φ shared, c of a population: its mean and spread beside them.

    Cells are those of the normal scores of c, which resolve populations of any spread.
    """
    _, phi, _, cells = _grids(joint, grid, (2, 50, 2))
    nodes = np.linspace(0.0, 6000.0, 1201)
    x = np.stack(np.meshgrid(nodes, phi, indexing="ij"), axis=-1).reshape(-1, 2)
    likely = [p.log_prior_and_likelihood(x)[1].reshape(len(nodes), len(phi)) for p in joint.groups.values()]
    mean_law, spread_law = joint.hyper["c"]
    lowest, highest = mean_law.quantile(np.array([1e-6, 1 - 1e-6]))
    means = grid(float(lowest), float(highest), 30)
    spreads = grid(0.0, float(spread_law.quantile(np.array(0.9999))), 30)
    score, y = grid(-5.0, 5.0, 60), joint.laws["phi"].score(phi)
    given = -0.5 * (score[:, None] - r * y) ** 2 / (1 - r**2) - 0.5 * np.log(2 * np.pi * (1 - r**2))
    given = given + np.log(score[1] - score[0])
    c, total = [], []
    for m in means:
        for s in spreads:
            values = population_value(score, np.array(m), np.array(s), joint.laws["c"].range)
            at = np.minimum(values / nodes[1], len(nodes) - 1.001)
            low = at.astype(int)
            share = (at - low)[:, None]
            first, second = ((1 - share) * level[low] + share * level[low + 1] + given for level in likely)
            prior = mean_law.log_density(m) + spread_law.log_density(s)
            total.append(first + logsumexp(second, axis=0) + prior)
            c.append(values)
    area = np.log((means[1] - means[0]) * (spreads[1] - spreads[0])) + cells[1]
    level = np.array(total) + joint.laws["phi"].log_density(phi) + area
    return _Exact.of(level, np.array(c)[:, :, None], phi)


CASES = {
    "three parameters": (ROLES["shared with shared"], {}, _three),
    "two parameters": ({"shared": ["phi"], "separate": ["c"]}, {"K": 0.01}, _two),
    "a population": ({"shared": ["phi"], "hierarchical": {"c": {}}}, {"K": 0.01}, _population),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("case", "how"),
    some(
        [
            ("two parameters", "by hand"),
            ("three parameters", "from a result"),
            ("three parameters", "by hand"),
            ("a population", "by hand"),
            ("two parameters", "from a result"),
        ],
        2,
    ),
)
def test_draws_and_evidence_are_those_of_a_grid(
    make: MakeStudy, small: PoolingOptions, grid: Grid, case: str, how: str
) -> None:
    """Mean, sd and correlation of c and φ, and the log evidence."""
    pooling, held, summed = CASES[case]
    study = make(
        priors={**_priors(how, 0.9), **held},
        pooling=pooling,
        noise={"drawbar_pull": 8.0, "resistance_moment": 3.0},  # so loose that the prior shows
        sampling={"target_ess": 2000, "walkers": 32},
    )
    joint = joint_posterior(study)
    correlation = study.prior.correlation["c, phi"]
    assert correlation == pytest.approx(0.9, abs=0.01)
    exact = summed(joint, grid, correlation)
    samples = sample_joint(joint, study.sampling, SeedSequence(4), plan=small)
    assert samples.diagnosis.converged
    c, phi = _pairs(joint, samples.chains.reshape(-1, len(joint.names)))
    size = samples.diagnosis.ess
    z = (np.array([c.mean(), phi.mean()]) - exact.mean) / exact.sd * np.sqrt(size)
    found = weigh_joint(samples, default_rng(0), outer=2048, inner=8).evidence
    assert np.abs(z).max() < 4.5
    np.testing.assert_allclose([c.std(), phi.std()], exact.sd, rtol=0.06)
    apart = np.arctanh(np.corrcoef(c, phi)[0, 1]) - np.arctanh(exact.correlation)
    assert abs(apart) < 4.5 / np.sqrt(size)
    assert found.reliable
    assert abs(found.log_z - exact.log_z) < 4.5 * found.error + 0.005


def test_report_says_what_is_correlated(make: MakeStudy) -> None:
    """Each pair with its value; independent laws are said to be so."""
    stated = make(priors=_priors("by hand", 0.8), pooling=ROLES["shared with hierarchical"])
    assert "<i>c</i> and <i>φ</i> +0.80" in joined_laws(stated)
    assert joined_laws(make()) == "independent of each other"
