"""A model of one's own: forces at a sinkage as a formula, from which all that a study needs follows.

>>> class Bevameter:
...     "Flat plate that slides: a law of 6 lines."
...     parameters = ("c", "phi", "K", ModelParameter("stiffness", "kPa/m", lower=0, description="stiffness"))
...     def forces(self, soil, wheel, slip, sinkage):
...         length = np.sqrt(2 * wheel.radius * sinkage)
...         normal = soil.stiffness * sinkage * wheel.width * length
...         shear = (soil.c * wheel.width * length + normal * np.tan(soil.phi)) * (1 - np.exp(-slip * length / soil.K))
...         return normal, shear, shear * wheel.radius
>>> model = OwnModel(Bevameter())
>>> model.parameters
('c', 'phi', 'K', 'stiffness')
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from types import SimpleNamespace
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from bayesterra.models.checks import BoolArray, FloatArray, IntArray
from bayesterra.models.conditions import Conditions, Status
from bayesterra.models.forces import NORMAL_FORCE, SINKAGE
from bayesterra.models.forward import Codes, ForwardModel
from bayesterra.models.soil import LOAD_EFFECT_FIELDS, SOIL_FIELDS

STEP = 6e-6
"""Step of central differences as a share of a value, or of the unit of its parameter: the cube root of 2e-16."""
CARRIED, STEPS = 1e-11, 200
"""Relative misfit of F_N at which a sinkage is taken, and steps at most."""
SHALLOWEST = 1e-9
"""Share of the radius below which no sinkage is looked for."""


@dataclass(frozen=True)
class ModelParameter:
    """A parameter of a model of one's own that the package does not know.

    Attributes
    ----------
    name : a word, by which formulas, priors and tables know it.
    unit : in which reports and tables speak, e.g. ``kPa/m``; "" for a pure number. Formulas get SI.
    lower, upper : physical range, in that unit; outside the posterior is 0. Both finite: a flat prior on it
        stands in where a study states none.
    symbol : for plots and tables; the name where it is left out.
    description : in words.
    """

    name: str
    unit: str = ""
    lower: float = -np.inf
    upper: float = np.inf
    symbol: str = ""
    description: str = ""

    def __post_init__(self) -> None:
        if not self.name.isidentifier():
            raise ValueError(f"the name of a parameter must be a word of letters and digits (got {self.name!r})")
        if not self.lower < self.upper:
            raise ValueError(f"'lower' of '{self.name}' must be below 'upper' (got {self.lower:g} and {self.upper:g})")


class ForceLaw(Protocol):
    """A formula for the forces on a wheel.

    ``parameters`` are names that the package knows (``c``, ``phi``, ``K``, ``Ks``, ``n0``, ...) and
    :class:`ModelParameter` for others. ``forces`` returns F_N (N), F_DP (N) and M_DR (N m) at a ``sinkage`` (m):
    arrays that broadcast against each other, as the arguments do. ``soil`` has every parameter as an attribute, SI
    and radians; ``wheel`` has ``radius``, ``width``, ``lug_height`` and ``shearing_radius``, m. F_N must rise
    with sinkage; NaN says that the formula has no answer. Optional: ``equations`` and ``source``, texts;
    ``slopes``, as ``forces`` but an array (n, m, 3, p + 1): exact derivatives by every parameter, then by sinkage.
    """

    @property
    def parameters(self) -> Sequence[str | ModelParameter]:
        """Names, and descriptions of parameters that the package does not know."""

    def forces(self, soil: Any, wheel: Conditions, slip: FloatArray, sinkage: FloatArray) -> Sequence[ArrayLike]:
        """F_N, F_DP and M_DR."""


@dataclass(frozen=True)
class OwnModel(ForwardModel):
    """A model of one's own, made of a law of forces.

    The sinkage under a load is solved for; derivatives are central differences unless the law has ``slopes``.

    Parameters
    ----------
    law : the formula, an object as :class:`ForceLaw` describes.
    stated : how a study file states it: ``use``, and keywords that made the law.
    scales : SI values of the units of its own parameters, by name; 1 for those left out.

    Raises
    ------
    ValueError : the law has no parameters, or one twice.
    """

    law: ForceLaw
    stated: Mapping[str, object] = field(default_factory=dict)
    scales: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        names = self.parameters
        if not names or len(set(names)) < len(names):
            raise ValueError(f"'parameters' of a model must be names, each once (got {', '.join(names) or 'none'})")

    @property
    def name(self) -> str:
        """The name of the law's class."""
        return type(self.law).__name__

    @property
    def equations(self) -> str:
        """What the law says of itself, else the first line of its docstring."""
        lines = (type(self.law).__doc__ or "forces by a law of its own").strip().splitlines()
        return str(getattr(self.law, "equations", lines[0].rstrip(".")))

    @property
    def source(self) -> str:
        """Publication that the law names."""
        return str(getattr(self.law, "source", ""))

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the law's parameters."""
        return tuple(each if isinstance(each, str) else each.name for each in self.law.parameters)

    @property
    def own(self) -> dict[str, ModelParameter]:
        """Parameters that the law brings along, by name."""
        return {each.name: each for each in self.law.parameters if isinstance(each, ModelParameter)}

    @property
    def options(self) -> dict[str, object]:
        """Keywords that made the law, and where it was loaded from."""
        return dict(self.stated)

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Physical ranges, SI, those of its own parameters as it states them."""
        own = {name: (each.lower * self.scale(name), each.upper * self.scale(name)) for name, each in self.own.items()}
        return {**super().ranges, **own}

    def scale(self, name: str) -> float:
        """SI value of the unit of a parameter, which is about how much of it matters."""
        return float(self.scales.get(name, _SIZES.get(name, 1.0)))

    def forces_at(
        self, theta: ArrayLike, conditions: Conditions, sinkage: ArrayLike, *, every_row: bool = False
    ) -> tuple[FloatArray, Codes]:
        """See :class:`ForwardModel`."""
        columns = self._columns(theta)[:, :, None]
        return self._forces(columns, conditions, np.broadcast_to(sinkage, _shape(columns, conditions)))

    def response_at(
        self, theta: ArrayLike, conditions: Conditions, load: ArrayLike, *, every_row: bool = False
    ) -> tuple[FloatArray, Codes]:
        """See :class:`ForwardModel`."""
        columns = self._columns(theta)[:, :, None]
        return self._response(columns, conditions, np.broadcast_to(load, _shape(columns, conditions)))

    def response_of_pairs(
        self, theta: ArrayLike, conditions: Conditions, load: ArrayLike, *, mean_load: FloatArray | None = None
    ) -> tuple[FloatArray, Codes]:
        """See :class:`ForwardModel`."""
        return self._response(self._columns(theta), conditions, np.asarray(load, dtype=np.float64))

    def jacobian_at(
        self, theta: ArrayLike, conditions: Conditions, sinkage: ArrayLike, only: Sequence[int] | None = None
    ) -> FloatArray:
        """See :class:`ForwardModel`; the law's own ``slopes``, or central differences good to some 1e-9."""
        columns = self._columns(theta)[:, :, None]
        shape = _shape(columns, conditions)
        depth = np.array(np.broadcast_to(sinkage, shape), dtype=np.float64)
        exact: Callable[..., FloatArray] | None = getattr(self.law, "slopes", None)
        if exact is not None:
            with np.errstate(all="ignore"):
                return np.array(exact(self._soil(columns), conditions, conditions.slip, depth), dtype=np.float64)
        out = np.empty((*shape, 3, len(columns) + 1))
        for i, name in enumerate(self.parameters):
            low, high = _ends(columns[i], self.scale(name), self.ranges.get(name, (-np.inf, np.inf)))
            sides = []
            for value in (low, high):
                moved = columns.copy()
                moved[i] = value
                sides.append(self._raw(moved, conditions, depth))
            out[..., i] = (sides[1] - sides[0]) / (high - low)[..., None]
        low, high = _ends(depth, 0.0, (0.0, np.inf))
        sides = [self._raw(columns, conditions, z) for z in (low, high)]
        out[..., -1] = (sides[1] - sides[0]) / (high - low)[..., None]
        return out

    def _columns(self, theta: ArrayLike) -> FloatArray:
        """Parameter sets (n, p) as columns (p, n)."""
        sets = np.asarray(theta, dtype=np.float64)
        if sets.ndim != 2 or sets.shape[1] != len(self.parameters):
            raise ValueError(f"'theta' must have shape (n, {len(self.parameters)}) (got {sets.shape})")
        return np.ascontiguousarray(sets.T)

    def _soil(self, columns: FloatArray) -> SimpleNamespace:
        return SimpleNamespace(**dict(zip(self.parameters, columns, strict=True)))

    def _raw(self, columns: FloatArray, conditions: Conditions, depth: FloatArray) -> FloatArray:
        """Forces (..., 3) as the law has them."""
        with np.errstate(all="ignore"):
            answers = self.law.forces(self._soil(columns), conditions, conditions.slip, depth)
        forces = [np.asarray(force, dtype=np.float64) for force in answers]
        if len(forces) != 3:
            raise ValueError(f"'forces' of {self.name} must return F_N, F_DP and M_DR (got {len(forces)} values)")
        try:
            return np.stack([np.broadcast_to(force, depth.shape) for force in forces], axis=-1)
        except ValueError:
            shapes = ", ".join(str(force.shape) for force in forces)
            raise ValueError(
                f"'forces' of {self.name} must return arrays of shape {depth.shape} (got {shapes})"
            ) from None

    def _forces(self, columns: FloatArray, conditions: Conditions, depth: FloatArray) -> tuple[FloatArray, Codes]:
        inside = (depth > 0) & (depth < conditions.radius)
        values = self._raw(columns, conditions, np.where(inside, depth, 0.5 * conditions.radius))
        status = np.where(np.isfinite(values).all(axis=-1), Status.OK, Status.NO_ANSWER).astype(np.int8)
        status[~inside] = Status.SINKAGE
        return np.where((status == Status.OK)[..., None], values, np.nan), status

    def _response(self, columns: FloatArray, conditions: Conditions, load: FloatArray) -> tuple[FloatArray, Codes]:
        depth, sinks = self._sinkage(columns, conditions, load)
        values, status = self._forces(columns, conditions, depth)
        values[..., SINKAGE] = np.where(status == Status.OK, depth, np.nan)
        status[sinks & (status == Status.OK)] = Status.LOAD
        return np.where((status == Status.OK)[..., None], values, np.nan), status

    def _sinkage(self, columns: FloatArray, conditions: Conditions, load: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Sinkages at which F_N is the load, and whether none below the radius carries it.

        Secants of log F_N over log z, in which a power law is a line, inside a bracket that is halved where they fail.
        """
        parts = (*columns, *(getattr(conditions, each.name) for each in fields(Conditions)), load)
        *pairs, loads = (np.ravel(part) for part in np.broadcast_arrays(*parts))
        sets, rows = np.stack(pairs[: len(columns)]), pairs[len(columns) :]

        def misfit(log_depth: FloatArray, of: IntArray) -> FloatArray:
            under = Conditions(*(column[of] for column in rows))
            with np.errstate(all="ignore"):
                gap = np.log(self._raw(sets[:, of], under, np.exp(log_depth))[:, NORMAL_FORCE] / loads[of])
            return np.where(np.isnan(gap), -_FAR, np.clip(gap, -_FAR, _FAR))  # F_N at most 0 is too little

        every, ends = np.arange(loads.size), np.log(rows[1])
        low, high = ends + np.log(SHALLOWEST), ends + np.log1p(-SHALLOWEST)
        below, above = misfit(low, every), misfit(high, every)
        root, sinks = high.copy(), above < 0
        active = np.flatnonzero(~sinks)
        for step in range(STEPS):
            if not active.size:
                break
            a, b, f, g = low[active], high[active], below[active], above[active]
            with np.errstate(all="ignore"):
                secant = b - g * (b - a) / (g - f)
            halved = (step % 3 == 2) | ~((secant > a) & (secant < b))
            root[active] = np.where(halved, 0.5 * (a + b), secant)
            gap = misfit(root[active], active)
            under, stays = gap < 0, np.where(halved, 1.0, 0.5)  # Illinois: an end that stays counts half
            low[active], high[active] = np.where(under, root[active], a), np.where(under, b, root[active])
            below[active], above[active] = np.where(under, gap, stays * f), np.where(under, stays * g, gap)
            done = (np.abs(gap) < CARRIED) | (high[active] - low[active] < 1e-15 * np.abs(b))
            active = active[~done]
        shape = load.shape
        return np.exp(root).reshape(shape), sinks.reshape(shape)


_FAR = 700.0
_SIZES = dict(
    zip(
        (*SOIL_FIELDS, *LOAD_EFFECT_FIELDS), (1e3, 1.0, 1.0, 1e3, 0.0175, 1e-3, 1.0, 1.0, 1.0, *(1.0,) * 4), strict=True
    )
)
"""Amounts of the parameters that the package knows, SI."""


def _shape(columns: FloatArray, conditions: Conditions) -> tuple[int, int]:
    return columns.shape[1], len(conditions.slip)


def _ends(values: FloatArray, scale: float, physical: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Values a step below and above, inside the physical range."""
    step = STEP * np.maximum(np.abs(values), scale)
    low, high = np.maximum(values - step, physical[0]), np.minimum(values + step, physical[1])
    return low, high
