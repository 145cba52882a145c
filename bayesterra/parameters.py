"""Names, symbols and field units of everything that is estimated or measured.

Inside the package every value is SI and radians; ``scale`` is the SI value of one field unit, the unit in
which reports, tables and plots speak.
"""

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cache
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike

from bayesterra.arrays import FloatArray


@dataclass(frozen=True)
class Channel:
    """A column of a table of measurements.

    Attributes
    ----------
    name : the name in Python, in study files and in results.
    symbol : plain-text symbol, e.g. ``K_s``.
    latex : the symbol for plots, without dollar signs.
    unit : field unit, ``-`` for pure numbers.
    scale : SI value of one field unit.
    dimension : a unit of the right dimension for the unit parser ("" for pure numbers). A sinkage modulus
        K_s is given as a pressure, per m^N understood.
    description : in words.
    """

    name: str
    symbol: str
    latex: str
    unit: str
    scale: float
    dimension: str
    description: str

    @property
    def header(self) -> str:
        """Column of a table, such as ``phi [deg]``."""
        return self.name if self.unit == "-" else f"{self.name} [{self.unit}]"

    def field_text(self, value: float) -> str:
        """SI value in the field unit, to six digits."""
        return f"{value / self.scale:.6g} {self.unit.removesuffix('-')}".strip()


@dataclass(frozen=True)
class Parameter(Channel):
    """A quantity that a posterior can hold.

    Attributes
    ----------
    group : the paper's parameter group, P_I bearing, P_II shearing, P_III contact angles; ``load effect``,
        (42); else "".
    """

    group: str = ""


Q = TypeVar("Q", bound=Channel)
with Path(__file__).with_name("quantities.toml").open("rb") as _file:
    _TABLES = tomllib.load(_file)


def quantities(table: str, kind: type[Q]) -> dict[str, Q]:
    """Quantities by name from a table of ``quantities.toml``."""
    return {name: kind(name, *entries) for name, entries in _TABLES[table].items()}


CHANNELS = quantities("channels", Channel)
OUTCOMES = ("sinkage", "normal_force", "drawbar_pull", "resistance_moment")
"""Channels that can be outcomes of a drive, in the order of the results."""

SOIL_PARAMETERS, LOAD_EFFECT = tuple(_TABLES["soil"]), tuple(_TABLES["load_effect"])
HELD = {"c3": 0.0}
"""Soil parameters that stay at a value unless a study frees them."""
MODEL_PARAMETERS = [*SOIL_PARAMETERS, *LOAD_EFFECT]
"""Every parameter that some model has: those of :class:`bayesterra.models.M2L`, then those of models of one's own."""
NOISE_PREFIX, DISCREPANCY_PREFIX, RIPPLE_PREFIX = "noise_", "discrepancy_", "ripple_"
SLIP_ERROR = "slip_error"
OFFSET = "sinkage_offset"
WHEEL_SIZES = (NOISE_PREFIX, DISCREPANCY_PREFIX, RIPPLE_PREFIX, SLIP_ERROR)
"""Beginnings of the names of estimated standard deviations of readings of wheels: for ``str.startswith``."""
TEST_SIZES = ("scatter", "memory", "seating")
SIZES = (*WHEEL_SIZES, *TEST_SIZES)
"""The same of what describes the scatter of soil tests, and of both."""

_SIZES = {
    NOISE_PREFIX: ("σ", r"\sigma", "standard deviation of the {} readings"),
    DISCREPANCY_PREFIX: ("δ", r"\delta", "standard deviation of the model's error in {}"),
    RIPPLE_PREFIX: ("ρ", r"\rho", "standard deviation of the ripple of the {} readings"),
}
"""Letter, LaTeX and description of the estimated standard deviations of a channel, by how names begin."""


def _size(prefix: str, channel: Channel) -> Parameter:
    letter, latex, description = _SIZES[prefix]
    symbol, tex = f"{letter}({channel.symbol})", rf"{latex}_{{{channel.latex}}}"
    name, words = prefix + channel.name, description.format(channel.description)
    return Parameter(name, symbol, tex, channel.unit, channel.scale, channel.dimension, words)


def whole_and_part(name: str) -> tuple[str, str]:
    """A parameter of a group, a population or a soil test: its quantity, and which of its values.

    >>> whole_and_part("K[Wh11]"), whole_and_part("K.mean"), whole_and_part("K")
    (('K', '[Wh11]'), ('K', '.mean'), ('K', ''))
    """
    quantity = re.split(r"[.\[]", name, maxsplit=1)[0]
    return quantity, name.removeprefix(quantity)


class Parameters(dict[str, Parameter]):
    """Parameters by name; those of groups and soil tests, ``K[Wh11]``, ``K.ring``, follow from their quantity."""

    def __missing__(self, name: str) -> Parameter:
        return _of_part(name)


@cache
def _of_part(name: str) -> Parameter:
    base, part = whole_and_part(name)
    if not part:
        raise KeyError(name)
    whole, whose = PARAMETERS[base], {".mean": "population mean", ".spread": "spread between groups"}
    description = f"{whole.description}, {whose.get(part, part.strip('.[]'))}"
    return replace(whole, name=name, symbol=f"{whole.symbol}{part}", description=description)


_SOIL = quantities("soil", Parameter)
PARAMETERS = Parameters(
    {"Ks": _SOIL["Ks"], **quantities("moduli", Parameter), **quantities("exponent", Parameter), **_SOIL}
    | quantities("load_effect", Parameter)
    | {prefix + name: _size(prefix, CHANNELS[name]) for prefix in _SIZES for name in OUTCOMES}
    | quantities("errors", Parameter)
    | quantities("tests", Parameter)
)
"""Every parameter a posterior may hold, in the order in which posteriors hold them."""

MODULI = ("kc", "kphi")
TESTED = (*MODULI, "n", "c", "phi", "K")
"""Soil parameters that plates and shear tests read; a test may have its own, ``K.ring``."""


def of_soil_tests(name: str) -> bool:
    """True for names that only soil tests read: ``n``, and their own such as ``K.ring``."""
    base, part = whole_and_part(name)
    return name == "n" or (base in TESTED and part.startswith(".") and len(part) > 1)


def in_order(names: Iterable[str]) -> list[str]:
    """Names of parameters in the package's order; those of soil tests last, as they come."""
    given = list(names)
    return [name for name in PARAMETERS if name in given] + [name for name in given if name not in PARAMETERS]


SoilColumns = IntEnum("SoilColumns", "Ks n0 n1 c phi K c1 c2 c3 kc kphi sinkage_offset cP1 cP2 cDP cM", start=0)
"""Columns of a soil array (n, p), SI: every parameter that the [priors] table may name, by its name.

Columns that a study does not use are NaN, its ``sinkage_offset`` is 0. Where k_c and k_φ are used, K_s is
that of one wheel; see :func:`bayesterra.likelihood.forward.soil_at`.
"""
PRIOR_PARAMETERS = list(SoilColumns.__members__)
"""Parameters that the [priors] table may name, in the order of the columns of soil arrays."""


def columns_of(names: Iterable[str]) -> list[int]:
    """Columns of soil arrays in which parameters stand."""
    return [PRIOR_PARAMETERS.index(name) for name in names]


def register(parameter: Parameter) -> None:
    """Let studies know a parameter that a model of one's own brings along.

    ValueError where its name already means something else.
    """
    name = parameter.name
    if PARAMETERS.get(name, parameter) != parameter or (name in CHANNELS or name in DERIVED):
        raise ValueError(f"the parameter '{name}' of a model has the name of another quantity: call it otherwise")
    if name not in PARAMETERS:
        PARAMETERS[name] = parameter
        MODEL_PARAMETERS.append(name)
        PRIOR_PARAMETERS.append(name)


def soil_array(values: Mapping[str, ArrayLike]) -> FloatArray:
    """Soil array (n, p) of values by name, each a number or (n,); other names are left out."""
    stated = {OFFSET: 0.0, **values}
    columns = (np.atleast_1d(stated.get(name, np.nan)) for name in PRIOR_PARAMETERS)
    return np.column_stack(np.broadcast_arrays(*columns))


(EFFICIENCY,) = quantities("efficiency", Channel).values()
DERIVED = quantities("derived", Parameter)


def field_values(name: str, values: FloatArray) -> FloatArray:
    """SI values of a parameter or channel in its field unit."""
    return values / (CHANNELS[name] if name in CHANNELS else PARAMETERS[name]).scale
