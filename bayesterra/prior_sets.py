"""Sets of priors by name, which study files refer to."""

import numpy as np

from bayesterra.parameters import LOAD_EFFECT
from bayesterra.priors import PAPER_BOX, Law

NO_SOURCE = "no independent source"
"""How the source of a law begins for which nothing but its limits speaks."""

_DEGREE = float(np.pi / 180)
_MOON = "Carrier, Olhoeft and Mendell 1991 (Lunar Sourcebook, ch. 9)"
_APOLLO = "Scott et al. 1970 (Apollo 12 Preliminary Science Report, NASA SP-235, 161-182)"
_ROVERS = "Sullivan et al. 2011 (J. Geophys. Res. 116, E02006)"
_VIKING = "Moore, Clow and Hutton 1982 (J. Geophys. Res. 87, 10043-10050)"
_PATHFINDER = "Moore et al. 1999 (J. Geophys. Res. 104, 8729-8746)"
_SANDS = "Wong (Theory of Ground Vehicles)"
_WHEELS = "Wong and Reece 1967 (J. Terramechanics 4(1), 81-98)"

_SOURCES = {
    "Ks": (
        f"k_phi by plates: 0.82 MPa at n = 1 on the Moon, {_MOON}; 1.53 MPa at n = 1.1 in dry sand, "
        f"5.3 MPa at n = 0.79 in LETE sand, {_SANDS}. Wide: the unit of K_s changes with N"
    ),
    "n0": (
        f"By plates: 1.0 on the Moon, {_MOON}; 1.1 in dry sand, 0.79 in LETE sand, {_SANDS}. "
        "Wide: a plate is no wheel"
    ),
    "n1": f"{NO_SOURCE}: flat on the range of the set paper-box",
    "c": (
        f"Mars: 0 to 2 kPa in wheel trenches, {_ROVERS}; 0.2 to 10 kPa in sample trenches, {_VIKING}. "
        f"Moon: 0.35 to 0.7 kPa, {_APOLLO}. Dry sand: 1.0 kPa, {_SANDS}"
    ),
    "phi": (
        f"Mars: 30 to 37 deg, {_ROVERS}; 27 to 39 deg, drift 18 deg, {_VIKING}; 34 to 39 deg, "
        f"drift 26 to 28 deg, {_PATHFINDER}. Moon: 35 to 39 deg, {_APOLLO}. Dry sand: 28 deg, {_SANDS}"
    ),
    "K": (
        f"18 mm on the Moon, {_MOON}; 10 mm in firm to 25 mm in loose sand, {_SANDS}. "
        "Wide: K grows with the contact"
    ),
    "c1": f"Stresses under rigid wheels, 0.43 in compact sand, {_WHEELS}. Wide: one soil, no lugs",
    "c2": f"Stresses under rigid wheels, 0.32 in compact sand, {_WHEELS}. Wide: one soil, no lugs",
}

PLANETARY: dict[str, Law | float] = {
    "Ks": Law("lognorm", {"s": 0.9, "scale": 2e6}, 0.05e6, 20e6, _SOURCES["Ks"]),
    "n0": Law("norm", {"loc": 1.0, "scale": 0.3}, 0.0, 2.0, _SOURCES["n0"]),
    "n1": Law("uniform", {}, 0.0, 2.0, _SOURCES["n1"]),
    "c": Law("halfnorm", {"scale": 1000.0}, 0.0, 10e3, _SOURCES["c"]),
    "phi": Law(
        "norm", {"loc": 35 * _DEGREE, "scale": 5 * _DEGREE}, 15 * _DEGREE, 50 * _DEGREE, _SOURCES["phi"]
    ),
    "K": Law("lognorm", {"s": 0.6, "scale": 0.016}, 0.001, 0.060, _SOURCES["K"]),
    "c1": Law("norm", {"loc": 0.4, "scale": 0.2}, -1.0, 1.0, _SOURCES["c1"]),
    "c2": Law("norm", {"loc": 0.3, "scale": 0.3}, -1.0, 1.0, _SOURCES["c2"]),
    "c3": 0.0,
}
"""Informative, from what was measured on the Moon, on Mars and in dry sands, stated with each law; nothing
was fitted to wheel tests of the laboratory of Ding et al. 2015. c3 is held at 0, as in ``PAPER_BOX``."""

_COEFFICIENTS = f"{NO_SOURCE}: Ding et al. 2015, Table 16, has -0.45 to 0.63 for one rover on one sand. Wide"
LOAD_EFFECT_SETS: dict[str, dict[str, Law]] = {
    "paper-box": {name: Law("uniform", {}, -1.0, 1.0, _COEFFICIENTS) for name in LOAD_EFFECT},
    "planetary": {
        name: Law("norm", {"loc": 0.0, "scale": 0.5}, -1.0, 1.0, _COEFFICIENTS) for name in LOAD_EFFECT
    },
}
"""What each set says beside that of the coefficients of the load effect, (42), for the model M2L. The paper
bounds them nowhere; beyond 1 they would turn the sign of a pull or moment within twice the mean load."""

PRIOR_SETS: dict[str, dict[str, Law | float]] = {"paper-box": PAPER_BOX, "planetary": PLANETARY}
