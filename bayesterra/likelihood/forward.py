"""A model held at the conditions of a table, and derived quantities that tell a driver something.

Tables of many rows are told by few: between the slips at which a model bends its outcomes are smooth, and a
polynomial through Chebyshev nodes of each such piece tells any number of rows of one wheel under one load. Its last
coefficients say, soil by soil, whether it does.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from numpy.typing import NDArray
from scipy.linalg import block_diag

from bayesterra.arrays import BoolArray, FloatArray, IntArray, frozen
from bayesterra.errors import StudyError
from bayesterra.models import Conditions, ForwardModel, Wheel
from bayesterra.models.forces import NORMAL_FORCE, SINKAGE
from bayesterra.models.traction import greatest, traction
from bayesterra.parameters import SoilColumns, columns_of
from bayesterra.study.drive import Drive
from bayesterra.study.observations import Observations
from bayesterra.study.study import Study
from bayesterra.study.units import quantity

FEWEST, MORE = 6, 12
"""Nodes of a piece: so many, and so many more for each unit of slip."""
LAST, SMALL, FINE = 2, 1e-5, 1e-7
"""Coefficients at the end that must be small; as a share of radius (sinkage), load (drawbar pull) or both (moment).

What is left out of a row is far smaller: 1e-6 of usual noise on a posterior, 1e-3 at worst over the paper's box. Of
finer nodes they must be smaller: at a kink coefficients fall slowly, and what is left out is as great as they are."""


@dataclass(frozen=True)
class Nodes:
    """Conditions and loads of k nodes at which a model is run in place of the m rows of a table."""

    conditions: Conditions
    load: FloatArray  # (k,)
    spread: FloatArray  # (k, m): outcomes of the nodes times this are those of the rows
    tails: FloatArray  # (k, t): likewise the last coefficients of every piece
    sizes: FloatArray  # (3, t): what the coefficients of an outcome must not be greater than

    @classmethod
    def of(cls, model: ForwardModel, rows: Conditions, load: FloatArray, times: int = 1) -> "Nodes | None":
        """Nodes for some rows, so many ``times`` as many as most soils need.

        None where a model is not known to be smooth, or no wheel and load has enough rows.
        """
        names = [each.name for each in fields(rows)]
        known = np.column_stack([*(getattr(rows, name) for name in names if name != "slip"), load])
        if not model.compiled or np.isnan(known).any():
            return None
        kinds, first, kind = np.unique(known, axis=0, return_index=True, return_inverse=True)
        if len(load) <= FEWEST * len(kinds):
            return None
        mine = [np.flatnonzero(kind.ravel() == i) for i in range(len(kinds))]
        ends = zip(mine, model.bends(rows)[first], strict=True)
        parts = [_interpolation(rows.slip[own], bends, times) for own, bends in ends]
        if not any(tails.size for _, _, tails in parts):
            return None
        at = np.repeat(first, [len(slip) for slip, _, _ in parts])
        columns = {name: getattr(rows, name)[at] for name in names} | {"slip": np.concatenate([p[0] for p in parts])}
        small = SMALL if times == 1 else FINE
        sizes = [np.outer((rows.radius[i], load[i], load[i] * rows.radius[i]), np.full(tails.shape[1], small))
                 for i, (_, _, tails) in zip(first, parts, strict=True)]  # fmt: skip
        spread = block_diag(*(part[1] for part in parts))[:, np.argsort(np.concatenate(mine))]
        tails, conditions = block_diag(*(part[2] for part in parts)), Conditions(**columns)
        return cls(conditions, load[at], np.ascontiguousarray(spread), tails, np.hstack(sizes))

    def tell(self, values: FloatArray) -> BoolArray:
        """True (n,) where outcomes (n, k, 3) of the nodes, NaN without an answer, tell all rows."""
        return np.asarray((np.abs(values.swapaxes(1, 2) @ self.tails) <= self.sizes).all(axis=(1, 2)))

    def at_rows(self, values: FloatArray) -> FloatArray:
        """Outcomes (n, m, 3) of the rows."""
        return (values.swapaxes(1, 2) @ self.spread).swapaxes(1, 2)


def _interpolation(slip: FloatArray, bends: FloatArray, times: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Slips (k,) of the nodes of one wheel under one load, and matrices as of :class:`Nodes`.

    Where rows have no more slips than there would be nodes, the slips are the nodes and there are no coefficients.
    """
    slips, place = np.unique(slip, return_inverse=True)
    ends = [slips[0], *np.unique(bends[(bends > slips[0]) & (bends < slips[-1])]), slips[-1]]
    counts = [times * (FEWEST + round(MORE * (high - low))) for low, high in pairwise(ends)]
    nodes = 1 + sum(counts) - len(counts)  # pieces share their ends
    if len(slips) <= nodes:
        return slips, np.eye(len(slips))[:, place], np.zeros((len(slips), 0))
    at, spread, tails = np.empty(nodes), np.zeros((nodes, len(slip))), np.zeros((nodes, LAST * len(counts)))
    piece, start = np.searchsorted(ends[1:-1], slip), 0
    for i, (count, (low, high)) in enumerate(zip(counts, pairwise(ends), strict=True)):
        points, own = -np.cos(np.pi * np.arange(count) / (count - 1)), slice(start, start + count)
        coefficients = np.linalg.inv(chebvander(points, count - 1))
        at[own] = np.clip(low + (high - low) * (points + 1) / 2, low, high)
        inside = np.flatnonzero(piece == i)
        spread[own, inside] = (chebvander(2 * (slip[inside] - low) / (high - low) - 1, count - 1) @ coefficients).T
        tails[own, LAST * i : LAST * (i + 1)] = coefficients[-LAST:].T
        start += count - 1
    at[-1] = slips[-1]
    return at, spread, tails


@dataclass(frozen=True)
class Squares:
    """Sums of squared residuals in units of their scale, of readings whose rows are told by nodes.

    They are |R v − a|² for outcomes v of the k nodes; R has k + 1 rows at most.
    """

    scale: FloatArray  # of rows (m,)
    spread: FloatArray  # of outcomes of the nodes over the rows (k, m)
    read: BoolArray  # rows with a reading
    root: FloatArray  # R, (r, k)
    at: FloatArray  # a, (r,)

    @classmethod
    def of(cls, readings: FloatArray, scale: FloatArray, spread: FloatArray) -> "Squares":
        """Of readings (m,), NaN where there is none, with scales (m,)."""
        read = ~np.isnan(readings)
        both = np.linalg.qr((np.vstack([spread[:, read], readings[read]]) / scale[read]).T)[1]
        return cls(scale, spread, read, both[:, :-1], both[:, -1])

    def anew(self, readings: FloatArray) -> "Squares":
        """Those of other readings (m,)."""
        if (np.isnan(readings) == self.read).any():
            return Squares.of(readings, self.scale, self.spread)
        own = readings[self.read] / self.scale[self.read]
        basis, root = self._directions
        along = basis.T @ own
        at = np.append(along, np.linalg.norm(own - basis @ along))
        return replace(self, root=np.vstack([root, np.zeros(root.shape[1])]), at=at)

    @cached_property
    def _directions(self) -> tuple[FloatArray, FloatArray]:
        """Directions (readings, r) along which outcomes move readings, and their R (r, k)."""
        basis, root = np.linalg.qr((self.spread[:, self.read] / self.scale[self.read]).T)
        return basis, root

    @cached_property
    def logs(self) -> float:
        """Sum of the logarithms of the scales of readings."""
        return float(np.log(self.scale[self.read]).sum())

    @property
    def count(self) -> int:
        """Number of readings."""
        return int(self.read.sum())

    def __call__(self, values: FloatArray) -> FloatArray:
        """Sums (n,) for outcomes (n, k) of the nodes."""
        return np.asarray((self.residuals(values) ** 2).sum(axis=1))

    def residuals(self, values: FloatArray) -> FloatArray:
        """Few residuals (..., r + 1) with the same sum of squares, for outcomes (..., k) of the nodes."""
        return values @ self.root.T - self.at

    def slopes(self, derivatives: FloatArray) -> FloatArray:
        """Derivatives (r + 1, p) of :meth:`residuals`, from those (k, p) of the outcomes."""
        return self.root @ derivatives


Codes = NDArray[np.int8]
FINER = 4
"""How many times as many nodes soils get for which those before were too few."""
_FORCE = slice(NORMAL_FORCE, NORMAL_FORCE + 1)


@dataclass(frozen=True)
class Outcomes:
    """Modelled outcomes of every observation for every parameter set, by channel: ``outcomes["sinkage"]``."""

    names: tuple[str, ...]  # the k channels
    values: FloatArray  # (n, m, k), NaN where the model has no answer
    status: IntArray  # (n,) 0, or the highest ``Status`` among rows without an answer

    def __getitem__(self, name: str) -> FloatArray:
        """Values (n, m) of a channel, a view."""
        return self.values[:, :, self.names.index(name)]

    def add(self, name: str, amount: FloatArray) -> None:
        """Add to the values of a channel in place."""
        self[name][...] += amount

    def of(self, names: Sequence[str]) -> FloatArray:
        """Values (n, m, channels) of some channels in their order."""
        return self.values[:, :, [self.names.index(name) for name in names]]

    def take(self, chosen: IntArray | slice) -> "Outcomes":
        """Those of some parameter sets, also repeatedly."""
        return Outcomes(self.names, self.values[chosen], self.status[chosen])


def soil_at(soil: FloatArray, width: float) -> FloatArray:
    """Soil arrays (n, p) with the K_s of a wheel of ``width`` (m): k_c/b + k_φ where these are used.

    A modulus that is not positive is NaN: nothing carries the wheel.
    """
    if not _has_moduli(soil):
        return soil
    modulus, under = soil[:, SoilColumns.kc] / width + soil[:, SoilColumns.kphi], soil.copy()
    under[:, SoilColumns.Ks] = np.where(modulus > 0, modulus, np.nan)
    return under


def _has_moduli(soil: FloatArray) -> bool:
    return not bool(np.isnan(soil[:, SoilColumns.kc]).all())


def offset_of(soil: FloatArray) -> FloatArray:
    """Zero error (n, 1) of the sinkage readings, m, among soil arrays (n, p)."""
    return soil[:, [SoilColumns.sinkage_offset]]


def model_columns(soil: FloatArray, model: ForwardModel) -> FloatArray:
    """Columns (n, k) of soil arrays (n, p) that a model names."""
    return np.take(soil, columns_of(model.parameters), axis=1)


@dataclass(frozen=True)
class Forward:
    """A model held at rows: soil parameters in, outcomes of the drive out."""

    model: ForwardModel  # one of the models with its options
    drive: Drive  # what is given; ``both`` is ``load`` with the normal force among the outcomes
    conditions: Conditions  # slip and wheel of every row
    given: FloatArray  # load (N) or sinkage (m) of every row, (m,), or of every parameter set and row, (n, m)
    as_read: bool = False  # sinkages are readings, with the zero error of the instrument; else true ones
    times: int = 1  # how many times as many nodes tell the rows as most soils need

    @classmethod
    def of(cls, model: ForwardModel, drive: Drive, observations: Observations, wheels: dict[str, Wheel]) -> "Forward":
        """Hold ``model`` at the rows of ``observations``, whose sinkages are readings.

        With a latent load that is the one that a row knows best.
        """
        conditions = Conditions.of([wheels[name] for name in observations.wheel], observations.slip)
        return cls(model, drive, conditions, frozen(drive.given(observations)), as_read=True)

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Names along the last axis of the outcomes."""
        return self.drive.outcomes

    def __call__(self, soil: FloatArray, *, every_row: bool = False) -> Outcomes:
        """Model all rows for soil arrays (n, p).

        A set that fails in one row has no likelihood, so its other rows may be left without an answer too;
        with ``every_row`` each row that has an answer gets it.
        """
        if self.nodes is None:
            return self.exact(soil, every_row=every_row)
        at_nodes, told = self.at_nodes(self.nodes, soil)
        values = self.nodes.at_rows(at_nodes.values)
        outcomes = Outcomes(self.outcomes, values, np.zeros(len(soil), dtype=np.int64))
        if not told.all():
            rest = self.finer(soil[~told], every_row=every_row)
            values[~told], outcomes.status[~told] = rest.values, rest.status
        return outcomes

    def status(self, soil: FloatArray) -> IntArray:
        """Status (n,) of the same outcomes, which are worked out where they are needed for it only."""
        if self.nodes is None:
            return self.exact(soil).status
        told = self.at_nodes(self.nodes, soil)[1]
        status = np.zeros(len(soil), dtype=np.int64)
        if not told.all():
            status[~told] = self.finer.status(soil[~told])
        return status

    def exact(self, soil: FloatArray, *, every_row: bool = False) -> Outcomes:
        """The same where the model is run at every row."""
        inputs = self.given - offset_of(soil) if self.drive.by_sinkage and self.as_read else self.given
        values, status = self._answers(soil, inputs, every_row)
        if self.drive.latent_load:  # it is what the normal force reads
            force = np.where(np.isnan(values[:, :, SINKAGE]), np.nan, self.given)
            values = np.insert(values, self.outcomes.index("normal_force"), force, axis=2)
        outcomes = Outcomes(self.outcomes, values, np.max(status, axis=1, initial=0).astype(np.int64))
        if not self.drive.by_sinkage and self.as_read:
            outcomes.add("sinkage", offset_of(soil))
        return outcomes

    @cached_property
    def nodes(self) -> Nodes | None:
        """Nodes that tell the rows; None where loads are not given, or rows are few."""
        if self.drive.by_sinkage or self.drive.latent_load or self.given.ndim > 1 or self.times > FINER:
            return None
        return Nodes.of(self.model, self.conditions, self.given, self.times)

    @cached_property
    def finer(self) -> "Forward":
        """The same with more nodes, for soils that bend; then with none."""
        return replace(self, times=FINER * self.times)

    def held_at(self, nodes: Nodes) -> "Forward":
        """The same held at nodes as if they were rows."""
        return replace(self, conditions=nodes.conditions, given=nodes.load, as_read=False, times=FINER + 1)

    def at_nodes(self, nodes: Nodes, soil: FloatArray) -> tuple[Outcomes, BoolArray]:
        """Outcomes of the nodes for soil arrays (n, p), and for which of these (n,) they tell all rows."""
        outcomes = self.held_at(nodes).exact(soil)
        told = nodes.tell(outcomes.values)
        if self.as_read:
            outcomes.add("sinkage", offset_of(soil))
        return outcomes, told

    @cached_property
    def _alike(self) -> tuple[IntArray, IntArray]:
        """The first row of every kind of conditions and load, and the place (m,) of every row among these."""
        columns = [getattr(self.conditions, field.name) for field in fields(Conditions)]
        known = np.column_stack([*columns, self.given])
        _, first, place = np.unique(known, axis=0, return_index=True, return_inverse=True)
        return first, place.ravel()

    def _answers(self, soil: FloatArray, inputs: FloatArray, every_row: bool) -> tuple[FloatArray, Codes]:
        """Answers (n, m, width) for soil arrays (n, p), and their status (n, m); rows alike are modelled once."""
        if inputs is self.given and inputs.ndim == 1 and len(self._alike[0]) < len(inputs):
            first, place = self._alike
            few = replace(self, conditions=take(self.conditions, first), given=self.given[first])
            values, status = few._answers(soil, few.given, every_row)
            return values[:, place], status[:, place]
        groups = list(self.by_wheel(soil))
        if len(groups) == 1:
            return self.answers(groups[0][1], self.conditions, inputs, every_row=every_row)
        values = np.empty((len(soil), len(self.conditions.slip), self.width))
        status = np.empty(values.shape[:2], dtype=np.int8)
        for rows, theta in groups:
            part = take(self.conditions, rows)
            values[:, rows], status[:, rows] = self.answers(theta, part, inputs[..., rows], every_row=every_row)
        return values, status

    @property
    def width(self) -> int:
        """Number of answers of the model: the outcomes but for a latent load."""
        return len(self.drive.with_load.outcomes)

    def answers(
        self, theta: FloatArray, rows: Conditions, given: FloatArray, *, every_row: bool = False
    ) -> tuple[FloatArray, Codes]:
        """Answers of the model (n, m, width) in rows to what is given, and its status (n, m)."""
        run = self.model.forces_at if self.drive.by_sinkage else self.model.response_at
        return run(theta, rows, given, every_row=every_row)

    def slopes(
        self, theta: FloatArray, rows: Conditions, given: FloatArray, only: Sequence[int] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """The same answers, and their derivatives by its parameters, or ``only`` some of them, and by what is given.

        Under a load, z(θ, W) follows from F_N(z, θ) = W by the implicit function theorem.
        """
        values, _ = self.answers(theta, rows, given, every_row=True)
        if self.drive.by_sinkage:
            return values, self.model.jacobian_at(theta, rows, given, only)
        slopes = self.model.jacobian_at(theta, rows, values[..., SINKAGE])
        by_sinkage = slopes[..., -1:].copy()
        sinkage = np.concatenate([-slopes[..., _FORCE, :-1], np.ones_like(by_sinkage[..., _FORCE, :])], axis=-1)
        sinkage /= by_sinkage[..., _FORCE, :]
        slopes[..., -1] = 0.0
        slopes = slopes + by_sinkage * sinkage
        slopes[..., SINKAGE, :] = sinkage[..., 0, :]
        return values, self.model.known_under(given, slopes)

    def by_wheel(self, soil: FloatArray) -> Iterator[tuple[BoolArray, FloatArray]]:
        """Rows (m,) that share the parameters of the model, and these (n, k), for soil arrays (n, p)."""
        if not _has_moduli(soil):
            yield np.ones(len(self.conditions.slip), dtype=np.bool_), model_columns(soil, self.model)
            return
        for width in np.unique(self.conditions.width):
            yield self.conditions.width == width, model_columns(soil_at(soil, float(width)), self.model)

    def at_slip(self, slip: FloatArray) -> "Forward":
        """The same rows at other slips (m,)."""
        return replace(self, conditions=replace(self.conditions, slip=slip))

    def at_load(self, load: FloatArray | float) -> "Forward":
        """The same rows under other loads, one for all, (m,) or (n, m)."""
        return replace(self, given=np.broadcast_to(load, np.broadcast_shapes(np.shape(load), self.given.shape)))

    def row(self, i: int) -> "Forward":
        """The same model at row ``i`` only."""
        return self.rows(np.arange(len(self.conditions.slip)) == i)

    def rows(self, chosen: BoolArray) -> "Forward":
        """The same model at some rows (m,) only."""
        return replace(self, conditions=take(self.conditions, chosen), given=self.given[..., chosen])


def take(conditions: Conditions, rows: BoolArray | IntArray) -> Conditions:
    """The rows of ``conditions`` in ``rows`` (m,), a mask or places."""
    return Conditions(**{field.name: getattr(conditions, field.name)[rows] for field in fields(conditions)})


REFERENCE_SINKAGE = 0.010
REFERENCE_STRESS = 5e3


def reference_load(study: Study) -> float:
    """Median load (N) of the rows in the fit, of the normal force where no load was given.

    Else the middle of the latent loads' range; NaN where there is none.
    """
    loads = study.observations.used().carried
    return float(np.median(loads[~np.isnan(loads)])) if not np.isnan(loads).all() else study.middle_load


def load_of(study: Study, load: float | str | None) -> float:
    """A load (N) that was asked for, a number or text with a unit; None stands for the reference load.

    StudyError where it is not above 0, or not known.
    """
    value = reference_load(study) if load is None else quantity(load, "N", "load", bare=True)
    if np.isnan(value):
        raise StudyError("'load' must be given, as the study holds neither load nor normal force")
    if value <= 0:
        raise StudyError(f"'load' must be above 0 (got {value:g} N)")
    return value


def bearing_pressure(soil: FloatArray) -> FloatArray:
    """Bekker pressure K_s z^n0 at ``REFERENCE_SINKAGE`` and zero slip, Pa, eq. (5); soils (n, p)."""
    return soil[:, SoilColumns.Ks] * REFERENCE_SINKAGE ** soil[:, SoilColumns.n0]


def shear_strength(soil: FloatArray) -> FloatArray:
    """Strength c + σ tan φ at σ = ``REFERENCE_STRESS``, Pa; soils (n, p). Eq. (9) at large displacement."""
    return np.asarray(soil[:, SoilColumns.c] + REFERENCE_STRESS * np.tan(soil[:, SoilColumns.phi]))


def derive(study: Study, soil: FloatArray) -> dict[str, FloatArray]:
    """All quantities of ``DERIVED``, for the study's first wheel under its median load; see below."""
    return derive_for(study.model, next(iter(study.wheels.values())), reference_load(study), soil)


def derive_for(model: ForwardModel, wheel: Wheel, load: float, soil: FloatArray) -> dict[str, FloatArray]:
    """All quantities of ``DERIVED`` for ``wheel`` under ``load`` (N), each (n,), SI.

    ``soil`` (n, p) as every forward model takes it; NaN where the model has no answer.
    """
    soil = soil_at(soil, wheel.width)
    curves = traction(model, wheel, load, model_columns(soil, model))
    (pull, pull_slip), (efficiency, efficiency_slip) = map(greatest, curves)
    return {
        "bearing_pressure": bearing_pressure(soil),
        "shear_strength": shear_strength(soil),
        "peak_pull": pull,
        "peak_pull_slip": pull_slip,
        "peak_efficiency": efficiency,
        "peak_efficiency_slip": efficiency_slip,
    }
