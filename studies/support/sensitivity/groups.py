"""The parameter groups G1 to G22 with which Ding et al. (2015, Section 4) vary one soil under one wheel."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np
from paper_wheels import WHEELS

from bayesterra.arrays import FloatArray, frozen
from bayesterra.models import SOIL_FIELDS, Soil, Wheel
from bayesterra.parameters import PARAMETERS


@dataclass(frozen=True)
class Setting:
    """What the wheel does while the soil varies: load-driven at given slips.

    Attributes
    ----------
    wheel : the wheel.
    load : W, N.
    slips : slip ratios (m,) on the shearing radius.
    """

    wheel: Wheel
    load: float
    slips: FloatArray


SECTION_4 = Setting(WHEELS["Wh31"], 80.0, frozen([0.0, 0.1, 0.2, 0.3, 0.4, 0.6]))
"""Wh31 under about 80 N at the slips of Section 3.1. The print does not say whether Section 4 converts its
slips from the radius r to r_s; used as they stand they reproduce its tables."""


@dataclass(frozen=True)
class Group:
    """A soil of the paper's sensitivity analysis.

    Attributes
    ----------
    name : the paper's name, e.g. ``G7``.
    values : the soil parameters in field units (kPa/m^N, kPa, degrees, mm), in the order of ``Soil``.
    varied : parameters that differ from G1.
    table : number of the table that prints it.
    printed_errors : eq. (16) against the unpublished measurements, for z, F_DP and M_DR, as fractions.
    """

    name: str
    values: tuple[float, ...]
    varied: tuple[str, ...]
    table: int
    printed_errors: tuple[float, float, float]

    @property
    def soil(self) -> Soil:
        """The soil in SI units."""
        scales = [PARAMETERS[name].scale for name in SOIL_FIELDS]
        return Soil(*(value * scale for value, scale in zip(self.values, scales, strict=True)))


_G1 = {"Ks": 2500, "n0": 0.76, "n1": 1.30, "c": 0.25, "phi": 31.9, "K": 12, "c1": 0.5, "c2": -0.3, "c3": 0}
"""Table 5, which prints K = 25 mm; 12 mm stands in Table 7 and reproduces Table 4 (15.0 %; 25 mm: 12.1 %)."""


def _group(name: str, table: int, printed: tuple[float, float, float], **changed: float) -> Group:
    values = tuple(float({**_G1, **changed}[field]) for field in SOIL_FIELDS)
    errors = (printed[0] / 100, printed[1] / 100, printed[2] / 100)
    return Group(name, values, tuple(changed), table, errors)


_ALL = (
    _group("G1", 5, (0.93, 8.20, 4.55)),
    _group("G2", 6, (27.79, 10.56, 6.11), n0=0.60),
    _group("G3", 6, (29.33, 12.34, 9.19), n0=0.90),
    _group("G4", 6, (21.09, 7.83, 4.55), n1=1.10),
    _group("G5", 6, (25.05, 8.57, 4.55), n1=1.50),
    _group("G6", 6, (28.09, 8.91, 5.56), Ks=5000),
    _group("G7", 6, (74.38, 19.99, 11.89), Ks=800),
    _group("G8", 6, (1.67, 8.59, 4.90), Ks=5000, n0=0.88, n1=1.39),
    _group("G9", 6, (1.53, 8.78, 4.96), Ks=800, n0=0.60, n1=1.08),
    _group("G10", 7, (1.33, 15.02, 8.02), c=0.0),
    _group("G11", 7, (4.22, 97.11, 53.53), c=2.5),
    _group("G12", 7, (2.43, 60.70, 33.03), phi=42.0),
    _group("G13", 7, (2.53, 40.76, 21.94), phi=25.0),
    _group("G14", 7, (1.85, 36.85, 20.49), K=20.0),
    _group("G15", 7, (1.20, 49.96, 29.54), K=5.0),
    _group("G16", 7, (0.95, 10.40, 4.40), c=1.0, phi=25.0, K=10.0),
    _group("G17", 8, (10.34, 16.62, 3.88), c1=0.4),
    _group("G18", 8, (9.58, 14.87, 5.11), c1=0.6),
    _group("G19", 8, (19.28, 23.92, 4.55), c2=0.0),
    _group("G20", 8, (58.30, 55.28, 4.55), c2=0.3),
    _group("G21", 8, (11.70, 24.35, 5.28), c3=0.2),
    _group("G22", 8, (7.22, 19.06, 4.05), c3=-0.2),
)
GROUPS: Mapping[str, Group] = MappingProxyType({group.name: group for group in _ALL})
"""Every group by name: Tables 5 (G1), 6 (bearing), 7 (shearing) and 8 (contact angles)."""

REFERENCE = GROUPS["G1"]
"""The group that all others are compared with."""


def soil_array(groups: Iterable[Group]) -> FloatArray:
    """Soil array (n, 9), SI, of some groups."""
    return np.array([group.soil.as_array() for group in groups])
