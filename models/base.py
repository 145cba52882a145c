"""Common parts of the models of Ding et al. 2015: checks, broadcasting, and the way to the compiled kernels."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesterra.models.checks import FloatArray, as_floats, plain, require
from bayesterra.models.conditions import Conditions, Status
from bayesterra.models.contact import Contact
from bayesterra.models.forces import SINKAGE, Components, Forces
from bayesterra.models.forward import ForwardModel
from bayesterra.models.geometry import SHEAR_STARTS, Floats, exponent, shear_start_radius
from bayesterra.models.soil import LOAD_EFFECT_FIELDS, SOIL_FIELDS, LoadEffectSoil, Soil
from bayesterra.models.wheel import Wheel

Codes = NDArray[np.int8]
_CONTACT_RULE = "must lie between c3 and 1, and c3 in [-1, 1)"
ShearStart = Literal["transition", "rim", "tip"]


@dataclass(frozen=True)
class _Pairs:
    """Broadcast inputs, flattened to P pairs of one parameter set and one row each."""

    theta: FloatArray
    conditions: Conditions
    exponent: FloatArray
    given: FloatArray
    shape: tuple[int, ...]

    def check(self, status: Codes) -> None:
        """Raise ValueError for the first pair that the model cannot serve."""
        codes = status.reshape(self.shape)
        t, slip = self.theta.T, self.conditions.slip
        for code, name, rule, value in (
            (Status.EXPONENT, "n0 + n1 s", "must be positive", self.exponent),
            (Status.CONTACT_ANGLE, "c1 + c2 s", _CONTACT_RULE, t[6] + t[7] * slip),
            (Status.NORMAL_FORCE, "sinkage", "must have a normal force in eq. (42)", self.given),
            (Status.LOAD, "load", "must be carried by a sinkage below the wheel radius", self.given),
        ):
            require(codes != code, name, rule, value.reshape(self.shape))


@dataclass(frozen=True, kw_only=True)
class WheelSoilModel(ForwardModel):
    """A model of Ding et al. 2015: M1, M2, M3 or M2L.

    Soil fields, slip, sinkage and load broadcast by NumPy's rules; results have the broadcast shape. Values
    outside the model's range raise ValueError. The methods ending in `_at` are the batch interface: parameter
    sets (n, p) in the order of `parameters` against m rows, a status code in place of an error, NaN where the
    status is not OK.
    """

    transition_slips: tuple[float, float] = (0.15, 0.5)
    """s_j1, s_j2 of Ding et al. 2015, (13): between them the shear's start moves from the lug tips to the rim."""
    shear_start: ShearStart = "transition"
    """Radius R_j at which shearing starts: Ding et al. 2015, (13), or held at "rim" (r) or "tip" (r + h)."""
    constant_exponent: bool = False
    """Leave slip out of the sinkage exponent: N = n0."""

    equations: ClassVar[str]
    compiled: ClassVar[bool] = True
    source: ClassVar[str] = "Ding et al. 2015"
    parameters: ClassVar[tuple[str, ...]] = SOIL_FIELDS
    _kind: ClassVar[tuple[int, ...]]

    def __post_init__(self) -> None:
        first, second = self.transition_slips
        if not 0 <= first < second <= 1:
            raise ValueError(f"'transition_slips' must rise within [0, 1] (got {self.transition_slips})")
        if self.shear_start not in SHEAR_STARTS:
            names = ", ".join(SHEAR_STARTS)
            raise ValueError(f"'shear_start' must be one of {names} (got {self.shear_start!r})")

    @property
    def options(self) -> dict[str, object]:
        """Options by name."""
        return asdict(self)

    @property
    def holds(self) -> dict[str, float]:
        """Parameters that the options hold: n1 at 0 where slip is left out of the exponent."""
        return {"n1": 0.0} if self.constant_exponent else {}

    def bends(self, conditions: Conditions) -> FloatArray:
        """Transition slips (m, 2) of wheels with lugs."""
        ends = np.broadcast_to(self.transition_slips, (len(conditions.slip), 2))
        turning = (conditions.lug_height > 0) & (self.shear_start == "transition")
        return np.where(turning[:, None], ends, np.nan)

    def limits(self, conditions: Conditions) -> Iterator[tuple[Mapping[str, float], float]]:
        """Contact angles inside (c3, 1), and exponents above 0, at the least and the greatest slip."""
        slip, of_exponent = conditions.slip, self._exponent_slip(conditions.slip)
        for s in {slip.min(), slip.max()}:
            yield {"c1": 1.0, "c2": s, "c3": -1.0}, 0.0
            yield {"c1": -1.0, "c2": -s}, -1.0
        for s in {of_exponent.min(), of_exponent.max()}:
            yield {"n0": 1.0, "n1": s}, 0.0

    def forces(self, soil: Soil, wheel: Wheel, slip: Floats, sinkage: Floats) -> Forces:
        """F_N, F_DP and M_DR at a sinkage in m, Ding et al. 2015, eq. (14), (24) or (25)."""
        values, shape = self._results(soil, wheel, slip, sinkage, width=3)
        return Forces(*(plain(values[:, i].reshape(shape)) for i in range(3)))

    def components(self, soil: Soil, wheel: Wheel, slip: Floats, sinkage: Floats) -> Components:
        """F_N and F_DP by stress and by part of the arc, eq. (15); M3 has no F_Ntau, so it is zero."""
        values, shape = self._results(soil, wheel, slip, sinkage, width=11)
        return Components(*(plain(values[:, i].reshape(shape)) for i in range(3, 11)))

    def sinkage(self, soil: Soil, wheel: Wheel, slip: Floats, load: Floats) -> Floats:
        """The sinkage in m at which F_N equals `load` in N to 1e-10, relative."""
        from bayesterra.models import batch  # numba is heavy: only where it is needed

        pairs = self._pairs(soil, wheel, slip, load=load)
        require(pairs.given > 0, "load", "must be positive", pairs.given.reshape(pairs.shape))
        given = pairs.given[:, None]
        values, status = batch.response(pairs.theta, self._rows(pairs.conditions), given, self._plan(paired=True))
        pairs.check(status)
        return plain(values[:, 0, SINKAGE].reshape(pairs.shape))

    def stresses(self, soil: Soil, wheel: Wheel, slip: Floats, sinkage: Floats, angle: Floats) -> tuple[Floats, Floats]:
        """Normal and shear stress in Pa at `angle` in rad from the vertical; zero off the arc."""
        pairs = self._pairs(soil, wheel, slip, sinkage=sinkage)
        _check_sinkage(pairs, wheel)
        inputs = (*pairs.theta.T, pairs.exponent, pairs.conditions.slip, pairs.given)
        *theta, n, slips, depth, angles = np.broadcast_arrays(
            *(values.reshape(pairs.shape) for values in inputs), as_floats("angle", angle)
        )
        kind = Soil if len(theta) == len(SOIL_FIELDS) else LoadEffectSoil
        contact = Contact.of(kind(*theta), wheel, slips, depth, self._start_radius(wheel, slips), n)
        normal, shear = self._stresses(contact, angles)
        on_arc = (angles >= contact.leaving) & (angles <= contact.entrance)
        return plain(np.where(on_arc, normal, 0.0)), plain(np.where(on_arc, shear, 0.0))

    def forces_at(
        self, theta: ArrayLike, conditions: Conditions, sinkage: ArrayLike, *, every_row: bool = False
    ) -> tuple[FloatArray, Codes]:
        """F_N, F_DP, M_DR (n, m, 3) and status (n, m) at `sinkage` (m,) or (n, m).

        A set whose parameters fail in one row is refused in all rows, unless `every_row`.
        """
        from bayesterra.models import batch

        plan = self._plan(every_row=every_row)
        return batch.forces(batch.parameters(theta, len(self.parameters)), self._rows(conditions), sinkage, plan)

    def response_at(
        self, theta: ArrayLike, conditions: Conditions, load: ArrayLike, *, every_row: bool = False
    ) -> tuple[FloatArray, Codes]:
        """z, F_DP, M_DR (n, m, 3) and status (n, m) under `load` (m,) or (n, m); see `forces_at`."""
        from bayesterra.models import batch

        plan = self._plan(every_row=every_row)
        return batch.response(batch.parameters(theta, len(self.parameters)), self._rows(conditions), load, plan)

    def response_of_pairs(
        self, theta: ArrayLike, conditions: Conditions, load: ArrayLike, *, mean_load: FloatArray | None = None
    ) -> tuple[FloatArray, Codes]:
        """z, F_DP, M_DR (n, 3) and status (n,) of set i in row i alone, under `load` (n,).

        `mean_load` (n,) is W-bar of every row, in place of the option of M2L; other models know none.
        """
        from bayesterra.models import batch

        sets, given = batch.parameters(theta, len(self.parameters)), np.asarray(load, dtype=np.float64)
        rows = self._rows(conditions) if mean_load is None else self._rows_under(conditions, mean_load)
        values, status = batch.response(sets, rows, given[:, None], self._plan(paired=True))
        return values[:, 0], status[:, 0]

    def jacobian_at(
        self, theta: ArrayLike, conditions: Conditions, sinkage: ArrayLike, only: Sequence[int] | None = None
    ) -> FloatArray:
        """Exact d(F_N, F_DP, M_DR)/d(theta, sinkage), (n, m, 3, p + 1), sinkage last; see :class:`ForwardModel`."""
        from bayesterra.models import batch

        sets, plan = batch.parameters(theta, len(self.parameters)), self._plan(every_row=True)
        return batch.jacobian(sets, self._rows(conditions), sinkage, plan, only)

    def response_jacobian_at(self, theta: ArrayLike, conditions: Conditions, load: ArrayLike) -> FloatArray:
        """Exact d(z, F_DP, M_DR)/d theta at constant load, (n, m, 3, p)."""
        from bayesterra.models import batch

        plan = self._plan(every_row=True)
        return batch.response_jacobian(
            batch.parameters(theta, len(self.parameters)), self._rows(conditions), load, plan
        )

    def kernel_inputs(
        self, theta: ArrayLike, conditions: Conditions
    ) -> tuple[FloatArray, FloatArray, tuple[tuple[int, ...], int, bool]]:
        """See :class:`ForwardModel`: rows are (m, 6), and see `models.kernels` for what stands in them."""
        from bayesterra.models import batch

        return batch.parameters(theta, len(self.parameters)), self._rows(conditions), self._plan(every_row=True)

    @abstractmethod
    def _stresses(self, contact: Contact, angle: FloatArray) -> tuple[Floats, Floats]:
        """Both stresses on the contact arc."""

    def _results(
        self, soil: Soil, wheel: Wheel, slip: Floats, sinkage: Floats, width: int
    ) -> tuple[FloatArray, tuple[int, ...]]:
        from bayesterra.models import batch

        pairs = self._pairs(soil, wheel, slip, sinkage=sinkage)
        _check_sinkage(pairs, wheel)
        kernel = batch.forces if width == 3 else batch.components
        given = pairs.given[:, None]
        values, status = kernel(pairs.theta, self._rows(pairs.conditions), given, self._plan(paired=True))
        pairs.check(status)
        return values[:, 0], pairs.shape

    def _pairs(self, soil: Soil, wheel: Wheel, slip: Floats, **given: Floats) -> _Pairs:
        ((name, value),) = given.items()
        fields = np.moveaxis(self._theta(soil), -1, 0)
        *theta, slips, values = np.broadcast_arrays(*fields, as_floats("slip", slip), as_floats(name, value))
        require((slips >= 0) & (slips < 1), "slip", "must lie in [0, 1)", slips)
        flat = np.ascontiguousarray(np.stack([t.ravel() for t in theta], axis=-1))
        size = np.ones(slips.size)
        conditions = Conditions(
            slips.ravel(), size * wheel.radius, size * wheel.width, size * wheel.lug_height,
            np.asarray(wheel.shearing_radius(flat[:, 4])),
        )  # fmt: skip
        n = exponent(flat[:, 1], flat[:, 2], self._exponent_slip(conditions.slip))
        return _Pairs(flat, conditions, np.asarray(n), values.ravel(), slips.shape)

    def _theta(self, soil: Soil) -> FloatArray:
        """The model's parameters along a last axis; ValueError for a load effect it does not know."""
        values = soil.as_array()
        for i, name in enumerate(LOAD_EFFECT_FIELDS if isinstance(soil, LoadEffectSoil) else ()):
            effect = values[..., len(SOIL_FIELDS) + i]
            require(effect == 0, name, f"must be 0 with {self.name}, as M2L alone knows the load effect", effect)
        return values[..., : len(SOIL_FIELDS)]

    def _start_radius(self, wheel: Wheel | Conditions, slip: Floats) -> Floats:
        return shear_start_radius(
            wheel.radius, wheel.lug_height, slip,
            transition_slips=self.transition_slips, shear_start=self.shear_start,
        )  # fmt: skip

    def _rows(self, conditions: Conditions) -> FloatArray:
        """Columns of ``kernels.lanes.ROW``: slip, slip of the exponent, r, b, R_j, r_s."""
        slip = conditions.slip
        start = np.asarray(self._start_radius(conditions, slip))
        wheel = (conditions.radius, conditions.width, start, conditions.shearing_radius)
        return np.ascontiguousarray(np.stack((slip, self._exponent_slip(slip), *wheel), axis=-1))

    def _rows_under(self, conditions: Conditions, mean_load: FloatArray) -> FloatArray:
        """Rows with a mean load of their own, (n,), where the model knows one."""
        return self._rows(conditions)

    def _exponent_slip(self, slip: FloatArray) -> FloatArray:
        return np.zeros_like(slip) if self.constant_exponent else slip

    def _plan(self, *, paired: bool = False, every_row: bool = False) -> tuple[tuple[int, ...], int, bool]:
        return self._kind, int(paired), every_row


def _check_sinkage(pairs: _Pairs, wheel: Wheel) -> None:
    depth = pairs.given.reshape(pairs.shape)
    require(depth > 0, "sinkage", "must be positive", depth)
    require(depth < wheel.radius, "sinkage", f"must be below the wheel radius {wheel.radius:g} m", depth)
