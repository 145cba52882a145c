"""Profiles of likelihood and posterior (Raue et al. 2009) of every free parameter over its whole prior range.

The profile of a parameter is the greatest log density that any choice of all others reaches, value by value:

    2 Δ log L(θ_j) = 2 [max log L − max over the others of log L at θ_j]

Below 0.99 and 3.84, the 68 and 95 % quantiles of χ² with one degree of freedom, lie the intervals. Likelihood
profiles stay inside the prior's range and the physical support: they are profiles of the posterior under
flat priors. Posterior profiles add the log density of the prior in physical parameters. Laws without an end
are followed to where 1e-4 of their probability is left.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np
import pandas as pd
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.identifiability.tracing import AGREE, Traces, standing_out, trace
from bayesterra.likelihood.joint import Whole
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior
from bayesterra.likelihood.target import Target, chart
from bayesterra.runtime.engines import Engine

LEVELS = {68: 0.99, 95: 3.84}
"""Thresholds of 2 Δ log density by percent."""
KINDS = ("likelihood", "posterior")
CLASSES = ("two-sided", "one-sided", "flat", "bounded only by the prior")
"""Classes of a profile by its crossings of the 95 % threshold inside the range: on both sides of the best
value; on one; on neither, and it stays below the 68 % threshold; on neither, though it rises above that."""
POOL = 2000
"""Most draws among which starts are chosen, and draws from the cut prior for that and for its spread."""
SHOWN = 0.25
"""Prior standard deviations from which another parameter's move is worth a word."""


@dataclass(frozen=True)
class Profile:
    """Profile of one parameter, SI.

    Attributes
    ----------
    name, kind : the parameter; one of ``KINDS``.
    values : of the parameter, ascending (g,).
    rise : 2 Δ log density above the best point of all profiles of this kind (g,), inf where nothing is
        possible.
    path : all parameters along the profile (g, d), NaN where nothing is possible.
    agreeing, tried : descents from different sides that reached the profile within 0.02 in log density, and
        all that were begun (g,).
    failed : points that no descent solved, with no value between others that have one, or above both their
        neighbours with no second descent that agrees (g,); nothing is read off them.
    """

    name: str
    kind: str
    values: FloatArray
    rise: FloatArray
    path: FloatArray
    agreeing: IntArray
    tried: IntArray
    failed: BoolArray

    @cached_property
    def sound(self) -> "Profile":
        """The profile without the points that failed."""
        if not self.failed.any():
            return self
        names = ("values", "rise", "path", "agreeing", "tried", "failed")
        return replace(self, **{name: getattr(self, name)[~self.failed] for name in names})

    @property
    def shape(self) -> str:
        """One of ``CLASSES``."""
        sides = sum(np.isfinite(self.crossings(95)))
        if sides:
            return CLASSES[0] if sides == 2 else CLASSES[1]
        highest = self.sound.rise[np.isfinite(self.sound.rise)].max()
        return CLASSES[3] if highest > LEVELS[68] else CLASSES[2]

    @property
    def best(self) -> float:
        """Value at which the profile is lowest."""
        return float(self.values[self.rise.argmin()])

    def crossings(self, percent: int) -> tuple[float, float]:
        """Outermost values at which the profile crosses the threshold, NaN on a side where it does not."""
        sound = self.sound
        below = np.flatnonzero(sound.rise <= max(LEVELS[percent], sound.rise.min()))
        first, last = int(below[0]), int(below[-1])
        return sound._crossing(first, first - 1, percent), sound._crossing(last, last + 1, percent)

    def _crossing(self, inside: int, outside: int, percent: int) -> float:
        """Place of the threshold between two points, by the root of the rise, straight for a parabola."""
        if not 0 <= outside < len(self.values) or np.isinf(self.rise[outside]):
            return float("nan")
        low, high = np.sqrt(np.maximum(self.rise[[inside, outside]], 0.0))
        share = (np.sqrt(LEVELS[percent]) - low) / (high - low)
        return float(self.values[inside] + share * (self.values[outside] - self.values[inside]))

    def interval(self, percent: int) -> tuple[float, float]:
        """Ends of the 68 or 95 % interval; the end of what is possible where there is no crossing."""
        low, high = self.crossings(percent)
        possible = self.values[np.isfinite(self.rise)]
        return (float(possible[0]) if np.isnan(low) else low, float(possible[-1]) if np.isnan(high) else high)

    @property
    def pieces(self) -> int:
        """Number of separate intervals below the 95 % threshold."""
        below = np.concatenate([[False], self.sound.inside])
        return int((below[1:] & ~below[:-1]).sum())

    @property
    def inside(self) -> BoolArray:
        """Points below the 95 % threshold (g,)."""
        return np.asarray((self.rise <= LEVELS[95]) & ~self.failed)

    @property
    def trust(self) -> float:
        """Share of the points near and below the 95 % threshold that two or more descents agree on."""
        counted = (self.rise <= 2 * LEVELS[95]) & ~self.failed
        return float((self.agreeing[counted] >= 2).mean())


@dataclass(frozen=True)
class Profiles:
    """Profiles of all free parameters; ``found`` nothing of a joint posterior.

    Attributes
    ----------
    names : the parameters.
    found : profiles by kind, in the order of ``names``.
    best : best point (d,) by kind.
    log_density : log likelihood or posterior density there, by kind.
    gain : by how much that lies above the best of the points that were known beforehand, by kind; NaN without
        any. Well above 0, what was known was no mode.
    prior_sd : standard deviations of the cut prior (d,).
    ranges : ends of the prior's ranges (d, 2), as far as the profiles were followed.
    """

    names: tuple[str, ...]
    found: Mapping[str, tuple[Profile, ...]]
    best: Mapping[str, FloatArray]
    log_density: Mapping[str, float]
    gain: Mapping[str, float]
    prior_sd: FloatArray
    ranges: FloatArray

    def profile(self, name: str, kind: str = "likelihood") -> Profile:
        """The profile of one parameter."""
        return self.found[kind][self.names.index(name)]

    def compensation(self, kind: str = "likelihood") -> pd.DataFrame:
        """Moves of each parameter (column) while another (row) runs over its 95 % interval.

        In standard deviations of the cut prior; negative where it falls as the other rises. The diagonal
        holds the width of the interval itself.
        """
        found = self.found.get(kind, ())
        rows = [_moves(profile, i) / self.prior_sd for i, profile in enumerate(found)]
        return pd.DataFrame(rows, index=[profile.name for profile in found], columns=list(self.names))

    @property
    def table(self) -> pd.DataFrame:
        """One row per kind and parameter.

        Columns kind, parameter, class, lower_95, lower_68, best, upper_68, upper_95 (SI; NaN where the
        threshold is not crossed), pieces, trust, failed (number of points), and compensated_by: the
        parameters that move most.
        """
        return pd.DataFrame([row for kind in self.found for row in self._rows(kind)], columns=COLUMNS)

    def _rows(self, kind: str) -> list[dict[str, object]]:
        moves = self.compensation(kind).to_numpy()
        rows = [(profile, profile.crossings(68), profile.crossings(95)) for profile in self.found[kind]]
        return [{
            "kind": kind, "parameter": profile.name, "class": profile.shape, "lower_95": wide[0], "lower_68": near[0],
            "best": profile.best, "upper_68": near[1], "upper_95": wide[1], "pieces": profile.pieces,
            "trust": profile.trust, "failed": int(profile.failed.sum()),
            "compensated_by": _leading(dict(zip(self.names, moves[i], strict=True)), profile.name),
        } for i, (profile, near, wide) in enumerate(rows)]  # fmt: skip


COLUMNS = [
    "kind", "parameter", "class", "lower_95", "lower_68", "best", "upper_68", "upper_95", "pieces", "trust",
    "failed", "compensated_by",
]  # fmt: skip
NO_PROFILES = (
    "No profiles of joint posteriors: the density of values of one population grows without end as the spread"
    " goes to 0, so there is no best point to hold them against. Verdicts rest on the draws."
)


def no_profiles(posterior: Whole, prior: FloatArray, draws: FloatArray) -> Profiles:
    """Profiles of a joint posterior: none, see ``NO_PROFILES``; the best point is the densest draw."""
    density, ends = posterior.log_density(draws), [law.range for law in posterior.prior.laws.values()]
    best, top = {"posterior": draws[density.argmax()]}, {"posterior": float(density.max())}
    return Profiles(posterior.names, {}, best, top, {}, prior.std(axis=0), np.array(ends))


def profiles(
    posterior: Posterior,
    *,
    rng: Generator,
    draws: FloatArray | None = None,
    prior_draws: FloatArray | None = None,
    references: FloatArray | None = None,
    engine: Engine | None = None,
) -> Profiles:
    """Profile likelihood and posterior density by every free parameter.

    Parameters
    ----------
    posterior : of the study, any drive.
    rng : chooses starts, and draws from the cut prior where none are given.
    draws : draws (n, d) of the posterior; starts are chosen among them and those of the prior.
    prior_draws : draws (n, d) of the cut prior.
    references : parameter sets (k, d), such as the mode, that the profiles are held against.
    engine : traces the parameters; by default this process. All engines give the same profiles.

    Raises
    ------
    SupportError : nothing of the prior lies in the physical support.
    """
    if prior_draws is None:
        prior_draws = draw_cut_prior(posterior, POOL, rng).x
    scaled = chart(posterior)
    point_sets = [np.atleast_2d(points) for points in (references, draws) if points is not None]
    sets = (prior_draws, *point_sets)
    pool = np.vstack([x if len(x) <= POOL else x[rng.choice(len(x), POOL, replace=False)] for x in sets])
    starts, beforehand = scaled.from_physical(pool), scaled.from_physical(np.vstack([*point_sets, pool[:0]]))
    target = Target(posterior, scaled, False, anchor=np.full(pool.shape[1], 0.5))
    levels = [0.5 * level for level in LEVELS.values()]
    traces = trace(target, starts, levels=levels, rng=rng, engine=engine)
    by_kind = {KINDS[0]: _Found.of(posterior.names, KINDS[0], target, traces, beforehand)}
    target = replace(target, with_prior=True)
    if not all(law.dist == "uniform" for law in posterior.prior.laws.values()):
        starts = np.vstack([starts, traces.best[0]])
        traces = trace(target, starts, levels=levels, rng=rng, engine=engine)
    by_kind[KINDS[1]] = _Found.of(posterior.names, KINDS[1], target, traces, beforehand)
    told = {of.name: {kind: getattr(each, of.name) for kind, each in by_kind.items()} for of in fields(_Found)}
    return Profiles(
        posterior.names, told["profiles"], told["best"], told["log_density"], told["gain"],
        prior_draws.std(axis=0), scaled.ends,
    )  # fmt: skip


@dataclass(frozen=True)
class _Found:
    """The profiles of one kind; see :class:`Profiles`."""

    profiles: tuple[Profile, ...]
    best: FloatArray
    log_density: float
    gain: float

    @classmethod
    def of(cls, names: tuple[str, ...], kind: str, target: Target, traces: Traces, beforehand: FloatArray) -> "_Found":
        """Read the profiles off the traces."""
        possible = np.isfinite(traces.value)
        level, x = np.full(len(possible), -np.inf), np.full(traces.y.shape, np.nan)
        level[possible] = target.log_density(traces.y[possible])
        x[possible] = target.chart.to_physical(traces.y[possible])
        top = int(level.argmax())
        agreeing = (traces.witnesses < traces.value[:, None] + AGREE).sum(axis=1)
        tried = (~np.isnan(traces.witnesses)).sum(axis=1)
        values = _values(target, traces)
        places = [np.flatnonzero(traces.column == i) for i in range(len(names))]
        rise = 2 * (level[top] - level)
        failed = standing_out(traces.column, -level) & (np.isinf(rise) | (agreeing < 2))
        each = tuple(
            Profile(name, kind, values[own], rise[own], x[own], agreeing[own], tried[own], failed[own])
            for name, own in zip(names, places, strict=True)
        )
        reference = target.log_density(beforehand).max() if len(beforehand) else np.nan
        return cls(each, x[top], float(level[top]), float(level[top] - reference))


def _values(target: Target, traces: Traces) -> FloatArray:
    """The profiled parameter at every grid point (g,), SI."""
    rows = np.arange(len(traces.place))
    y = np.full(traces.y.shape, 0.5)
    y[rows, traces.column] = traces.place
    return np.asarray(target.chart.to_physical(y)[rows, traces.column])


def _moves(profile: Profile, own: int) -> FloatArray:
    """Move of every parameter inside the 95 % interval (d,), with the sign of its correlation."""
    path = profile.path[profile.inside]
    centred = path - path.mean(axis=0)
    return np.asarray(np.ptp(path, axis=0) * np.where(centred[:, own] @ centred < 0, -1.0, 1.0))


def _leading(moves: Mapping[str, float], own: str) -> str:
    """The three others that move most, with their moves."""
    others = [name for name, move in moves.items() if name != own and abs(move) >= SHOWN]
    leading = sorted(others, key=lambda name: -abs(moves[name]))[:3]
    return ", ".join(f"{name} {moves[name]:+.1f}".replace("-", "−") for name in leading)
