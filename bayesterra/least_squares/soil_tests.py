"""Usual least-squares practice with soil tests: what a report sets beside their posterior.

``regression``: plates as by Bekker, a straight line through log p against log z for each radius, the mean
of their exponents, and k_c, k_φ from a line through the moduli against 1/b; shear as by Janosi and
Hanamoto, τ_max and K of each curve, then Mohr–Coulomb's line through τ_max and the mean K. ``nonlinear``:
one fit to all readings; plates with Wong's (1980) weights, which make residuals of the log count like those
of the pressure.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from bayesterra.arrays import FloatArray
from bayesterra.models.soil_tests import SOIL_TESTS
from bayesterra.parameters import PARAMETERS
from bayesterra.study.soil_tests import COLUMNS, Readings
from bayesterra.study.study import Study

METHODS = {"regression": "lines through each plate or curve", "nonlinear": "one fit to all readings"}


@dataclass(frozen=True)
class Fitted:
    """Least-squares estimates by method; what the tests cannot separate is missing, and ``notes`` say why."""

    values: Mapping[str, Mapping[str, float]]
    notes: tuple[str, ...]


def fit(readings: Readings) -> Fitted:
    """Estimate the soil parameters by both methods."""
    return _plate(readings) if readings.kind == "plate" else _shear(readings)


def rows_of_tests(study: Study) -> Iterator[tuple[str, str, str, float, float, float]]:
    """Rows of :func:`bayesterra.least_squares.results.report_table` of every series of soil tests."""
    reference = (study.published or study.truth) if study.soil_tests else None
    for name, test in study.soil_tests.items():
        for method, values in fit(test.readings).values.items():
            for own, value in values.items():
                quantity = PARAMETERS[test.names[own]]
                known = reference.values.get(quantity.name, np.nan) if reference else np.nan
                shown = (value / quantity.scale, known / quantity.scale, np.nan)
                yield f"{method}, {name}", quantity.name, quantity.unit, *shown


def _plate(readings: Readings) -> Fitted:
    z, p, b = np.log(readings.path), np.log(readings.stress), readings.level
    radii = np.unique(b)
    lines = [np.polyfit(z[b == radius], p[b == radius], 1) if _line(z[b == radius]) else None for radius in radii]
    slopes = [line[0] for line in lines if line is not None]
    if not slopes:
        return Fitted({}, ("least squares need two readings of a plate at least",))
    n = float(np.mean(slopes))
    moduli = np.array([np.exp(np.mean(p[b == radius] - n * z[b == radius])) for radius in radii])
    if len(radii) == 1:
        note = (
            f"plates of one radius: k_c and k_φ cannot be separated, k_c/b + k_φ ="
            f" {moduli[0] / PARAMETERS['kphi'].scale:.4g} kPa/m^n at b = {1e3 * radii[0]:g} mm"
        )
        direct = _weighted(z, p, b, np.array([0.0, moduli[0], n]))[2]
        return Fitted({"regression": {"n": n}, "nonlinear": {"n": direct}}, (note,))
    kc, kphi = np.polyfit(1.0 / radii, moduli, 1)
    start = np.array([kc, kphi, n])
    fits = (start, _weighted(z, p, b, start))
    named = (dict(zip(SOIL_TESTS["plate"].parameters, map(float, values), strict=True)) for values in fits)
    return Fitted(dict(zip(METHODS, named, strict=True)), ())


def _line(z: FloatArray) -> bool:
    return z.size > 1 and float(np.ptp(z)) > 0


def _weighted(z: FloatArray, p: FloatArray, b: FloatArray, start: FloatArray) -> FloatArray:
    """k_c, k_φ and n with residuals p (log p − log model)."""
    ends = 1.0 / np.array([b.min(), b.max()])
    weight, middle = np.exp(p - p.max()), float(z.mean())
    span = max(float(ends[0] - ends[1]), 1e-300)
    share = (ends[0] - 1.0 / b) / span if ends[0] > ends[1] else np.zeros(len(b))

    def modulus(u: FloatArray) -> FloatArray:
        first, last = np.exp(u[0]), np.exp(u[1])
        return np.asarray((1.0 - share) * first + share * last)

    def residual(u: FloatArray) -> FloatArray:
        return np.asarray(weight * (p - np.log(modulus(u)) - u[2] * (z - middle)))

    begin = np.log(np.maximum(start[0] * ends + start[1], 1e-3 * np.exp(p.min()))) + start[2] * middle
    optimum = least_squares(residual, [*begin, start[2]], x_scale="jac").x
    first, last = np.exp(optimum[:2] - optimum[2] * middle)
    kc = (first - last) / span if ends[0] > ends[1] else 0.0
    return np.array([kc, last - kc * ends[1] if ends[0] > ends[1] else first, optimum[2]])


def _shear(readings: Readings) -> Fitted:
    curves = []
    for number in range(len(readings.tests)):
        chosen = readings.test == number
        if chosen.sum() > 1:
            curves.append((readings.levels[number], *_curve(readings.path[chosen], readings.stress[chosen])))
    if not curves:
        return Fitted({}, ("least squares need two readings of a curve at least",))
    stress, strength, K = np.array(curves).T
    middle = float(K.mean())
    if len(np.unique(stress)) == 1:
        unit = COLUMNS["shear_stress"]
        note = (
            f"one normal stress: c and φ cannot be separated, c + σ tan φ ="
            f" {strength.mean() / unit.scale:.4g} kPa at σ = {stress[0] / unit.scale:g} kPa"
        )
        own = readings.level == stress[0]
        direct = _curve(readings.path[own], readings.stress[own])[1]
        return Fitted({"regression": {"K": middle}, "nonlinear": {"K": direct}}, (note,))
    slope, c = np.polyfit(stress, strength, 1)
    start = {"c": float(c), "phi": float(np.arctan(slope)), "K": middle}
    return Fitted({"regression": start, "nonlinear": _all_curves(readings, start)}, ())


def _curve(j: FloatArray, tau: FloatArray) -> tuple[float, float]:
    """τ_max and K of one curve."""
    top = float(tau.max())

    def residual(u: FloatArray) -> FloatArray:
        return np.asarray(np.exp(u[0]) * -np.expm1(-j / np.exp(u[1])) - tau / top)

    optimum = least_squares(residual, [0.0, np.log(np.median(j) / 3)]).x
    return top * float(np.exp(optimum[0])), float(np.exp(optimum[1]))


def _all_curves(readings: Readings, start: Mapping[str, float]) -> dict[str, float]:
    top = float(readings.stress.max())

    def residual(u: FloatArray) -> FloatArray:
        strength = u[0] * top + readings.level * np.tan(u[1])
        return np.asarray((strength * -np.expm1(-readings.path / np.exp(u[2])) - readings.stress) / top)

    begin = [max(start["c"], 1.0) / top, float(np.clip(start["phi"], 0.01, 1.4)), np.log(start["K"])]
    optimum = least_squares(residual, begin, bounds=([0.0, 0.0, -np.inf], [np.inf, 1.5, np.inf])).x
    return {"c": float(optimum[0] * top), "phi": float(optimum[1]), "K": float(np.exp(optimum[2]))}
