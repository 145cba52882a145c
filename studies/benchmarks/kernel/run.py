"""Time M1 four ways on the same pairs: bayesterra, C, NumPy and scipy's quad. Run: `python run.py`."""

import csv
import ctypes
import math
import platform
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import quad

from bayesterra.models import M1, Conditions, Status, Wheel, warm_up

FloatArray = NDArray[np.float64]
Kernel = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
HERE = Path(__file__).parent
FLAGS = ("-O3", "-march=native", "-ffast-math", "-shared", "-fPIC")
WIDTHS = {"256-bit": "-mprefer-vector-width=256", "512-bit": "-mprefer-vector-width=512"}
WHEELS = [
    Wheel(radius, width, height, lugs, {0.015: 0.75, 0.010: 0.65}[height])
    for radius, lugs, widths in ((0.135, 24, (0.165, 0.110)), (0.15735, 30, (0.165,)))
    for width in widths
    for height in (0.015, 0.010)
]
MODEL = M1()
OURS, OURS_LOAD = "bayesterra, sinkage given", "bayesterra, load given"
NUMPY, QUAD = "NumPy, 32 nodes", "scipy quad"
SETS, ROWS, REPEATS, QUAD_PAIRS = 2000, 12, 150, 60


@dataclass(frozen=True)
class Pairs:
    """Parameter sets (n, 9) against rows (m), a sinkage for each pair, and which pairs are in range."""

    name: str
    theta: FloatArray
    conditions: Conditions
    sinkage: FloatArray
    good: NDArray[np.bool_]

    def flat(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return theta (P, 9), rows (P, 6) and sinkage (P,) of the pairs that the model is defined for."""
        i, j = np.nonzero(self.good)
        return self.theta[i], MODEL._rows(self.conditions)[j], self.sinkage[self.good]

    def forces(self, sinkage: FloatArray | None = None) -> FloatArray:
        """Return bayesterra's forces (n, m, 3)."""
        depth = self.sinkage if sinkage is None else sinkage
        return MODEL.forces_at(self.theta, self.conditions, depth, every_row=True)[0]

    def response(self, load: FloatArray) -> FloatArray:
        """Return bayesterra's response to a load (n, m, 3)."""
        return MODEL.response_at(self.theta, self.conditions, load, every_row=True)[0]


def rule(count: int, power: int) -> tuple[FloatArray, FloatArray]:
    """Return nodes and weights on (0, 1), Gauss-Legendre in u^(1/power)."""
    nodes, weights = np.polynomial.legendre.leggauss(count)
    v = 0.5 * (nodes + 1)
    return v**power, 0.5 * weights * power * v ** (power - 1)


def posterior_cloud(rng: np.random.Generator) -> Pairs:
    """Draw sets as a posterior has them: K_s, n0, n1 along the ridge that keeps the sinkage under 80 N."""
    x = rng.normal(size=(SETS, 9))
    log_modulus = math.log(2.5e6) + 0.5 * x[:, 0]
    n0 = 0.85 + 0.12 * x[:, 0] + 0.02 * x[:, 1]
    cohesion, phi, shear = (300 * np.exp(0.6 * x[:, 3]), np.radians(30 + 2 * x[:, 4]), 0.012 * np.exp(0.2 * x[:, 5]))
    c1, c2 = 0.38 + 0.04 * x[:, 6], -0.12 + 0.06 * x[:, 7]
    columns = (np.exp(log_modulus), n0, 1.1 + 0.1 * x[:, 2], cohesion, phi, shear, c1, c2, np.zeros(SETS))
    theta = np.stack(columns, axis=-1)
    conditions = Conditions.of(WHEELS[5], np.linspace(0, 0.6, ROWS))
    response, status = MODEL.response_at(theta, conditions, 80.0)
    return Pairs("posterior cloud", theta, conditions, response[..., 0], status == Status.OK)


def prior_box(rng: np.random.Generator) -> Pairs:
    """Draw sets over the prior box, slips up to 0.9, sinkages from 0.5 to 100 mm, all six wheels."""
    low = np.array([0.1e6, 0, 0, 0, 0, 0.002, -1, -1, 0])
    high = np.array([10e6, 2, 2, 5000, math.radians(50), 0.05, 1, 1, 0])
    theta = low + rng.uniform(size=(SETS, 9)) * (high - low)
    wheels = [WHEELS[i] for i in rng.integers(0, 6, ROWS)]
    conditions = Conditions.of(wheels, rng.uniform(0, 0.9, ROWS))
    sinkage = rng.uniform(0.0005, 0.1, size=(SETS, ROWS))
    status = MODEL.forces_at(theta, conditions, sinkage, every_row=True)[1]
    return Pairs("prior box", theta, conditions, sinkage, status == Status.OK)


def evaluate_numpy(theta: FloatArray, rows: FloatArray, sinkage: FloatArray, count: int, power: int) -> FloatArray:
    """Return F_N, F_DP, M_DR and F_DPtau + F_DPsigma (P, 4), vectorised, a cache-sized block at a time."""
    u, w = rule(count, power)
    block = max(1, 4096 // count)
    parts = [slice(i, i + block) for i in range(0, len(sinkage), block)]
    return np.concatenate([_numpy_block(theta[p], rows[p], sinkage[p], u, w) for p in parts])


def _numpy_block(theta: FloatArray, rows: FloatArray, z: FloatArray, u: FloatArray, w: FloatArray) -> FloatArray:
    Ks, n0, n1, c, phi, K, c1, c2, c3 = theta.T[:, :, None]
    slip, exponent_slip, r, b, Rj, rs = rows.T[:, :, None]
    theta1, start = (2 * np.arcsin(np.sqrt(x / 2)) for x in (z[:, None] / r, (Rj - r + z[:, None]) / Rj))
    ratio = c1 + c2 * slip
    d = theta1 * (1 - ratio) * u
    sigma = w * Ks * (2 * r * np.sin(d / 2) * np.sin(theta1 - d / 2)) ** (n0 + n1 * exponent_slip)
    limit = c * w + sigma * np.tan(phi)
    sums = np.zeros((5, len(z), 1))
    for angle, width in ((theta1 - d, theta1 * (1 - ratio)), (theta1 * (c3 + (ratio - c3) * u), theta1 * (ratio - c3))):
        cosine, sine = np.cos(angle), np.sin(angle)
        j = rs * ((start - angle) - (1 - slip) * (np.sin(start) - sine))
        tau = -limit * np.expm1(-j / K)
        for i, term in enumerate((sigma * cosine, sigma * sine, tau * cosine, tau * sine, tau)):
            sums[i] += width * term.sum(axis=1, keepdims=True)
    sc, ss, tc, ts, t = sums
    forces = (b * (r * sc + rs * ts), b * (rs * tc - r * ss), rs**2 * b * t, b * (rs * np.abs(tc) + r * np.abs(ss)))
    return np.concatenate(forces, axis=1)


def evaluate_quad(theta: FloatArray, row: FloatArray, z: float) -> list[float]:
    """Return F_N, F_DP, M_DR of one pair by six adaptive quadratures of eq. (14), split at theta_m."""
    Ks, n0, n1, c, phi, K, c1, c2, c3 = theta
    slip, exponent_slip, r, b, Rj, rs = row
    theta1, start = math.acos((r - z) / r), math.acos((r - z) / Rj)
    theta2, theta_m, n = c3 * theta1, (c1 + c2 * slip) * theta1, n0 + n1 * exponent_slip

    def stresses(angle: float) -> tuple[float, float]:
        mirrored = theta1 - (angle - theta2) / (theta_m - theta2) * (theta1 - theta_m)
        rise = math.cos(angle if angle > theta_m else mirrored) - math.cos(theta1)
        sigma = Ks * (r * max(rise, 0.0)) ** n
        j = rs * ((start - angle) - (1 - slip) * (math.sin(start) - math.sin(angle)))
        return sigma, (c + sigma * math.tan(phi)) * (1 - math.exp(-j / K))

    def normal(angle: float) -> float:
        sigma, tau = stresses(angle)
        return float(r * sigma * math.cos(angle) + rs * tau * math.sin(angle))

    def pull(angle: float) -> float:
        sigma, tau = stresses(angle)
        return float(rs * tau * math.cos(angle) - r * sigma * math.sin(angle))

    ends = ((theta2, theta_m), (theta_m, theta1))
    arms = ((normal, b), (pull, b), (lambda angle: stresses(angle)[1], rs**2 * b))
    options = {"epsabs": 0, "epsrel": 1e-10, "limit": 200, "full_output": 1}
    return [arm * sum(quad(f, low, high, **options)[0] for low, high in ends) for f, arm in arms]


def evaluate_pairs(theta: FloatArray, rows: FloatArray, z: FloatArray) -> FloatArray:
    """Return the forces of several pairs (P, 3) by adaptive quadrature."""
    return np.array([evaluate_quad(theta[i], rows[i], z[i]) for i in range(len(z))])


def compile_c(folder: str, width: str) -> Kernel:
    """Compile kernel.c with the system's compiler and return it as a function."""
    library = Path(folder) / f"kernel-{width}.so"
    command = ["cc", *FLAGS, WIDTHS[width], str(HERE / "kernel.c"), "-o", str(library), "-lmvec", "-lm"]
    subprocess.run(command, check=True)
    kernel = ctypes.CDLL(str(library)).evaluate_all
    u, w = rule(32, 3)

    def evaluate(theta: FloatArray, rows: FloatArray, z: FloatArray) -> FloatArray:
        out = np.empty((len(z), 3))
        kernel(ctypes.c_long(len(z)), *(ctypes.c_void_p(a.ctypes.data) for a in (theta, rows, z, u, w, out)))
        return out

    return evaluate


def best_times(calls: dict[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Return the shortest time of each call in seconds; calls take turns, to see the same machine."""
    times = dict.fromkeys(calls, math.inf)
    for _ in range(repeats):
        for name, call in calls.items():
            begin = time.perf_counter()
            call()
            times[name] = min(times[name], time.perf_counter() - begin)
    return times


def worst_error(got: FloatArray, exact: FloatArray) -> float:
    """Return the worst relative error; F_DP is judged against F_DPtau + F_DPsigma."""
    return float(np.max(np.abs(got[:, :3] - exact[:, :3]) / np.abs(exact[:, [0, 3, 2]])))


def measure(pairs: Pairs, c_kernels: dict[str, Kernel]) -> list[dict[str, Any]]:
    """Time every method on the same pairs and return the rows of the table."""
    flat = pairs.flat()
    exact = evaluate_numpy(*flat, 200, 4)
    load = np.where(pairs.good, pairs.forces()[..., 0], 1.0)
    some = np.random.default_rng(3).choice(len(flat[2]), QUAD_PAIRS, replace=False)
    names = {f"C, 32 nodes, {width}": kernel for width, kernel in c_kernels.items()}
    calls: dict[str, Callable[[], object]] = {
        OURS: pairs.forces,
        OURS_LOAD: lambda: pairs.response(load),
        **{name: partial(kernel, *flat) for name, kernel in names.items()},
    }
    times = best_times(calls, REPEATS) | best_times({NUMPY: lambda: evaluate_numpy(*flat, 32, 3)}, REPEATS // 10)
    times = {name: seconds / len(flat[2]) for name, seconds in times.items()}
    times[QUAD] = best_times({"": lambda: evaluate_pairs(*(a[some] for a in flat))}, 5)[""] / QUAD_PAIRS
    errors = {name: worst_error(kernel(*flat), exact) for name, kernel in names.items()}
    errors[OURS] = worst_error(pairs.forces()[pairs.good], exact)
    errors[OURS_LOAD] = float(np.nanmax(np.abs(pairs.forces(pairs.response(load)[..., 0])[..., 0] / load - 1)))
    errors[NUMPY] = worst_error(evaluate_numpy(*flat, 32, 3), exact)
    errors[QUAD] = worst_error(evaluate_pairs(*(a[some] for a in flat)), exact[some])
    return table(pairs.name, times, errors)


def table(pairs: str, times: dict[str, float], errors: dict[str, float]) -> list[dict[str, Any]]:
    """Return one row per method; the ratio is to the fastest C."""
    fastest = min(seconds for name, seconds in times.items() if name.startswith("C,"))
    return [
        {
            "pairs": pairs,
            "method": name,
            "microseconds": seconds * 1e6,
            "ratio_to_C": seconds / fastest,
            "worst_error": errors[name],
        }
        for name, seconds in times.items()
    ]


def main() -> None:
    """Measure both clouds, print the table, and write results.csv."""
    warm_up()
    rng = np.random.default_rng(1)
    with tempfile.TemporaryDirectory() as folder:
        kernels = {width: compile_c(folder, width) for width in WIDTHS}
        rows = [row for pairs in (posterior_cloud(rng), prior_box(rng)) for row in measure(pairs, kernels)]
    with (HERE / "results.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, fieldnames=list(rows[0]))
        writer.writeheader()
        writer.writerows({k: f"{v:.4g}" if isinstance(v, float) else v for k, v in row.items()} for row in rows)
    print(f"{platform.machine()}, Python {platform.python_version()}, one thread\n")
    print("| pairs | method | us per pair | ratio to C | worst error |\n|---|---|---:|---:|---:|")
    for row in rows:
        print("| {pairs} | {method} | {microseconds:.3g} | {ratio_to_C:.2g} | {worst_error:.0e} |".format(**row))


if __name__ == "__main__":
    main()
