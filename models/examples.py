"""Two models beside those of Ding et al. 2015, written as anybody writes one: laws of forces for `OwnModel`."""

from __future__ import annotations

from typing import Any

import numpy as np

from bayesterra.models.checks import FloatArray
from bayesterra.models.conditions import Conditions
from bayesterra.models.own import ModelParameter

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)


class WongReece:
    """Stresses of Reece 1965 with the contact angles of Wong and Reece 1967, as rover builders use them.

    Normal stress: r^N K_s (cos θ − cos θ_f)^N in front of θ_m = (c1 + c2 s) θ_f, and its mirror image, stretched,
    behind; shear stress by Janosi and Hanamoto 1961. The wheel leaves the soil at θ_r = −arccos(1 − κ z/r). Lugs
    are not part of it: r is the rim's.
    """

    equations = "stresses of Reece with the contact angles of Wong and Reece, integrated along the arc"
    source = "Ishigami, Miwa, Nagatani and Yoshida 2007 (J. Field Robotics 24, 233-250)"
    parameters = (
        "Ks", "n0", "c", "phi", "K", "c1", "c2",
        ModelParameter("kappa", "", 0.0, 1.0, "κ", "rise of the soil behind the wheel, of the sinkage"),
    )  # fmt: skip

    def forces(self, soil: Any, wheel: Conditions, slip: FloatArray, sinkage: FloatArray) -> tuple[FloatArray, ...]:
        """F_N, F_DP and M_DR: 10 Gauss points in front of θ_m and 10 behind, closer where stresses end."""
        r, b = wheel.radius, wheel.width
        front = np.arccos(1 - sinkage / r)
        rear = -np.arccos(np.maximum(1 - soil.kappa * sinkage / r, -1.0))
        middle = (soil.c1 + soil.c2 * slip) * front
        valid = (middle < front) & (middle > rear)
        total = [np.zeros(np.shape(sinkage)) for _ in range(3)]
        for ahead in (True, False):
            end = front if ahead else rear
            for x, weight in zip(0.5 * (1 + _NODES), 0.5 * _WEIGHTS, strict=True):
                share = 1 - x**2  # nodes crowd at the end of the arc
                angle = middle + share * (end - middle)
                size = weight * 2 * x * np.abs(end - middle)
                mirrored = angle if ahead else front - (angle - rear) / (middle - rear) * (front - middle)
                normal = r**soil.n0 * soil.Ks * np.maximum(np.cos(mirrored) - np.cos(front), 0.0) ** soil.n0
                travel = r * (front - angle - (1 - slip) * (np.sin(front) - np.sin(angle)))
                shear = (soil.c + normal * np.tan(soil.phi)) * -np.expm1(-travel / soil.K)
                total[0] += size * r * b * (normal * np.cos(angle) + shear * np.sin(angle))
                total[1] += size * r * b * (shear * np.cos(angle) - normal * np.sin(angle))
                total[2] += size * r**2 * b * shear
        return tuple(np.where(valid, force, np.nan) for force in total)


class BekkerJanosi:
    """Bekker's rigid wheel with the thrust of Janosi and Hanamoto, in closed form.

    F_N = (3 − N)/3 · b K_s √(2r) z^(N + 1/2); resistance of compaction b K_s z^(N + 1)/(N + 1); thrust of a track as
    long as the contact, l = r arccos(1 − z/r): (b l c + F_N tan φ) (1 − K/(s l) (1 − e^(−s l/K))), which turns the
    wheel at its rim. For N < 3; lugs are not part of it.
    """

    equations = (
        "Bekker's sinkage and compaction resistance, thrust of Janosi and Hanamoto over the length of the contact"
    )
    source = "Bekker 1969 (Introduction to Terrain-Vehicle Systems); Wong (Theory of Ground Vehicles, ch. 2)"
    parameters = ("Ks", "n0", "c", "phi", "K")

    def forces(self, soil: Any, wheel: Conditions, slip: FloatArray, sinkage: FloatArray) -> tuple[FloatArray, ...]:
        """F_N, F_DP and M_DR."""
        r, b, n = wheel.radius, wheel.width, soil.n0
        normal = np.where(n < 3, (3 - n) / 3 * b * soil.Ks * np.sqrt(2 * r) * sinkage ** (n + 0.5), np.nan)
        resistance = b * soil.Ks * sinkage ** (n + 1) / (n + 1)
        length = r * np.arccos(1 - sinkage / r)
        path = np.maximum(slip * length / soil.K, 1e-12)
        thrust = (b * length * soil.c + normal * np.tan(soil.phi)) * (1 + np.expm1(-path) / path)
        return normal, thrust - resistance, thrust * r
