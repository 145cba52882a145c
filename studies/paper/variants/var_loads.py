"""What a constant exponent below zero means where the load is given: no pressure that grows with sinkage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from paper_data import LOAD, NOISE, OUTCOMES, TRANSITION, hit_readings
from paper_data import readings as made
from paper_wheels import WHEELS as RIGS
from scipy.optimize import least_squares
from var_fits import CONSTANT, HIT, LOAD_DRIVEN, LOWEST, REFERENCE, WHEELS, im2, study_of

from bayesterra.arrays import FloatArray
from bayesterra.models import Wheel
from bayesterra.models.decoupled import Contact, largest_stress, mobilised, shape
from bayesterra.models.geometry import entrance_angle, shear_start_radius

DEPTHS = np.geomspace(5e-4, 0.08, 400)
"""Sinkages (m) among which an equilibrium is looked for."""
STARTS = 8


@dataclass(frozen=True)
class Grid:
    """CM1 (24) of one wheel at some slips, on a grid of sinkages; any exponent, also below zero.

    Attributes
    ----------
    slip : (m,).
    at : contact of every slip and depth, (m · depths,).
    """

    slip: FloatArray
    at: Contact

    @classmethod
    def of(cls, wheel: Wheel, slip: FloatArray) -> Grid:
        """Grid of ``DEPTHS`` at every slip."""
        s, z = (each.ravel() for each in np.meshgrid(slip, DEPTHS, indexing="ij"))
        start = shear_start_radius(wheel.radius, wheel.lug_height, s, transition_slips=TRANSITION)
        same = np.ones(len(s))
        contact = Contact(
            s, wheel.radius * same, wheel.width * same, float(wheel.shearing_radius(0.5)) * same,
            np.asarray(entrance_angle(z, wheel.radius)), np.arccos((wheel.radius - z) / start),
            np.nan * same, np.nan * same,
        )  # fmt: skip
        return cls(slip, contact)

    def forces(self, theta: FloatArray) -> FloatArray:
        """F_N, F_DP and M_DR (m, depths, 3) for parameters (9,)."""
        at, soil = self.at, theta.astype(complex)
        _, middle, A, B, C = shape(soil, at)
        stress = largest_stress(soil, middle, at)
        shear = mobilised(soil, middle, at) * (theta[3] + stress * np.tan(theta[4]))
        X, Y = at.radius * at.width * stress, at.shearing_radius * at.width * shear
        found = np.stack([A * X + B * Y, A * Y - B * X, at.shearing_radius * C * Y], axis=-1)
        return np.real(found).reshape(len(self.slip), len(DEPTHS), 3)

    def response(self, theta: FloatArray, load: FloatArray) -> FloatArray:
        """z, F_DP and M_DR (m, 3) at the first sinkage where F_N rises through the load; NaN without one.

        Where F_N falls with sinkage a wheel sinks on: such crossings are no equilibrium.
        """
        forces = self.forces(theta)
        out = np.full((len(self.slip), 3), np.nan)
        for i, one in enumerate(forces):
            above = one[:, 0] >= load[i]
            rising = np.flatnonzero(~above[:-1] & above[1:])
            if not len(rising):
                continue
            j = rising[0]
            share = (load[i] - one[j, 0]) / (one[j + 1, 0] - one[j, 0])
            depth = DEPTHS[j] ** (1 - share) * DEPTHS[j + 1] ** share
            out[i] = depth, *(one[j, 1:] + share * (one[j + 1, 1:] - one[j, 1:]))
        return out


def normal_force_over_depth() -> pd.DataFrame:
    """F_N of CM1 at slip 0.2 and the sinkages 2 to 60 mm, with what IM2 found: constant n, and N by (5)."""
    rows = []
    shown = np.array([2.0, 5.0, 10.0, 20.0, 40.0, 60.0])
    for wheel in WHEELS:
        grid = Grid.of(RIGS["Wh32" if wheel == HIT else wheel], np.array([0.2]))
        fits = {CONSTANT: im2(study_of(wheel, CONSTANT), n0=LOWEST), REFERENCE: im2(study_of(wheel, REFERENCE))}
        for variant, fit in fits.items():
            values = np.interp(shown, 1e3 * DEPTHS, grid.forces(fit.soil.as_array())[0, :, 0])
            found = {f"{depth:.0f} mm": value for depth, value in zip(shown, values, strict=True)}
            answers = [grid.response(fit.soil.as_array(), np.array([f * LOAD]))[0, 0] for f in (0.98, 1, 1.02)]
            named = dict(zip(["z_98", "z_100", "z_102"], 1e3 * np.array(answers), strict=True))
            rows.append({"data": wheel, "variant": variant, **found, **named})
    return pd.DataFrame(rows)


def below_zero(wheels: tuple[str, ...] = LOAD_DRIVEN) -> pd.DataFrame:
    """Load-driven least squares of CM1 with a constant n, where it may fall to −1, and to 0 only."""
    rows = []
    for wheel in wheels:
        table = hit_readings() if wheel == HIT else made(wheel)
        for lowest in (LOWEST, 0.0):
            chi2, best, answered = _best(RIGS["Wh32" if wheel == HIT else wheel], table, lowest)
            rows.append(
                {
                    "data": wheel,
                    "lowest_n": lowest,
                    "chi2": chi2,
                    "n": best[1],
                    "rows": len(table),
                    "answered": answered,
                }
            )
    return pd.DataFrame(rows)


def _best(wheel: Wheel, table: pd.DataFrame, lowest: float) -> tuple[float, FloatArray, int]:
    """Smallest χ² of many starts, its parameters and how many rows have an equilibrium."""
    grid = Grid.of(wheel, table["slip"].to_numpy())
    measured = table.iloc[:, 2:].to_numpy()
    scale = np.array([NOISE[name] for name in OUTCOMES])
    load = table["load [N]"].to_numpy()
    low = np.array([0.0, lowest, 0.0, 0.0, 5e-4, 0.0, -1.0])
    high = np.array([np.log(1e7), 2.0, 5000.0, np.radians(50), 0.05, 0.98, 1.0])

    def misfit(x: FloatArray) -> FloatArray:
        theta = np.array([np.exp(x[0]), x[1], 0.0, *x[2:], 0.0])
        away = (grid.response(theta, load) - measured) / scale
        return np.where(np.isnan(away), 100.0, away).ravel()

    rng = np.random.default_rng(1)
    starts = [low + (high - low) * rng.uniform(0.02, 0.98, len(low)) for _ in range(40 * STARTS)]
    starts = sorted(starts, key=lambda x: float(np.sum(misfit(x) ** 2)))[:STARTS]
    ends = [
        least_squares(misfit, x, bounds=(low, high), x_scale=high - low, diff_step=1e-4, max_nfev=200).x for x in starts
    ]
    best = min(ends, key=lambda x: float(np.sum(misfit(x) ** 2)))
    away = misfit(best)
    return float(np.sum(away**2)), best, int((away.reshape(-1, 3)[:, 0] != 100.0).sum())
