"""Simulated logs of drives: forces with lug ripple and noise that hangs together, around known means."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.random import Generator
from scipy.signal import lfilter

RADIUS, LUGS, RATE, TRAVEL = 0.1, 24, 100.0, 0.012
"""Wheel (m), samples a second, m/s."""
STATES = ((0.1, 90.0), (0.4, 80.0))
"""Slip and seconds of every commanded state, one after the other."""
MEANS = {
    "sinkage [mm]": (6.0, 11.0),
    "normal_force [N]": (80.0, 80.5),
    "drawbar_pull [N]": (12.0, 19.0),
    "resistance_moment [N m]": (2.5, 4.0),
}
"""True means of every state."""
RIPPLE = {"sinkage [mm]": 0.15, "normal_force [N]": 2.0, "drawbar_pull [N]": 2.5, "resistance_moment [N m]": 0.3}
NOISE = {"sinkage [mm]": 0.06, "normal_force [N]": 0.8, "drawbar_pull [N]": 0.8, "resistance_moment [N m]": 0.1}
MEMORY, SETTLING = 0.8, 4.0
"""Correlation time of the noise, and time of settling after a step, s."""


@dataclass(frozen=True)
class SimulatedDrive:
    """A log and its truth.

    Attributes
    ----------
    table : samples, labelled simulated.
    truth : by column, a mean for every state.
    """

    table: pd.DataFrame
    truth: Mapping[str, tuple[float, ...]]


def noise(n: int, rng: Generator, memory: float) -> np.ndarray:
    """Gaussian noise (n,) of variance 1 with correlation exp(−t/memory); memory in samples."""
    keep = np.exp(-1 / memory)
    start = rng.standard_normal()
    white = np.sqrt(1 - keep**2) * rng.standard_normal(n)
    return np.asarray(lfilter([1.0], [1.0, -keep], white, zi=[keep * start])[0])


def simulated_drive(rng: Generator, states: tuple[tuple[float, float], ...] = STATES) -> SimulatedDrive:
    """One log: standing for 3 s, then the states; every channel settles, ripples with lugs and turns, and is noisy."""
    lengths = [int(3 * RATE), *(int(seconds * RATE) for _, seconds in states)]
    state, n = np.repeat(np.arange(len(lengths)), lengths), sum(lengths)
    time, moving = np.arange(n) / RATE, state > 0
    rim = np.array([0.0, *(TRAVEL / (1 - slip) for slip, _ in states)])[state]
    travel = np.where(moving, TRAVEL, 0.0)
    angle = np.cumsum(rim) / RATE / RADIUS
    since = time - np.repeat(np.concatenate([[0.0], np.cumsum(lengths)[:-1] / RATE]), lengths)
    columns = {
        "time [s]": time,
        "travel_speed [mm/s]": 1e3 * travel + moving * 0.15 * rng.standard_normal(n),
        "rim_speed [mm/s]": 1e3 * rim * (1 + 0.02 * np.sin(LUGS * angle)) + moving * 0.25 * rng.standard_normal(n),
    }
    for name, means in MEANS.items():
        level = np.array([0.0, *means[: len(states)]])
        before = level[np.maximum(state - 1, 0)]
        steady = level[state] + (before - level[state]) * np.exp(-since / SETTLING) * moving
        phase, size = rng.uniform(0, 2 * np.pi, 3), RIPPLE[name]
        ripple = size * np.sin(LUGS * angle + phase[0]) + 0.4 * size * np.sin(2 * LUGS * angle + phase[1])
        ripple += 0.1 * size * np.sin(angle + phase[2])
        columns[name] = steady + moving * (ripple + NOISE[name] * noise(n, rng, MEMORY * RATE))
    table = pd.DataFrame(columns).round(5).assign(remark="simulated")
    return SimulatedDrive(table, {name: means[: len(states)] for name, means in MEANS.items()})
