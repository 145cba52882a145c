"""The flat box of a prior and the physical limits inside it, as linear inequalities of scaled parameters."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.laws import Law
from bayesterra.parameters import MODULI, NOISE_PREFIX
from bayesterra.posteriors import Posterior

TAIL = 1e-4
"""Probability beyond either end of the range of a law that has no end there."""
MARGIN = 1e-9
"""Distance kept from the open limits θm/θ1 = c3 and 1 and N = 0, and φ = 90°."""
SMALLEST = 1e-4
"""Lowest value, as a share of the highest, of a positive parameter whose range begins at 0."""


@dataclass(frozen=True)
class Chart:
    """Scaled parameters y of parameters x: each prior's range is [0, 1], on a log scale for some.

    The support of the prior is ``rows @ y <= limits``; limits that are not linear (a load that no sinkage
    carries) show as log likelihoods of −inf.

    Attributes
    ----------
    logs : parameters on a log scale: moduli K_s and K, noise (d,).
    ends : lower and upper end of each range (d, 2).
    low, width : lower end and width of each range, on its scale (d,).
    rows, limits : the inequalities (k, d) and (k,), the box among them.
    """

    logs: BoolArray
    ends: FloatArray
    low: FloatArray
    width: FloatArray
    rows: FloatArray
    limits: FloatArray

    def to_physical(self, y: FloatArray) -> FloatArray:
        """Parameters x (n, d) of scaled ones (n, d); never beyond the range by a rounding error."""
        scaled = np.clip(self.low + self.width * y, self.low, self.low + self.width)
        x = np.where(self.logs, np.exp(np.where(self.logs, scaled, 0.0)), scaled)
        return np.clip(x, self.ends[:, 0], self.ends[:, 1])

    def from_physical(self, x: FloatArray) -> FloatArray:
        """Scaled parameters (n, d) of parameters x (n, d)."""
        scaled = np.where(self.logs, np.log(np.where(self.logs, np.maximum(x, 1e-300), 1.0)), x)
        return np.asarray((scaled - self.low) / self.width)

    def stretch(self, x: FloatArray) -> FloatArray:
        """Derivatives dx/dy (n, d) at parameters x (n, d)."""
        return np.where(self.logs, x, 1.0) * self.width

    def slack(self, y: FloatArray) -> FloatArray:
        """How far scaled parameters (n, d) lie inside each inequality, (n, k)."""
        return np.asarray(self.limits - y @ self.rows.T)

    @cached_property
    def span(self) -> FloatArray:
        """Lowest and highest scaled value of each parameter that some others go with, (d, 2)."""
        from scipy.optimize import linprog

        unit = np.eye(len(self.low))
        free: list[tuple[None, None]] = [(None, None)] * len(unit)
        found = [
            [linprog(sign * axis, self.rows, self.limits, bounds=free).fun for sign in (1, -1)]
            for axis in unit
        ]
        ends = np.array([(0.0, -1.0) if None in pair else pair for pair in found], dtype=np.float64)
        return np.asarray(np.clip(ends * np.array([1.0, -1.0]), 0.0, 1.0))


def chart(posterior: Posterior) -> Chart:
    """The chart of a posterior's free parameters."""
    prior, names = posterior.prior, posterior.names
    ends = np.array([_ends(name, law) for name, law in prior.laws.items()]).reshape(-1, 2)
    logs = np.array([_logarithmic(name) for name in names]) & (ends[:, 1] > 0)
    ends[:, 0] = np.where(logs, np.maximum(ends[:, 0], SMALLEST * ends[:, 1]), ends[:, 0])
    scaled = np.where(logs[:, None], np.log(np.where(logs[:, None], ends, 1.0)), ends)
    low, width = scaled[:, 0], scaled[:, 1] - scaled[:, 0]
    identity = np.eye(len(names))
    rows, limits = [*identity, *-identity], [1.0] * len(names) + [0.0] * len(names)
    for weights, lowest in _physical(posterior):
        roots = {name: prior.root(name) for name in weights}
        known = sum(weights[name] * prior.fixed.get(root, 0.0) for name, root in roots.items())
        row = np.zeros(len(names))
        for name, root in roots.items():
            if root in names:
                row[names.index(root)] += weights[name]
        if row.any():
            rows.append(-row * width)
            limits.append(float(row @ low) + known - lowest)
    sizes = np.abs(np.array(rows)).max(axis=1)
    return Chart(logs, ends, low, width, np.array(rows) / sizes[:, None], np.array(limits) / sizes)


def _logarithmic(name: str) -> bool:
    return name in ("Ks", "K") or name.startswith(NOISE_PREFIX)


def _ends(name: str, law: Law) -> tuple[float, float]:
    """Ends of the range of a law, inside the physical range of the parameter."""
    low, high = law.range
    if not np.isfinite(low):
        low = float(law.quantile(np.array(TAIL)))
    if not np.isfinite(high):
        high = float(law.upper_quantile(np.array(TAIL)))
    if name in ("c", "phi"):
        low = max(low, 0.0)
    return (low, min(high, np.pi / 2 - MARGIN)) if name == "phi" else (low, high)


def _physical(posterior: Posterior) -> Iterator[tuple[Mapping[str, float], float]]:
    """Weighted sums of soil parameters, and what each must not be below."""
    forward = posterior.likelihood.forward
    inputs = forward.model.kernel_inputs(np.zeros((1, len(forward.model.parameters))), forward.conditions)[1]
    for s in {inputs[:, 0].min(), inputs[:, 0].max()}:
        yield {"c1": 1.0, "c2": s, "c3": -1.0}, MARGIN
        yield {"c1": -1.0, "c2": -s}, MARGIN - 1.0
    for s in {inputs[:, 1].min(), inputs[:, 1].max()}:
        yield {"n0": 1.0, "n1": s}, MARGIN
    if posterior.prior.uses_moduli:
        for width in np.unique(forward.conditions.width):
            yield dict(zip(MODULI, (1.0 / width, 1.0), strict=True)), 1.0
