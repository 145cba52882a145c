"""Names, symbols and field units of what soil tests estimate and measure."""

from __future__ import annotations

from dataclasses import replace

from bayesterra.parameters import OFFSET, PARAMETERS, Channel, Parameter

PLATE = ("kc", "kphi", "n")
SHEAR = ("c", "phi", "K")
KINDS = {"plate": PLATE, "shear": SHEAR}
"""Soil parameters by kind of test."""
NOISE = {"plate": ("scatter", "memory", "seating", "sinkage_offset"), "shear": ("scatter", "memory")}
"""What describes how tests differ from the mean curve, by kind of test."""

_ALL = (
    replace(PARAMETERS["kc"], unit="kPa m/m^n", description="cohesive modulus"),
    replace(PARAMETERS["kphi"], unit="kPa/m^n", description="frictional modulus"),
    Parameter("n", "n", r"n", "-", 1.0, "", "sinkage exponent"),
    *(PARAMETERS[name] for name in SHEAR),
    Parameter("scatter", "σ_t", r"\sigma_t", "-", 1.0, "", "scatter of log stress from test to test"),
    Parameter("memory", "ℓ", r"\ell", "-", 1.0, "", "log distance over which it lasts"),
    Parameter("seating", "σ_0", r"\sigma_0", "mm", 1e-3, "m", "scatter of the zero of sinkage"),
    replace(PARAMETERS[OFFSET], description="zero error of sinkage common to all tests"),
)
QUANTITIES: dict[str, Parameter] = {parameter.name: parameter for parameter in _ALL}
"""Everything that a soil test may estimate, in the order of its posteriors."""

COLUMNS: dict[str, Channel] = {
    channel.name: channel
    for channel in (
        Channel("plate_diameter", "2b", r"2b", "mm", 1e-3, "m", "plate diameter"),
        Channel("sinkage", "z", r"z", "mm", 1e-3, "m", "sinkage"),
        Channel("force", "F", r"F", "N", 1.0, "N", "force on the plate"),
        Channel("pressure", "p", r"p", "kPa", 1e3, "Pa", "pressure under the plate"),
        Channel("normal_stress", "σ", r"\sigma", "kPa", 1e3, "Pa", "normal stress"),
        Channel("displacement", "j", r"j", "mm", 1e-3, "m", "shear displacement"),
        Channel("shear_stress", "τ", r"\tau", "kPa", 1e3, "Pa", "shear stress"),
    )
}
"""Columns that a table of readings may have, beside ``test`` and ``use``."""
