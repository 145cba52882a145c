r"""Sampling coordinates that straighten the ridges of wheel–soil posteriors and do away with their edges.

A wheel feels the stress under it, not the parameters of the stress. So the sampler moves

====================  =======================================================================================
K_s, n0, n1           normal score of K_s under its prior; log of the stress K_s ℓ^N at two slips
c, φ                  log of the shear strength τ = c + p tan φ; probit of its frictional share p tan φ / τ
c1, c2                probit of θm/θ1, counted from θ2/θ1, at the lowest and the highest slip
K, noise              log
any other             normal score under its prior
====================  =======================================================================================

ℓ is the depth of soil over the contact and p the stress under the wheel, both typical of the data. The map
is exact and invertible and its Jacobian is part of the density, so the posterior does not depend on ℓ, p and
the slips. The physical limits (c ≥ 0, θ2 < θm < θ1) lie at infinity: no proposal is lost beyond them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.special import ndtr, ndtri

from bayesterra.arrays import FloatArray
from bayesterra.parameters import NOISE_PREFIX
from bayesterra.posteriors import Posterior
from bayesterra.priors import Law


class Block(Protocol):
    """A map of a few parameters; x physical (n, k), u sampling coordinates (n, k)."""

    def from_physical(self, x: FloatArray) -> FloatArray:
        """Coordinates u of parameters x."""

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Parameters x and log |dx/du| (n,) of coordinates u."""


def _log_normal(u: FloatArray) -> FloatArray:
    """Log density of the standard normal law."""
    return np.asarray(-0.5 * u**2 - 0.5 * np.log(2 * np.pi))


@dataclass(frozen=True)
class Plain:
    """Parameters that are their own coordinates."""

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Block`."""
        return x

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        return u, np.zeros(len(u))


@dataclass(frozen=True)
class Logarithm:
    """Logs of positive parameters."""

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Block`."""
        return np.log(x)

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        return np.exp(u), u.sum(axis=1)


@dataclass(frozen=True)
class NormalScore:
    """A parameter's normal score under its prior law: the law becomes a standard normal one."""

    law: Law

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Block`."""
        return np.asarray(ndtri(np.clip(self.law.cdf(x), 1e-300, 1.0 - 1e-16)))

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        x = self.law.quantile(ndtr(u))
        return x, (_log_normal(u) - self.law.log_density(x)).sum(axis=1)


@dataclass(frozen=True)
class Bearing:
    """K_s, n0 and, if free, n1, as the score of K_s and the log stress at one slip or two.

    Attributes
    ----------
    score : of K_s.
    slips, log_depths : where the stress is taken, and log ℓ (m) there, (k − 1,) each.
    """

    score: NormalScore
    slips: FloatArray
    log_depths: FloatArray

    @property
    def _matrix(self) -> FloatArray:
        """From (n0, n1) to N log ℓ at the slips."""
        exponents = np.column_stack([np.ones(len(self.slips)), self.slips])[:, : len(self.slips)]
        return exponents * self.log_depths[:, None]

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Block`."""
        stress = np.log(x[:, :1]) + x[:, 1:] @ self._matrix.T
        return np.column_stack([self.score.from_physical(x[:, :1]), stress])

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        Ks, log_jacobian = self.score.to_physical(u[:, :1])
        with np.errstate(divide="ignore"):
            exponents = (u[:, 1:] - np.log(Ks)) @ np.linalg.inv(self._matrix).T
        return np.column_stack([Ks, exponents]), log_jacobian - np.linalg.slogdet(self._matrix)[1]


@dataclass(frozen=True)
class Strength:
    """c and φ as the log of the strength τ at the stress p (Pa) and probit of its frictional share."""

    stress: float

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Block`."""
        friction = self.stress * np.tan(x[:, 1])
        strength = x[:, 0] + friction
        return np.column_stack([np.log(strength), ndtri(friction / strength)])

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        strength = np.exp(u[:, 0])
        slope = strength * ndtr(u[:, 1]) / self.stress
        x = np.column_stack([strength * ndtr(-u[:, 1]), np.arctan(slope)])
        # dc dφ = τ² cos²φ / p · d(log τ) d(share)
        return x, 2 * u[:, 0] + _log_normal(u[:, 1]) - np.log1p(slope**2) - np.log(self.stress)


@dataclass(frozen=True)
class Angles:
    """c1 and c2 as probits of (θm − θ2)/(θ1 − θ2) at two slips; ``leaving`` is θ2/θ1, (7)."""

    slips: tuple[float, float]
    leaving: float

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Block`."""
        ratio = x[:, :1] + x[:, 1:] * np.array(self.slips)
        return np.asarray(ndtri((ratio - self.leaving) / (1.0 - self.leaving)))

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        width = self.slips[1] - self.slips[0]
        ratio = self.leaving + (1.0 - self.leaving) * ndtr(u)
        c2 = (ratio[:, 1] - ratio[:, 0]) / width
        logs = _log_normal(u).sum(axis=1)
        constant = 2 * np.log(1.0 - self.leaving) - np.log(width)
        return np.column_stack([ratio[:, 0] - c2 * self.slips[0], c2]), logs + constant


@dataclass(frozen=True)
class Coordinates:
    """The map between physical parameters x (n, d) and sampling coordinates u (n, d), block by block.

    Attributes
    ----------
    blocks : pairs of columns and the map of those columns; every column stands in one pair.
    """

    blocks: tuple[tuple[tuple[int, ...], Block], ...]

    def from_physical(self, x: FloatArray) -> FloatArray:
        """Sampling coordinates (n, d) of physical parameters (n, d) inside the support."""
        u = np.empty_like(x)
        for columns, block in self.blocks:
            u[:, columns] = block.from_physical(x[:, columns])
        return u

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Physical parameters (n, d) and log |dx/du| (n,) of sampling coordinates (n, d)."""
        x, log_jacobian = np.empty_like(u), np.zeros(len(u))
        with np.errstate(over="ignore", under="ignore", invalid="ignore"):
            for columns, block in self.blocks:
                x[:, columns], term = block.to_physical(u[:, columns])
                log_jacobian += term
        return x, log_jacobian


def plain_coordinates(names: Sequence[str]) -> Coordinates:
    """Physical parameters as they are: no ridge is straightened. For comparison and tests."""
    return Coordinates(((tuple(range(len(names))), Plain()),))


def coordinates(posterior: Posterior) -> Coordinates:
    """Choose the map for a study: which parameters are free, and what is typical of its rows."""
    names, laws, fixed = posterior.names, posterior.prior.laws, posterior.prior.fixed
    slips = _slips(posterior)
    depths = _log_depths(posterior, np.array(slips))
    choices: list[tuple[tuple[str, ...], Block]] = []
    if {"Ks", "n0", "n1"} <= set(names):
        choices.append((("Ks", "n0", "n1"), Bearing(NormalScore(laws["Ks"]), np.array(slips), depths)))
    elif {"Ks", "n0"} <= set(names):
        choices.append((("Ks", "n0"), Bearing(NormalScore(laws["Ks"]), np.array(slips[:1]), depths[:1])))
    if {"c", "phi"} <= set(names):
        choices.append((("c", "phi"), Strength(_typical_stress(posterior))))
    if {"c1", "c2"} <= set(names) and fixed.get("c3", 1.0) < 1.0:
        choices.append((("c1", "c2"), Angles(slips, fixed["c3"])))
    taken = {name for group, _ in choices for name in group}
    choices += [((name,), _alone(name, laws[name])) for name in names if name not in taken]
    return Coordinates(tuple((tuple(map(names.index, group)), block) for group, block in choices))


def _alone(name: str, law: Law) -> Block:
    """The map of a parameter that forms no block with others."""
    scale = name == "K" or name.startswith(NOISE_PREFIX)
    return Logarithm() if scale else NormalScore(law)


def _slips(posterior: Posterior) -> tuple[float, float]:
    """Lowest and highest slip in the fit; with one slip only, any second one makes the map invertible."""
    slip = posterior.likelihood.forward.conditions.slip
    low, high = float(slip.min()), float(slip.max())
    return (low, high) if high - low > 1e-3 else (low, low + 0.1)


def _log_depths(posterior: Posterior, slips: FloatArray) -> FloatArray:
    """Log of the typical depth of soil over the contact, r (cos θm − cos θ1), at two slips, m."""
    slip = posterior.likelihood.forward.conditions.slip
    level = np.log(_typical_sinkage(posterior))
    slope, start = np.polyfit(slip, level, 1) if np.ptp(slip) > 1e-3 else (0.0, level.mean())
    return np.asarray(np.log(0.75) + start + slope * slips)  # θm = θ1/2 leaves 3/4 of the sinkage


def _typical_sinkage(posterior: Posterior) -> FloatArray:
    """Sinkage of every row (m,): measured where it was, else a tenth of the radius; at least 1 % of it."""
    radius = posterior.likelihood.forward.conditions.radius
    measured = posterior.likelihood.observations.values.get("sinkage", np.full(len(radius), np.nan))
    return np.clip(np.where(np.isnan(measured), 0.1 * radius, measured), 0.01 * radius, 0.9 * radius)


def _typical_stress(posterior: Posterior) -> float:
    """Load over the chord of the contact, median over the rows, Pa."""
    rows, observations = posterior.likelihood.forward.conditions, posterior.likelihood.observations
    measured = observations.values.get("normal_force", observations.load)
    force = np.where(np.isnan(measured), observations.load, measured)
    sinkage = _typical_sinkage(posterior)
    chord = np.sqrt(2 * rows.radius * sinkage - sinkage**2)
    return float(np.nanmedian(force / (rows.width * chord)))
