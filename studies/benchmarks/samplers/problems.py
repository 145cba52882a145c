"""The two posteriors of the benchmark, and their densities as each kind of sampler takes them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pandas as pd
from compiled import Rows, box_density, box_gradient, sheared_density, sheared_gradient
from numpy.random import Generator
from scipy.special import expit, logit

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.likelihood.posterior import draw_cut_prior
from bayesterra.models import M1, Soil
from bayesterra.sampling.coordinates import Contact, Strength, coordinates
from bayesterra.sampling.sampler import Target

DRIVES = ("load", "sinkage")
SPACES = ("raw", "ours")
NAMES = ("Ks", "n0", "n1", "c", "phi", "K", "c1", "c2")
SLIPS = np.array([0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6])
LOAD = 80.0
TRUTH = {"Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 268.0, "phi": 0.511, "K": 0.0101, "c1": 0.339, "c2": -0.017}
NOISE = {"sinkage": 0.0005, "normal_force": 1.6, "drawbar_pull": 0.5, "resistance_moment": 0.15}
"""Standard deviations, SI: 2 to 3 % of a typical reading (half a millimetre of sinkage: 2 to 10 %)."""


def simulated_study(drive: str, seed: int = 1, slips: FloatArray = SLIPS, **more: object) -> bt.Study:
    """Wheel Wh32 under 80 N on its soil of Table 10 (Ding et al. 2015), at eight slips, read with noise."""
    wheel = bt.Wheel(0.15735, 0.165, 0.010, 30, shearing_radius_coefficient=0.65)
    exact = M1().sinkage(Soil(**TRUTH), wheel, slips, LOAD)
    force = "load [N]" if drive == "load" else "normal_force [N]"
    blank = pd.DataFrame(
        {"slip": slips, force: LOAD, "sinkage [m]": exact, "drawbar_pull [N]": 0.0, "resistance_moment [N m]": 0.0}
    )
    tables = {"model": "M1", "drive": drive, "noise": NOISE, "truth": TRUTH, "slip_reference": "shearing"}
    tables |= {"kind": "simulated", "source": "studies/benchmarks/samplers/run.py", **more}
    study = bt.Study(blank, {"Wh32": wheel}, **tables)
    return bt.Study(bt.simulate(study, TRUTH, seed=seed), {"Wh32": wheel}, **tables)


class Densities(NamedTuple):
    """A log density as vectorised samplers take it, as scalar ones do, and with its gradient."""

    many: Callable[[FloatArray], FloatArray]
    one: Callable[[FloatArray], float]
    gradient: Callable[[FloatArray], tuple[float, FloatArray]]


@dataclass(frozen=True)
class Problem:
    """A posterior of the benchmark."""

    study: bt.Study

    @cached_property
    def target(self) -> Target:
        """The posterior in our coordinates."""
        posterior = bt.posterior(self.study)
        return Target(posterior, coordinates(posterior))

    @cached_property
    def box(self) -> tuple[FloatArray, FloatArray]:
        """Ends of the flat prior (d,)."""
        low, high = np.array([law.range for law in self.target.posterior.prior.laws.values()]).T
        return low, high

    def prior_draws(self, n: int, rng: Generator) -> FloatArray:
        """Draws of the cut prior (n, d), physical."""
        return draw_cut_prior(self.target.posterior, n, rng).x

    @cached_property
    def rows(self) -> Rows:
        """What compiled code needs to know of the likelihood."""
        likelihood = self.target.posterior.likelihood
        forward = likelihood.forward
        _, rows, _ = forward.model.kernel_inputs(np.zeros((1, 9)), forward.conditions)
        order = [likelihood.channels.index(name) for name in forward.outcomes]
        scale = np.array([NOISE[name] for name in forward.outcomes])
        return Rows(
            rows,
            np.array(forward.given, dtype=np.float64)[None],
            np.ascontiguousarray(likelihood.measured[:, order]),
            scale,
            *self.box,
            not forward.drive.by_sinkage,
        )

    @cached_property
    def shear(self) -> FloatArray:
        """Constants of our coordinates, for the compiled map of single points."""
        (_, contact), (_, strength) = self.target.coordinates.blocks
        assert isinstance(contact, Contact)
        assert isinstance(strength, Strength)
        stress = contact.stress
        return np.array(
            [*stress.slips, *stress.entrance, stress.radius, stress.share, strength.stress, strength.displacement]
        )

    def space(self, name: str) -> Space:
        """The unit cube of the box, ``raw``, or our coordinates, ``ours``."""
        return Space(self, name)


@dataclass(frozen=True)
class Space:
    """The parameters that a sampler is given."""

    problem: Problem
    name: str

    def from_physical(self, x: FloatArray) -> FloatArray:
        """Points (n, d) of physical parameters (n, d)."""
        low, high = self.problem.box
        return (x - low) / (high - low) if self.name == "raw" else self.problem.target.coordinates.from_physical(x)

    def to_physical(self, u: FloatArray) -> FloatArray:
        """Physical parameters (n, d) of points (n, d)."""
        low, high = self.problem.box
        return low + u * (high - low) if self.name == "raw" else self.problem.target.coordinates.to_physical(u)[0]

    def start(self, n: int, rng: Generator) -> FloatArray:
        """Draws of the cut prior (n, d)."""
        return self.from_physical(self.problem.prior_draws(n, rng))

    @cached_property
    def densities(self) -> Densities:
        """Log density of points; in the raw space that of the physical parameters."""
        rows, shear = self.problem.rows, self.problem.shear
        if self.name == "raw":
            return Densities(
                lambda u: self.problem.target.posterior.log_density(self.to_physical(u)),
                lambda u: box_density(u, rows),
                lambda u: box_gradient(u, rows),
            )
        return Densities(
            self.problem.target.log_density,
            lambda u: sheared_density(u, shear, rows),
            lambda u: sheared_gradient(u, shear, rows),
        )

    @cached_property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """The box of nested samplers: in our coordinates a fifth wider than prior draws on each side."""
        if self.name == "raw":
            return np.zeros(len(NAMES)), np.ones(len(NAMES))
        u = self.start(20_000, np.random.default_rng(5))
        margin = 0.2 * np.ptp(u, axis=0)
        return u.min(axis=0) - margin, u.max(axis=0) + margin


@dataclass(frozen=True)
class Unbounded:
    """A space without edges for NUTS: the logit of the box, as PyMC and Stan do it, or our coordinates."""

    space: Space

    def start(self, rng: Generator) -> FloatArray:
        """A draw of the cut prior (d,)."""
        u = self.space.start(1, rng)[0]
        return logit(u) if self.space.name == "raw" else u

    def to_space(self, v: FloatArray) -> FloatArray:
        """Points of the space."""
        return expit(v) if self.space.name == "raw" else v

    def gradient(self, v: FloatArray) -> tuple[float, FloatArray]:
        """Log density and its gradient (d,) at one point (d,)."""
        if self.space.name != "raw":
            return self.space.densities.gradient(v)
        u = expit(v)
        value, slope = self.space.densities.gradient(u)
        width = u * (1 - u)
        with np.errstate(divide="ignore"):
            return value + float(np.log(width).sum()), slope * width + 1 - 2 * u
