"""The interface of a forward model: what a study asks of one."""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bayesterra.models.checks import BoolArray, FloatArray
from bayesterra.models.conditions import Conditions
from bayesterra.models.soil import RANGES

Codes = NDArray[np.int8]


class ForwardModel(ABC):
    """A model from (soil, wheel, slip, sinkage) to forces, and from (soil, wheel, slip, load) to sinkage.

    Parameter sets (n, p), SI and radians, have the columns of `parameters` and meet m rows. A status code stands
    in place of an error, and values are NaN where it is not OK. A set that fails in one row may be refused in
    all rows, unless `every_row`.
    """

    compiled: ClassVar[bool] = False
    """Whether compiled code knows the model, by `kernel_inputs`."""

    @property
    @abstractmethod
    def equations(self) -> str:
        """The model in words, with its equations."""

    @property
    @abstractmethod
    def source(self) -> str:
        """Publication that the equations are from."""

    @property
    @abstractmethod
    def parameters(self) -> tuple[str, ...]:
        """Columns of parameter sets (n, p)."""

    @property
    def name(self) -> str:
        """The model's name, a word."""
        return type(self).__name__

    @property
    @abstractmethod
    def options(self) -> dict[str, object]:
        """Options by name, as a study file states them."""

    @property
    def holds(self) -> dict[str, float]:
        """Parameters that the options hold at a value."""
        return {}

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """Physical ranges of parameters by name, SI, of those that have one."""
        return {name: RANGES[name] for name in self.parameters if name in RANGES}

    def admits(self, theta: FloatArray) -> BoolArray:
        """True for parameter sets (n, p) inside the physical ranges, a modulus above 0."""
        inside = np.ones(len(theta), dtype=np.bool_)
        for name, (low, high) in self.ranges.items():
            column = theta[:, self.parameters.index(name)]
            inside &= (column > low if name in ("Ks", "K") else column >= low) & (column <= high)
            if name == "phi":
                inside &= column < high
        return inside

    def bends(self, conditions: Conditions) -> FloatArray:
        """Slips (m, k) at which outcomes of rows bend sharply; NaN for none."""
        return np.full((len(conditions.slip), 1), np.nan)

    def limits(self, conditions: Conditions) -> Iterator[tuple[Mapping[str, float], float]]:
        """Weighted sums of parameters, and what each must stay above in these rows."""
        yield from ()

    @abstractmethod
    def forces_at(
        self, theta: ArrayLike, conditions: Conditions, sinkage: ArrayLike, *, every_row: bool = False
    ) -> tuple[FloatArray, Codes]:
        """F_N, F_DP, M_DR (n, m, 3) and status (n, m) at `sinkage` (m,) or (n, m)."""

    @abstractmethod
    def response_at(
        self, theta: ArrayLike, conditions: Conditions, load: ArrayLike, *, every_row: bool = False
    ) -> tuple[FloatArray, Codes]:
        """z, F_DP, M_DR (n, m, 3) and status (n, m) under `load` (m,) or (n, m)."""

    @abstractmethod
    def response_of_pairs(
        self, theta: ArrayLike, conditions: Conditions, load: ArrayLike, *, mean_load: FloatArray | None = None
    ) -> tuple[FloatArray, Codes]:
        """z, F_DP, M_DR (n, 3) and status (n,) of set i in row i alone, under `load` (n,).

        `mean_load` (n,) is W-bar of every row, in place of the option of M2L; other models know none.
        """

    @abstractmethod
    def jacobian_at(
        self, theta: ArrayLike, conditions: Conditions, sinkage: ArrayLike, only: Sequence[int] | None = None
    ) -> FloatArray:
        """d(F_N, F_DP, M_DR)/d(theta, sinkage), (n, m, 3, p + 1), sinkage last.

        With `only`, some columns (-1 is the sinkage's), those of others may be 0.
        """

    def known_under(self, load: ArrayLike, slopes: FloatArray) -> FloatArray:
        """Derivatives (n, m, 3, k) of a response under `load`, without what the solve leaves of 0."""
        return slopes

    def kernel_inputs(
        self, theta: ArrayLike, conditions: Conditions
    ) -> tuple[FloatArray, FloatArray, tuple[tuple[int, ...], int, bool]]:
        """Parameter sets, rows and the model's kind as compiled code takes them, of a `compiled` model."""
        raise NotImplementedError(f"{self.name} is not compiled")
