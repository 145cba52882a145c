"""Tracing of a profile: points from both sides and from neighbours.

Every way to a grid point is an independent witness: from the mode, from the densest and from other draws near
it, from the neighbour on its left and on its right. The best of them is kept; how many of them agree is
counted. A point that stands out above both its neighbours, or has no value between two that have one, is
tried again from between them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.likelihood.target import Target
from bayesterra.runtime.engines import Engine, completed, in_process
from bayesterra.stats.optimiser import begin, descend

COARSE = 13
"""Grid points at equal distances over the range of a parameter."""
FINE = (0.5, 1.0, 1.5, 1.96, 2.5, 3.2)
"""Grid points on either side of the mode, in standard deviations of the quadratic model there."""
NEAR = 24
"""Draws nearest to a grid value among which the starts are chosen."""
DENSEST, OTHERS = 2, 2
"""Starts per grid point: the densest of the near draws, and others of them."""
SWEEPS = 40
"""Most rounds in which neighbours pass on their solutions."""
MOVED = 1e-3
"""Improvement of the log density after which a point's neighbours try its solution again."""
MENDS = 3
"""Most rounds in which points that stand out are tried again."""
SPIKE = 0.05
"""Height of the log density above both neighbours from which a point stands out."""
AGREE = 0.02
"""Descents whose log densities differ by less agree."""
REFINEMENTS = 2
"""Rounds in which points are added where a threshold is crossed."""
MODE_STARTS = 24
"""Points from which the mode is sought."""
SOURCES = 4 + DENSEST + OTHERS
LEFT, RIGHT, MODE = range(3)
BETWEEN = SOURCES - 1


@dataclass
class Traces:
    """Grid points of all parameters and the best that is known at each."""

    target: Target
    column: IntArray  # parameter of each point (g,)
    place: FloatArray  # its scaled value (g,)
    y: FloatArray  # best scaled parameters there (g, d)
    value: FloatArray  # minus log density there (g,), +inf where no way led to the support
    witnesses: FloatArray  # least value that each kind of start led to (g, SOURCES), NaN where not tried
    improved: BoolArray = field(init=False)

    def __post_init__(self) -> None:
        self.improved = np.isfinite(self.value)

    @classmethod
    def empty(cls, target: Target, column: IntArray, place: FloatArray) -> "Traces":
        """Points at which nothing is known yet, in order of parameter and value."""
        order = np.lexsort([place, column])
        n, d = len(column), len(target.chart.low)
        unknown = np.full((n, SOURCES), np.nan)
        return cls(target, column[order], place[order], np.zeros((n, d)), np.full(n, np.inf), unknown)

    def with_points(self, column: IntArray, place: FloatArray) -> "Traces":
        """These and new points in order; what is known stays."""
        new = Traces.empty(self.target, column, place)
        order = np.lexsort([np.append(self.place, new.place), np.append(self.column, new.column)])
        names = ("column", "place", "y", "value", "witnesses")
        joined = [np.concatenate([getattr(self, name), getattr(new, name)])[order] for name in names]
        out = Traces(self.target, *joined)
        out.improved = np.concatenate([self.improved, new.improved])[order]
        return out

    def attempt(self, points: IntArray, starts: FloatArray, source: IntArray) -> None:
        """Descend at grid points (k,) from starts (k, d) of kinds (k,) and keep what is better."""
        fixed, places = self.column[points], self.place[points]
        self.descend(points, begin(self.target, starts, fixed, places), source)

    def descend(self, points: IntArray, starts: FloatArray, source: IntArray) -> None:
        """Descend as in :meth:`attempt`, from starts that are at the grid points already."""
        held = np.arange(starts.shape[1]) == self.column[points, None]
        ends = descend(self.target, starts, held)
        np.fmin.at(self.witnesses, (points, source), ends.value)
        for i in np.argsort(-ends.value, kind="stable"):  # the best comes last and stays
            if ends.value[i] < self.value[points[i]]:
                self.improved[points[i]] |= ends.value[i] < self.value[points[i]] - MOVED
                self.y[points[i]], self.value[points[i]] = ends.y[i], ends.value[i]

    def sweep(self) -> bool:
        """Try each solution that has improved at the neighbours of its point; whether there were any."""
        points, starts, source = [], [], []
        for step, kind in ((-1, RIGHT), (1, LEFT)):
            neighbour = np.arange(len(self.place)) + step
            inside = (neighbour >= 0) & (neighbour < len(self.place)) & self.improved
            inside[inside] = self.column[neighbour[inside]] == self.column[inside]
            points.append(neighbour[inside])
            starts.append(self.y[inside])
            source.append(np.full(inside.sum(), kind))
        self.improved[:] = False
        where = np.concatenate(points)
        if where.size:
            self.attempt(where, np.concatenate(starts), np.concatenate(source))
        return bool(where.size)

    def settle(self) -> None:
        """Sweep until nothing improves, and try again what then stands out."""
        for _ in range(1 + MENDS):
            for _ in range(SWEEPS):
                if not self.sweep():
                    break
            if not self.mend():
                break

    def mend(self) -> bool:
        """Try points that stand out from between their neighbours; whether any of them improved.

        The support is convex but for limits that are not linear: what lies between two of its points is
        nearly always in it.
        """
        points = np.flatnonzero(standing_out(self.column, self.value))
        if not points.size:
            return False
        sound = np.flatnonzero(np.isfinite(self.value))
        left = sound[np.searchsorted(sound, points) - 1]
        right = sound[np.searchsorted(sound, points, side="right")]
        share = (self.place[points] - self.place[left]) / (self.place[right] - self.place[left])
        starts = [self.y[left] + w[:, None] * (self.y[right] - self.y[left]) for w in (share, 0.0 * share)]
        starts += [self.y[right].copy()]
        for start in starts:
            start[np.arange(len(points)), self.column[points]] = self.place[points]
        self.descend(np.tile(points, 3), np.concatenate(starts), np.full(3 * len(points), BETWEEN))
        return bool(self.improved[points].any())

    def settled(self, points: IntArray, starts: FloatArray, source: IntArray, engine: Engine) -> None:
        """Descend as in :meth:`attempt`, then sweep until nothing improves.

        Descents know nothing of each other and neighbours share a parameter: parameters are independent. With
        latent loads, whose likelihoods take long, each is a task of its own; else all are one, as together
        they take less time than a worker needs to start.
        """
        columns, long = tuple(np.unique(self.column).tolist()), self.target.latent  # each worth a task
        groups = tuple((column,) for column in columns) if long else (columns,)
        task = partial(self._alone, points, starts, source)
        for group, solution in completed(task, groups, engine if long else in_process()):
            own = np.isin(self.column, group)
            self.y[own], self.value[own], self.witnesses[own] = solution

    def _alone(
        self, points: IntArray, starts: FloatArray, source: IntArray, columns: tuple[int, ...]
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Best points, values and witnesses of the grids of some parameters; see :meth:`settled`."""
        own = np.isin(self.column, columns)
        names = ("column", "place", "y", "value", "witnesses")
        part = Traces(self.target, *(getattr(self, name)[own].copy() for name in names))
        part.improved = self.improved[own].copy()
        mine, where = own[points], np.cumsum(own) - 1
        if mine.any():
            part.attempt(where[points[mine]], starts[mine], source[mine])
        part.settle()
        return part.y, part.value, part.witnesses

    @property
    def best(self) -> tuple[FloatArray, float]:
        """The best point known (d,) and its value."""
        i = int(self.value.argmin())
        return self.y[i], float(self.value[i])


def standing_out(column: IntArray, value: FloatArray) -> BoolArray:
    """Grid points (g,) without a value between two that have one, or above both of these by ``SPIKE``.

    Parameters
    ----------
    column : parameter of each point (g,), which are in order of parameter and place.
    value : minus log density there (g,), +inf where there is none.
    """
    out = np.zeros(len(value), dtype=np.bool_)
    for parameter in np.unique(column):
        own = np.flatnonzero(column == parameter)
        sound = own[np.isfinite(value[own])]
        if len(sound) < 3:
            continue
        out[own] = np.isinf(value[own]) & (own > sound[0]) & (own < sound[-1])
        beside = np.maximum(value[sound[:-2]], value[sound[2:]])
        out[sound[1:-1]] = value[sound[1:-1]] > beside + SPIKE
    return out


def trace(
    target: Target, pool: FloatArray, *, levels: Sequence[float], rng: Generator, engine: Engine | None = None
) -> Traces:
    """Trace the profiles of all parameters.

    Parameters
    ----------
    target : what is minimised.
    pool : scaled parameter sets (n, d) inside the support, from which starts are chosen.
    levels : heights above the least value at which the places of crossing matter.
    engine : traces the parameters; by default this process.
    """
    engine = engine or in_process()
    density = target.value(pool)
    mode = _mode(target, pool[np.argsort(density)[:MODE_STARTS]])
    target = replace(target, anchor=mode)
    traces = Traces.empty(target, *_grid(target, mode))
    traces.settled(*_beginnings(traces, pool, density, mode, rng), engine)
    for _ in range(REFINEMENTS):
        mode = _mode(target, np.stack([mode, traces.best[0]]))
        column, place = _crossings(traces, levels)
        # the best of the others may show a mode near which some profile has no point
        unheld = max(traces.value[traces.column == i].min() for i in range(len(mode))) > traces.best[1] + MOVED
        if unheld or float(target.value(mode[None])[0]) < traces.best[1] - MOVED:
            column, place = np.append(column, np.arange(len(mode))), np.append(place, mode)
        if not column.size:
            break
        # more points are found from the mode and from their neighbours
        traces = traces.with_points(column, place)
        unknown = np.isinf(traces.value)
        traces.improved[:] = ~unknown & (np.roll(unknown, 1) | np.roll(unknown, -1))  # points next to one of these
        new = np.flatnonzero(unknown)
        traces.settled(new, np.repeat(mode[None], len(new), axis=0), np.full(len(new), MODE), engine)
    return traces


def _mode(target: Target, starts: FloatArray) -> FloatArray:
    """Least point that free descents from the starts (k, d) reach."""
    ends = descend(target, starts, np.zeros(starts.shape, dtype=np.bool_))
    return np.asarray(ends.y[ends.value.argmin()])


def _grid(target: Target, mode: FloatArray) -> tuple[IntArray, FloatArray]:
    """Parameter and scaled value of every grid point: coarse over the range, fine about the mode."""
    span = target.chart.span
    curvature = target.local(mode[None]).curvature[0] + 1e-6 * np.eye(len(mode))
    sd = np.sqrt(np.diag(np.linalg.inv(curvature)))
    both = np.array([*(-np.array(FINE[::-1])), 0.0, *FINE])
    columns, places = [], []
    for i, (low, high) in enumerate(span):
        near = mode[i] + sd[i] * both
        coarse = _even(target, i, low, high)
        place = np.unique(np.concatenate([coarse, near[(near > low) & (near < high)], mode[i : i + 1]]))
        columns.append(np.full(len(place), i))
        places.append(place)
    return np.concatenate(columns), np.concatenate(places)


def _even(target: Target, i: int, low: float, high: float) -> FloatArray:
    """Scaled values that are evenly spaced on the scale of the prior's law, and both ends exactly."""
    chart, law = target.chart, list(target.posterior.prior.laws.values())[i]
    if not chart.logs[i] or law.dist in ("loguniform", "lognorm"):
        return np.linspace(low, high, COARSE)
    first, last = (float(np.exp(chart.low[i] + chart.width[i] * end)) for end in (low, high))
    inner = (np.log(np.linspace(first, last, COARSE)[1:-1]) - chart.low[i]) / chart.width[i]
    return np.array([low, *inner, high])


def _beginnings(
    traces: Traces, pool: FloatArray, density: FloatArray, mode: FloatArray, rng: Generator
) -> tuple[IntArray, FloatArray, IntArray]:
    """Grid points, starts and kinds of the first descents: from the mode and from draws near each point."""
    g = len(traces.place)
    points, starts = [np.arange(g)], [np.repeat(mode[None], g, axis=0)]
    source = [np.full(g, MODE)]
    distance = np.abs(pool[:, traces.column] - traces.place)
    near = np.argsort(distance, axis=0)[:NEAR]
    near = np.take_along_axis(near, np.argsort(density[near], axis=0), axis=0)
    others = DENSEST + rng.permuted(np.repeat(np.arange(len(near) - DENSEST)[:, None], g, axis=1), axis=0)
    ranks = np.vstack([np.repeat(np.arange(DENSEST)[:, None], g, axis=1), others[:OTHERS]])
    for k, rank in enumerate(ranks):
        points.append(np.arange(g))
        starts.append(pool[near[rank, np.arange(g)]])
        source.append(np.full(g, MODE + 1 + k))
    return np.concatenate(points), np.concatenate(starts), np.concatenate(source)


def _crossings(traces: Traces, levels: Sequence[float]) -> tuple[IntArray, FloatArray]:
    """Points to add: where the profiles cross a level between two grid points."""
    column, place = traces.column, traces.place
    height = traces.value - traces.best[1]
    same = column[1:] == column[:-1]
    columns, places = [], []
    for level in levels:
        crossed = np.flatnonzero(same & ((height[1:] > level) != (height[:-1] > level)))
        root = np.sqrt(np.minimum(np.maximum(np.stack([height[crossed], height[crossed + 1]]), 0.0), 1e6))
        share = np.clip((np.sqrt(level) - root[0]) / (root[1] - root[0]), 0.1, 0.9)
        columns.append(column[crossed])
        places.append(place[crossed] + share * (place[crossed + 1] - place[crossed]))
    return np.concatenate(columns), np.concatenate(places)
