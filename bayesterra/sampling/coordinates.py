"""Sampling coordinates that straighten the ridges of wheel–soil posteriors and do away with their edges.

A wheel feels the stress under it, not the parameters of the stress. So the sampler moves

====================  =======================================================================================
K_s, n0, n1           normal score of K_s under its prior; log of the stress under the wheel at two slips
k_c, k_φ, n of plates log of the pressure under the smallest and the largest at a typical sinkage; n
k_c, k_φ              normal score of k_c under its prior; log of K_s = k_c/b + k_φ in the place of K_s
c1, c2                probit of θm/θ1, counted from θ2/θ1, at the lowest and the highest slip
c, φ, K               log of the shear stress mobilised at a typical displacement; probit of its frictional
                      share; log of K
noise                 log
any other             normal score under its prior
====================  =======================================================================================

at a sinkage, a normal stress and a shear displacement that are typical of the data. The map is exact and
invertible and its Jacobian is part of the density, so the posterior does not depend on what is typical. The
physical limits (c ≥ 0, θ2 < θm < θ1) lie at infinity: no proposal is lost beyond them.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.special import ndtr, ndtri

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.experiments import Experiment
from bayesterra.likelihood.joint import Whole
from bayesterra.likelihood.posterior import Posterior
from bayesterra.parameters import NOISE_PREFIX, TEST_SIZES, whole_and_part
from bayesterra.stats.laws import Law

USUAL_STRESS = 5e3
"""Stress under a rover's wheel, Pa; typical where neither load nor normal force was measured."""


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
        return self.law.score(x)

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        x = self.law.at_score(u)
        return x, (_log_normal(u) - self.law.log_density(x)).sum(axis=1)


@dataclass(frozen=True)
class Stress:
    """K_s, n0 and, if free, n1, as the score of K_s and the log of the stress at one slip or two.

    Attributes
    ----------
    score : map of K_s.
    slips : where the stress is taken, (k − 1,).
    entrance : entrance angle θ1 there, (k − 1,).
    radius : wheel radius, m.
    share : of the greatest depth that carries the load in the mean: all of it where stresses are linear,
        as in M2 and M3, about two thirds in M1.
    """

    score: Block
    slips: FloatArray
    entrance: FloatArray
    radius: float
    share: float

    def _log_depths(self, ratios: FloatArray) -> FloatArray:
        """Log of the depth that carries the load, for θm/θ1 (n, k − 1): a share of the base of (18)."""
        deepest = self.radius * (np.cos(ratios * self.entrance) - np.cos(self.entrance))
        return np.asarray(np.log(self.share * deepest))

    def from_physical(self, x: FloatArray, ratios: FloatArray) -> FloatArray:
        """Coordinates of parameters (n, k) at given θm/θ1 (n, k − 1)."""
        slopes = self.slips if x.shape[1] == 3 else np.zeros(1)
        exponents = x[:, 1:2] + x[:, -1:] * slopes
        stress = np.log(x[:, :1]) + exponents * self._log_depths(ratios)
        return np.column_stack([self.score.from_physical(x[:, :1]), stress])

    def to_physical(self, u: FloatArray, ratios: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Parameters (n, k) and log |dx/du| (n,) of coordinates (n, k) at given θm/θ1 (n, k − 1)."""
        Ks, log_jacobian = self.score.to_physical(u[:, :1])
        depths = self._log_depths(ratios)
        exponents = (u[:, 1:] - np.log(Ks)) / depths
        log_jacobian = log_jacobian - np.log(np.abs(depths)).sum(axis=1)
        if u.shape[1] == 2:
            return np.column_stack([Ks, exponents]), log_jacobian
        width = self.slips[1] - self.slips[0]
        n1 = (exponents[:, 1:] - exponents[:, :1]) / width
        return np.column_stack([Ks, exponents[:, :1] - n1 * self.slips[0], n1]), log_jacobian - np.log(width)


@dataclass(frozen=True)
class Bearing:
    """Bearing parameters alone, at θm/θ1 = 1/2."""

    stress: Stress

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Block`."""
        return self.stress.from_physical(x, np.full((len(x), x.shape[1] - 1), 0.5))

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        return self.stress.to_physical(u, np.full((len(u), u.shape[1] - 1), 0.5))


@dataclass(frozen=True)
class Angles:
    """c1 and c2 as probits of (θm − θ2)/(θ1 − θ2) at two slips; ``leaving`` is θ2/θ1, (7)."""

    slips: tuple[float, float]
    leaving: float

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Block`."""
        ratio = x[:, :1] + x[:, 1:] * np.array(self.slips)
        return np.asarray(ndtri((ratio - self.leaving) / (1.0 - self.leaving)))

    def ratios(self, u: FloatArray) -> FloatArray:
        """θm/θ1 at the two slips (n, 2) of coordinates (n, 2)."""
        return np.asarray(self.leaving + (1.0 - self.leaving) * ndtr(u))

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        width, ratio = self.slips[1] - self.slips[0], self.ratios(u)
        c2 = (ratio[:, 1] - ratio[:, 0]) / width
        constant = 2 * np.log(1.0 - self.leaving) - np.log(width)
        x = np.column_stack([ratio[:, 0] - c2 * self.slips[0], c2])
        return x, _log_normal(u).sum(axis=1) + constant


@dataclass(frozen=True)
class Contact:
    """Bearing parameters and contact angles together, K_s, n0, (n1), c1, c2: the stress is taken at θm."""

    stress: Stress
    angles: Angles

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Block`."""
        angles = self.angles.from_physical(x[:, -2:])
        return np.column_stack([self.stress.from_physical(x[:, :-2], self._ratios(angles)), angles])

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        angles, angle_term = self.angles.to_physical(u[:, -2:])
        bearing, bearing_term = self.stress.to_physical(u[:, :-2], self._ratios(u[:, -2:]))
        return np.column_stack([bearing, angles]), angle_term + bearing_term

    def _ratios(self, u: FloatArray) -> FloatArray:
        return np.clip(self.angles.ratios(u), 1e-6, 1 - 1e-6)[:, : len(self.stress.slips)]


@dataclass(frozen=True)
class Moduli:
    """k_c, k_φ and what goes with K_s in a block: K_s = k_c/b + k_φ stands in the place of k_φ there."""

    score: NormalScore  # of k_c, or of k_c z^n0 where its law is stated at a sinkage
    width: float  # wheel width b, m
    inner: Block  # block of K_s, n0 and the others
    reference: float = 1.0  # that sinkage z, m; at 1 m the law is that of k_c

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Block`."""
        Ks, stated = x[:, :1] / self.width + x[:, 1:2], x[:, :1]
        if self.reference != 1.0:
            stated = stated * self.reference ** x[:, 2:3]
        return np.column_stack(
            [self.score.from_physical(stated), self.inner.from_physical(np.column_stack([Ks, x[:, 2:]]))]
        )

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        kc, cohesive_term = self.score.to_physical(u[:, :1])
        others, inner_term = self.inner.to_physical(u[:, 1:])
        if self.reference != 1.0:
            kc, inner_term = kc * self.reference ** -others[:, 1:2], inner_term - others[:, 1] * np.log(self.reference)
        return np.column_stack([kc, others[:, :1] - kc / self.width, others[:, 1:]]), cohesive_term + inner_term


@dataclass(frozen=True)
class Plates:
    """k_c, k_φ and n as logs of the pressure under two plates at a typical sinkage, and n.

    With plates of one radius there is one such pressure, and the normal score of k_c in place of the other.
    """

    radii: tuple[float, float]  # smallest and largest plate radius, m
    sinkage: float  # typical sinkage, m
    score: NormalScore  # of k_c z^n at the sinkage at which its law is stated
    reference: float = 1.0  # sinkage z of that law, m

    @property
    def _single(self) -> bool:
        return self.radii[0] == self.radii[1]

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Block`."""
        n = x[:, 2:]
        pressures = np.log(x[:, :1] / np.array(self.radii) + x[:, 1:2]) + n * np.log(self.sinkage)
        first = self.score.from_physical(x[:, :1] * self.reference**n) if self._single else pressures[:, :1]
        return np.column_stack([first, pressures[:, 1:], n])

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        n = u[:, 2:]
        small, large = self.radii
        last = np.exp(u[:, 1:2] - n * np.log(self.sinkage))
        if self._single:
            stated, term = self.score.to_physical(u[:, :1])
            kc = stated * self.reference**-n
            stretched = np.log(last[:, 0]) - n[:, 0] * np.log(self.reference)
            return np.column_stack([kc, last - kc / large, n]), term + stretched
        first = np.exp(u[:, :1] - n * np.log(self.sinkage))
        kc = (first - last) / (1.0 / small - 1.0 / large)
        jacobian = np.log(first[:, 0]) + np.log(last[:, 0]) - np.log(1.0 / small - 1.0 / large)
        return np.column_stack([kc, last - kc / large, n]), jacobian


@dataclass(frozen=True)
class Strength:
    """c, φ and, if free, K, as the log of the mobilised stress, probit of its frictional share, and log K."""

    stress: float  # normal stress p, Pa; the strength there is τ = c + p tan φ
    displacement: float  # shear displacement j, m; τ (1 − exp(−j/K)) is mobilised there, (9)

    def _log_mobilised(self, log_K: FloatArray) -> FloatArray:
        """Log of 1 − exp(−j/K) (n,); 0 where K is not among the parameters (n, 0)."""
        ratio = self.displacement * np.exp(-log_K)
        return np.asarray(np.log(-np.expm1(-ratio)).sum(axis=1))

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Block`."""
        friction, log_K = self.stress * np.tan(x[:, 1]), np.log(x[:, 2:])
        strength = x[:, 0] + friction
        mobilised = np.log(strength) + self._log_mobilised(log_K)
        return np.column_stack([mobilised, ndtri(friction / strength), log_K])

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Block`."""
        log_K = u[:, 2:]
        log_strength = u[:, 0] - self._log_mobilised(log_K)
        strength = np.exp(log_strength)
        slope = strength * ndtr(u[:, 1]) / self.stress
        x = np.column_stack([strength * ndtr(-u[:, 1]), np.arctan(slope), np.exp(log_K)])
        # dc dφ = τ² cos²φ / p · d(log τ) d(share)
        plane = 2 * log_strength + _log_normal(u[:, 1]) - np.log1p(slope**2) - np.log(self.stress)
        return x, plane + log_K.sum(axis=1)


@dataclass(frozen=True)
class Coordinates:
    """The map between physical parameters x (n, d) and sampling coordinates u (n, d), block by block.

    ``blocks`` are pairs of columns and the map of those columns; every column stands in one pair.
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
        with np.errstate(all="ignore"):  # far proposals overflow; the prior turns them away
            for columns, block in self.blocks:
                x[:, columns], term = block.to_physical(u[:, columns])
                log_jacobian += term
        return x, log_jacobian


LEAVING = ("c3",)
"""Parameters of the leaving angle; where one of them is 1 or more, it counts as unknown."""


def coordinates(posterior: Whole) -> Coordinates:
    """Choose the map for a study: which parameters are free, and what is typical of its rows.

    A law that numbers do not resolve at its ends is sampled by its normal score, in no block with others. So
    are all parameters of several groups, of which each has its own typical rows.
    """
    if not posterior.grouped:
        names, laws = posterior.names, posterior.prior.laws
        choices = _of_rows(posterior) if posterior.driven else []
        for experiment in posterior.experiments:
            choices += _of_tests(experiment, {name for group, _ in choices for name in group})
        taken = {name for group, _ in choices for name in group}
        choices += [((name,), _alone(name, laws[name])) for name in names if name not in taken]
        return Coordinates(tuple((tuple(map(names.index, group)), block) for group, block in choices))
    return Coordinates(tuple(((i,), NormalScore(law)) for i, law in enumerate(posterior.prior.laws.values())))


def _of_tests(experiment: Experiment, taken: set[str]) -> list[tuple[tuple[str, ...], Block]]:
    """The map of what a series of soil tests reads, where that is free and in no other block."""
    prior, readings, soil = experiment.prior, experiment.readings, experiment.test.soil
    free = tuple(name for name in soil if name in prior.laws and name not in taken and not prior.laws[name].crowded)
    typical = float(np.exp(np.median(np.log(readings.path))))
    if readings.kind == "plate" and free == soil:
        radii = float(readings.levels.min()), float(readings.levels.max())
        reference = prior.reference if "kc" in soil else 1.0
        return [(soil, Plates(radii, typical, NormalScore(prior.laws[soil[0]]), reference))]
    if readings.kind == "shear" and set(soil[:2]) <= set(free):
        return [(free, Strength(float(np.median(readings.levels)), typical))]
    return []


def _of_rows(posterior: Posterior) -> list[tuple[tuple[str, ...], Block]]:
    """The map for what the rows of wheels read."""
    names, laws, fixed = posterior.names, posterior.prior.laws, posterior.prior.fixed
    rows, alone = _Typical.of(posterior), {name for name, law in laws.items() if law.crowded}
    loose = [name for name in names if name not in alone]
    stiffness = "kphi" if {"kc", "kphi"} <= set(loose) else "Ks"
    wanted = (stiffness, "n0", "n1")
    bearing = tuple(name for name in wanted if {stiffness, "n0"} <= set(loose) and name in loose)
    limited = all(fixed.get(name, 1.0) < 1.0 for name in LEAVING) and _several_slips(posterior)
    angles = ("c1", "c2") if {"c1", "c2"} <= set(loose) and limited else ()
    shear = tuple(name for name in ("c", "phi", "K") if {"c", "phi"} <= set(loose) and name in loose)
    choices: list[tuple[tuple[str, ...], Block]] = []
    if bearing:
        score: Block = NormalScore(laws["Ks"]) if stiffness == "Ks" else Logarithm()
        slips = len(bearing) - 1
        stress = Stress(score, np.array(rows.slips[:slips]), rows.entrance[:slips], rows.radius, rows.share)
        block: Block = Contact(stress, Angles(rows.slips, fixed["c3"])) if angles else Bearing(stress)
        if stiffness == "kphi":
            bearing = ("kc", *bearing)
            block = Moduli(NormalScore(laws["kc"]), posterior.prior.width, block, posterior.prior.reference)
        choices.append((bearing + angles, block))
    elif angles:
        choices.append((angles, Angles(rows.slips, fixed["c3"])))
    if shear:
        choices.append((shear, Strength(rows.stress, rows.displacement)))
    return choices


def _alone(name: str, law: Law) -> Block:
    """The map of a parameter that forms no block with others."""
    scale = whole_and_part(name)[0] == "K" or name.startswith((NOISE_PREFIX, *TEST_SIZES))
    return Logarithm() if scale and not law.crowded else NormalScore(law)


def _several_slips(posterior: Posterior) -> bool:
    """True where slip varies; with one slip only, θm is not limited at any other."""
    return bool(np.ptp(posterior.likelihood.forward.conditions.slip) > 1e-3)


@dataclass(frozen=True)
class _Typical:
    """Typical values of the rows of a study, medians but for the slips and the entrance angles there."""

    slips: tuple[float, float]
    entrance: FloatArray
    radius: float
    stress: float
    displacement: float
    share: float

    @classmethod
    def of(cls, posterior: Posterior) -> "_Typical":
        rows, observations = posterior.likelihood.forward.conditions, posterior.likelihood.observations
        measured = observations.values.get("normal_force", observations.load)
        force = np.where(np.isnan(measured), observations.load, measured)
        # a sinkage that was not measured stands at a tenth of the radius
        z = observations.values.get("sinkage", np.full(len(rows.radius), np.nan))
        z = np.clip(np.where(np.isnan(z), 0.1 * rows.radius, z), 0.01 * rows.radius, 0.9 * rows.radius)
        theta = np.arccos(1.0 - z / rows.radius)
        middle = 0.5 * theta
        sheared = (theta - middle) - (1 - rows.slip) * (np.sin(theta) - np.sin(middle))
        # with one slip only, any second one makes the map of the stresses invertible
        low, high, spread = float(rows.slip.min()), float(rows.slip.max()), _several_slips(posterior)
        slope, level = np.polyfit(rows.slip, np.log(theta), 1) if spread else (0.0, np.log(theta).mean())
        high = high if spread else low + 0.1
        stress = force / (rows.width * rows.radius * np.sin(theta))
        return cls(
            slips=(low, high),
            entrance=np.exp(np.clip(level + slope * np.array([low, high]), -4.0, 0.4)),
            radius=float(np.median(rows.radius)),
            stress=USUAL_STRESS if np.isnan(stress).all() else float(np.nanmedian(stress)),
            displacement=float(np.median(rows.shearing_radius * sheared)),
            share=2 / 3 if posterior.likelihood.forward.model.name == "M1" else 1.0,
        )
