"""Branch: the loading part of a plate test, from contact to the greatest load, and its readings."""

from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.errors import StudyError, counted
from bayesterra.reduce.log import LOGGED, Log

FEWEST = 20
"""Samples in air, at least, that tell the zero of a plate's force."""


@dataclass(frozen=True)
class Branch:
    """Loading branch of a plate test."""

    test: str  # its name
    log: Log  # the samples of the test, offsets subtracted
    stress: str  # ``force`` or ``pressure``, what was measured
    diameter: float  # of the plate, m
    zero: float  # reading of the sinkage at which the plate meets the soil, m
    air: float  # force or pressure in air before it, SI, subtracted from the readings
    loading: BoolArray  # samples (m,) of the branch
    readings: FloatArray  # sinkage, m, and force or pressure, SI, (k, 2): means of neighbours that hang together
    notes: tuple[str, ...]  # what was left out, and why


def branch_of(log: Log, plate: float | None) -> Branch:
    """The loading branch of one plate test; StudyError where a channel or the plate's diameter (m) is missing."""
    values = log.values
    stress = next((name for name in ("force", "pressure", "normal_force", "load") if name in values), "")
    if not stress or "sinkage" not in values:
        raise StudyError("a plate test needs 'sinkage [mm]' and 'force [N]' or 'pressure [kPa]'")
    diameter = float(values["plate_diameter"][0]) if "plate_diameter" in values else plate
    if diameter is None:
        raise StudyError("the plate's diameter is missing: --plate \"100 mm\", or a column 'plate_diameter [mm]'")
    there = ~(np.isnan(values["sinkage"]) | np.isnan(values[stress]))
    sinkage, force = values["sinkage"][there], values[stress][there]
    contact, air, noise = _contact(force)
    smooth = _running_mean(force - air)
    top = int(np.argmax(smooth))
    branch = (np.arange(len(force)) >= contact) & (np.arange(len(force)) <= top)
    # a loop lies between a greatest load so far and its return, where it falls by a tenth and by noise meanwhile
    most = np.maximum.accumulate(smooth)
    stretch = np.cumsum(smooth >= most)
    deep = np.unique(stretch[smooth < 0.9 * most - 4 * noise])
    loop = branch & np.isin(stretch, deep) & (smooth < most)
    loading = branch & ~loop
    zero = float(np.median(sinkage[contact - 2 : contact + 3])) if contact else 0.0
    readings = _independent(sinkage[loading] - zero, force[loading] - air)
    channel, after = LOGGED[stress], len(force) - 1 - top
    begins = f"contact at a reading of {zero * 1e3:.2f} mm; in air {air / channel.scale:.4g} {channel.unit}, subtracted"
    notes = (
        begins if contact else "it begins in contact: zeros are those of the log",
        *([f"{counted(int(loop.sum()), 'sample')} of unloading and reloading left out"] if loop.any() else []),
        *([f"{counted(after, 'sample')} after the greatest load left out"] if after else []),
        f"{counted(int(loading.sum()), 'sample')} thinned to {counted(len(readings), 'reading')}",
    )
    kept = np.zeros(len(there), dtype=np.bool_)
    kept[there] = loading
    named = "pressure" if stress == "pressure" else "force"
    return Branch(log.name, log, named, diameter, zero, air, kept, readings, notes)


def _contact(force: FloatArray) -> tuple[int, float, float]:
    """Sample of contact, mean force in air before it (0, 0 where the test begins in contact), noise of the force."""
    noise = float(1.4826 * np.median(np.abs(np.diff(force[: max(len(force) // 5, FEWEST)])))) / np.sqrt(2)
    smooth, start = _running_mean(force), float(np.median(force[:10]))
    loaded = int(np.argmax(smooth > start + 0.05 * (smooth.max() - start)))
    low = np.flatnonzero(smooth[:loaded] <= start + 4 * noise)
    contact = int(low[-1]) + 1 if low.size else 0
    if contact < FEWEST:
        return 0, 0.0, noise
    parts = np.array([part.mean() for part in np.array_split(force[: int(0.95 * contact)], 10)])
    level = np.ptp(parts) < 0.005 * (smooth.max() - start)
    return (contact, float(parts.mean()), noise) if level else (0, 0.0, noise)


def _running_mean(values: FloatArray, width: int = 5) -> FloatArray:
    padded = np.concatenate([np.full(width // 2, values[0]), values, np.full(width // 2, values[-1])])
    return np.convolve(padded, np.full(width, 1 / width), mode="valid")


def _independent(sinkage: FloatArray, stress: FloatArray, apart: float = 1.05) -> FloatArray:
    """Means (k, 2) of neighbours along the branch: as many as hang together, and 5 % of sinkage at least."""
    order = np.argsort(sinkage, kind="stable")
    order = order[sinkage[order] > 0]
    z, p = sinkage[order], stress[order]
    trend = _running_mean(p, 2 * max(len(p) // 40, 2) + 1)
    scatter = p - trend
    power = float(scatter @ scatter)
    correlation = float(np.clip(scatter[1:] @ scatter[:-1] / power, 0, 0.95)) if power > 0 else 0.0
    least = int(np.ceil((1 + correlation) / (1 - correlation)))
    readings, first = [], 0
    for end in range(1, len(z) + 1):
        if end == len(z) or (end - first >= least and z[end] >= apart * z[first]):
            readings.append((z[first:end].mean(), p[first:end].mean()))
            first = end
    return np.array(readings).reshape(-1, 2)
