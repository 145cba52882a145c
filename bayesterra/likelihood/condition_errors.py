"""Errors of conditions to first order: slopes of outcomes over slip and load, and latent loads.

Where rows hang together a latent load W counts to first order. Outcomes are straight lines about a load L
near that which a row's readings tell, f(W) ≈ f(L) + g (W − L), and the flat prior of W is a normal law times
a factor: the one with which these readings leave W the same probability, mean and variance (assumed density
filtering; Minka 2001, Uncertainty in Artificial Intelligence 17, 362). That law is wide wherever the readings
tell a load well inside the range.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.likelihood.forward import Forward, Outcomes
from bayesterra.likelihood.sites import stand_in
from bayesterra.stats.tails import GAUSSIAN
from bayesterra.study.drive import Drive

STEP = 0.005
"""Step in slip for slopes, both ways: about an error of slip, as models bend at their transition slips."""
DEPTH_STEP = 1e-3
"""Step in sinkage for slopes over the load, as a share of it."""
LINES = 3
"""Loads at which outcomes are taken for straight lines, each told by the line before."""
VAGUE = 100.0
"""Standard deviation of a load that no reading tells, in ranges."""


def slip_slopes(
    forward: Forward, soil: FloatArray, channels: Sequence[str], outcomes: Outcomes | None = None
) -> FloatArray:
    """Slopes (n, m, channels) of outcomes over slip, to both sides as far as the model goes.

    ``outcomes`` are themselves, where they are known already.
    """
    values = (forward(soil, every_row=True) if outcomes is None else outcomes).of(channels)
    slip = forward.conditions.slip
    ends = np.maximum(slip - STEP, 0.0), np.where(slip + STEP < 1.0, slip + STEP, slip)
    moved = [(at, forward.at_slip(at)(soil, every_row=True).of(channels)) for at in ends]
    return _slopes(slip, values, moved)


def load_slopes(
    forward: Forward, soil: FloatArray, channels: Sequence[str], outcomes: Outcomes | None = None
) -> FloatArray:
    """Slopes (n, m, channels) of outcomes over the load of ``forward``, 1/N; see :func:`slip_slopes`.

    Of outcomes and load over sinkage, where forces are given without a search for the sinkage.
    """
    found = forward(soil, every_row=True) if outcomes is None else outcomes
    depth, moved = found["sinkage"], []
    for at in (depth * (1 - DEPTH_STEP), depth * (1 + DEPTH_STEP)):
        forces = Forward(forward.model, Drive.SINKAGE, forward.conditions, at)(soil, every_row=True)
        columns = [at if name == "sinkage" else forces[name] for name in channels]
        moved.append((forces["normal_force"], np.stack(columns, axis=2)))
    return _slopes(np.broadcast_to(forward.given, depth.shape), found.of(channels), moved)


def _slopes(here: FloatArray, values: FloatArray, moved: list[tuple[FloatArray, FloatArray]]) -> FloatArray:
    """Slopes between the two ends that conditions are moved to, as far as these have answers."""
    ends = []
    for at, shifted in moved:
        answered = np.isfinite(shifted) & np.isfinite(at)[..., None]
        ends.append((np.where(answered, shifted, values), np.where(answered, at[..., None], here[..., None])))
    (low, left), (high, right) = ends
    width, slopes = right - left, np.zeros_like(values)
    np.divide(high - low, width, out=slopes, where=(width > 0) & np.isfinite(values))
    return slopes


def told_loads(residuals: FloatArray, slopes: FloatArray, scale: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Precision of every row's load (n, m) as its readings tell it, and that times the load's shift.

    ``residuals`` (n, m, k) are NaN where there is no reading.
    """
    read = ~np.isnan(residuals)
    along = np.where(read, slopes / scale, 0.0)
    return (along**2).sum(axis=2), (along * np.where(read, residuals / scale, 0.0)).sum(axis=2)


@dataclass(frozen=True)
class Loads:
    """Latent loads of n parameter sets in m rows, to first order about loads L."""

    outcomes: Outcomes  # at L
    values: FloatArray  # of the channels at L (n, m, k)
    slopes: FloatArray  # of these over the load
    at: FloatArray  # L (n, m), inside the range
    mean: FloatArray  # of the normal laws in place of the flat prior (n, m)
    sd: FloatArray  # of these laws
    level: FloatArray  # log of the flat prior over these laws (n, m)

    @classmethod
    def told(
        cls,
        forward: Forward,
        soil: FloatArray,
        channels: Sequence[str],
        readings: FloatArray,
        ends: tuple[float, float],
        scatter: Callable[[FloatArray], FloatArray],
    ) -> "Loads":
        """Loads that readings (m, k) tell, row by row, by Gauss–Newton steps from those of ``forward``.

        ``ends`` are those of the flat prior; ``scatter`` gives standard deviations (n, m, k) of the readings
        of a row by itself about modelled values. A load that a soil does not carry is not stepped to.
        """
        vague = VAGUE * (ends[1] - ends[0])
        load = np.broadcast_to(forward.given, (len(soil), len(readings)))
        carried = np.full(load.shape, ends[0])
        for _ in range(LINES):
            outcomes = forward.at_load(load)(soil, every_row=True)
            lost = ~np.isfinite(outcomes.values).all(axis=2)
            if lost.any():
                load = np.where(lost, carried, load)
                outcomes = forward.at_load(load)(soil, every_row=True)
            at, values = load, outcomes.of(channels)
            slopes = load_slopes(forward.at_load(at), soil, channels, outcomes)
            precision, pull = told_loads(readings - values, slopes, scatter(values))
            precision = precision + vague**-2
            guess = np.nan_to_num(at + pull / precision)
            carried, load = at, np.clip(guess, *ends)
        low, high = ((end - guess) * precision**0.5 for end in ends)
        level, (shift, stretch) = GAUSSIAN.log_between(low, high), GAUSSIAN.pulls_between(low, high)
        bend = (stretch - shift**2) * precision
        mean, sd, level = stand_in(guess, 1.0 / precision, level, shift * precision**0.5, bend)
        return cls(outcomes, values, slopes, at, mean, sd, level - np.log(ends[1] - ends[0]))

    @property
    def predicted(self) -> FloatArray:
        """What the lines say at the mean loads (n, m, k)."""
        return self.values + self.slopes * (self.mean - self.at)[:, :, None]

    @property
    def effects(self) -> FloatArray:
        """Effects of one standard deviation of the loads on the channels (n, m, k)."""
        return self.slopes * self.sd[:, :, None]

    def take(self, chosen: IntArray) -> "Loads":
        """Those of some parameter sets, also repeatedly."""
        parts = (self.values, self.slopes, self.at, self.mean, self.sd, self.level)
        return Loads(self.outcomes.take(chosen), *(part[chosen] for part in parts))
