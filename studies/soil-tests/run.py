"""Conventional soil tests: what plates and shear tests tell, and how far their intervals can be relied on.

Usage: python run.py [PART ...] (default: all). Parts: files (the three test files, here as short tables),
recovery (plates of two radii or one, known soils), wheels (wheels of two widths or one), naive (independent
readings), table2 (the paper's own plate test), insertion (a wheel pushed into the sand of the plates),
statements (what the paper says, judged by the others' tables). Each writes its CSV beside this file.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.random import SeedSequence, default_rng
from scipy.integrate import quad_vec
from scipy.optimize import least_squares
from scipy.special import ndtr
from scipy.stats import binomtest, kstest

import bayesterra as bt
from bayesterra.analysis import soil_tests_page as page
from bayesterra.identifiability import structure
from bayesterra.identifiability.verdicts import identifiability
from bayesterra.likelihood.experiments import Experiment, Spread, covariance
from bayesterra.likelihood.posterior import draw_cut_prior
from bayesterra.models import M2
from bayesterra.report.figures import white_png
from bayesterra.sampling.adaptation import OF_SOIL_TESTS
from bayesterra.sampling.sampler import sample, thin
from bayesterra.stats.laws import Law
from bayesterra.study.observations import read_table
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.soil_tests import Readings
from bayesterra.study.study import load_soil_test, soil_test_study

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "support"))

from paper_wheels import ABOUT_WH32  # noqa: E402

SEEDS = 20
FILES = ("grc1", "cmu", "cullinan")

TABLE2 = {"kc": 15.6e3, "kphi": 2407.4e3, "n": 1.10}
"""HIT-LSS1, Table 2 of Ding et al. 2015; SI."""
SCATTER = {"scatter": 0.15, "memory": 5.0, "seating": 0.2e-3, "sinkage_offset": 0.0}
"""How simulated tests differ: assumed, between what the GRC-1 and the CMU tests show (medians 0.28 and
0.14; 7 and 5; 0.08 and 0.75 mm)."""
RADII = (0.035, 0.050)
LOADS = (20.0, 300.0)
"""Plates (m) and loads (N) of Section 3.2; the number of tests and readings is not published: assumed."""
TESTS, READINGS = 3, 20
BOX = {
    "reference_sinkage": 0.010,
    "kc": Law("uniform", lower=-3e3, upper=3e3),
    "kphi": Law("uniform", lower=-120e3, upper=120e3),
    "n": Law("uniform", lower=0.3, upper=2.0),
}
SHORT = SamplingOptions(target_ess=1000)


def readings_of(study: bt.Study) -> Readings:
    """Readings of the one series of tests of a study."""
    (test,) = study.soil_tests.values()
    return test.readings


def simulated(radii: tuple[float, ...], seed: int, truth: Mapping[str, float] = TABLE2) -> bt.Study:
    """Plate tests on a known soil, with the scatter stated above."""
    rows = []
    for radius in radii:
        ends = np.array(LOADS) / (np.pi * radius**2) / (truth["kc"] / radius + truth["kphi"])
        z = np.geomspace(*ends ** (1.0 / truth["n"]), READINGS)
        rows += [(f"{1e3 * radius:g} mm, {i + 1}", 2 * radius, depth) for i in range(TESTS) for depth in z]
    table = pd.DataFrame(rows, columns=["test", "plate_diameter [m]", "sinkage [m]"])
    tables = {"test": "plate", "data": {"kind": "simulated"}, "priors": BOX}
    blank = soil_test_study(tables, table=table.assign(**{"pressure [Pa]": 1.0}))
    made, known = bt.posterior(blank), {**truth, **{f"{name}.plate": value for name, value in SCATTER.items()}}
    x = np.array([[known[name] for name in made.names]])
    stress = made.experiments[0].draw(x, default_rng(SeedSequence((seed, len(radii)))))[0]
    return blank.with_stresses({"plate": stress})


def verdicts_of(test: bt.Study, seed: int) -> tuple[pd.DataFrame, np.ndarray, bool]:
    """Verdicts on the parameters of a soil test, kept draws, and whether the sampling converged."""
    posterior = bt.posterior(test)
    samples = sample(posterior, SHORT, SeedSequence(seed), adaptation=OF_SOIL_TESTS)
    prior, draws = draw_cut_prior(posterior, 4000, default_rng(seed)).x, thin(samples.chains).flat
    seen = structure.structure(posterior, prior[: structure.DRAWS]).determined
    laws = posterior.prior
    ranges, seen = [law.range for law in laws.laws.values()], np.isin(posterior.names, seen)
    found = identifiability(posterior.names, ranges, laws.stated(prior), laws.stated(draws), seen)
    return found.table, draws, samples.diagnosis.converged


def recovery_of(radii: tuple[float, ...], seed: int) -> list[dict[str, Any]]:
    """One simulated set of plate tests: truth beside posterior, for the soil and for k_c/b + k_φ at 35 mm."""
    found, draws, converged = verdicts_of(simulated(radii, seed), seed)
    values = {name: draws[:, i] for i, name in enumerate(TABLE2)}
    values["Ks"] = values["kc"] / RADII[0] + values["kphi"]
    truth = {**TABLE2, "Ks": TABLE2["kc"] / RADII[0] + TABLE2["kphi"]}
    words = found.set_index("parameter")["verdict"].to_dict()
    shares = found.set_index("parameter")["contraction"].to_dict()
    rows = []
    for name, x in values.items():
        low, median, high = np.quantile(x, [0.05, 0.5, 0.95])
        figures = {
            "truth": truth[name],
            "median": median,
            "q05": low,
            "q95": high,
            "covered": low <= truth[name] <= high,
        }
        head = {"radii": len(radii), "seed": seed, "parameter": name, "verdict": words.get(name, "")}
        rows.append({**head, "contraction": shares.get(name, np.nan), **figures, "converged": converged})
    return rows


def recovery() -> None:
    """Twenty known soils' plate tests, with two radii and with one."""
    rows = [row for radii in (RADII, RADII[:1]) for seed in range(1, SEEDS + 1) for row in recovery_of(radii, seed)]
    save(pd.DataFrame(rows), "recovery")


WIDTHS = {"two": (0.165, 0.080), "one": (0.165,)}
WHEEL_SOIL = {**ABOUT_WH32, "Ks": 1.0, "c3": 0.0}
MODULI = {"kc": 1e5, "kphi": 0.6e6}
"""About Table 10 of the paper, wheel Wh32, with a K_s that hangs on the width; as in
``studies/identifiability/verdicts``."""
WHEEL_NOISE = {"sinkage": 0.5e-3, "drawbar_pull": 0.5, "resistance_moment": 0.1}
WHEEL_PRIORS = {
    "kc": Law("uniform", lower=0.0, upper=2e5),
    "kphi": Law("uniform", lower=0.0, upper=1.2e6),
    "n1": Law("uniform", lower=0.0, upper=2.0),
    "phi": Law("uniform", lower=0.0, upper=float(np.radians(50.0))),
    "K": Law("uniform", lower=0.002, upper=0.050),
}
WHEEL_SEEDS = 2


def wheel_study(widths: tuple[float, ...], seed: int) -> bt.Study:
    """Wheels of some widths through M2 on one soil, simulated."""
    wheels = {f"{1e3 * width:g} mm": bt.Wheel(0.15735, width, 0.010, 30, 0.65) for width in widths}
    rng, parts = default_rng(SeedSequence((seed, len(widths)))), []
    slip = np.array([0.05, 0.1, 0.2, 0.3, 0.4])
    for name, wheel in wheels.items():
        load = 80.0 * wheel.width / 0.165
        soil = bt.Soil(**{**WHEEL_SOIL, "Ks": MODULI["kc"] / wheel.width + MODULI["kphi"]})
        z = M2().sinkage(soil, wheel, slip, load)
        forces = M2().forces(soil, wheel, slip, z)
        exact = {"sinkage": z, "drawbar_pull": forces.drawbar_pull, "resistance_moment": forces.resistance_moment}
        units = {"sinkage": "m", "drawbar_pull": "N", "resistance_moment": "N m"}
        noisy = {f"{k} [{units[k]}]": v + WHEEL_NOISE[k] * rng.standard_normal(len(slip)) for k, v in exact.items()}
        parts.append(pd.DataFrame({"wheel": name, "slip": slip, "load [N]": load, **noisy}))
    fixed = {name: WHEEL_SOIL[name] for name in ("n0", "c", "c1", "c2", "c3")}
    return bt.Study(
        data=pd.concat(parts, ignore_index=True), wheels=wheels, model="M2", slip_reference="shearing",
        noise=WHEEL_NOISE, priors={**WHEEL_PRIORS, **fixed}, sampling=SHORT,
    )  # fmt: skip


def wheels_of(which: str, seed: int) -> list[dict[str, Any]]:
    """One simulated wheel study: the verdicts on k_c and k_φ, and the truth beside the posterior."""
    posterior = bt.posterior(wheel_study(WIDTHS[which], seed))
    prior = draw_cut_prior(posterior, 4000, default_rng(seed)).x
    samples = sample(posterior, SHORT, SeedSequence(seed))
    draws = thin(samples.chains).flat
    seen = structure.structure(posterior, prior[: structure.DRAWS])
    ranges = [law.range for law in posterior.prior.laws.values()]
    found = identifiability(posterior.names, ranges, prior, draws, np.isin(posterior.names, seen.determined)).table
    rows = []
    for name, truth in MODULI.items():
        low, median, high = np.quantile(draws[:, posterior.names.index(name)], [0.05, 0.5, 0.95])
        row = found.set_index("parameter").loc[name]
        rows.append(
            {
                "widths": which, "seed": seed, "parameter": name, "verdict": row["verdict"],
                "contraction": row["contraction"], "truth": truth, "median": median, "q05": low, "q95": high,
                "covered": low <= truth <= high, "converged": samples.diagnosis.converged,
                "unseen": "; ".join(null.words for null in seen.nulls),
            }
        )  # fmt: skip
    return rows


def wheels() -> None:
    """Wheels of two widths and of one."""
    rows = [row for which in WIDTHS for seed in range(1, WHEEL_SEEDS + 1) for row in wheels_of(which, seed)]
    save(pd.DataFrame(rows), "wheels")


def results() -> dict[str, bt.Result]:
    """The three test files, analysed."""
    return {name: bt.soil_test(HERE / f"{name}.toml", seed=1) for name in FILES}


def files() -> None:
    """Posterior, least squares and predictions of the three test files, in short."""
    found = results()
    keys = ["parameter", "unit", "median", "hdi90_lo", "hdi90_hi", "prior_sd"]
    summary = pd.concat([one.summary[keys].assign(file=name) for name, one in found.items()])
    words = pd.concat(
        [one.identifiability[["parameter", "verdict", "contraction"]].assign(file=name) for name, one in found.items()]
    )
    save(summary.merge(words, how="left", on=["file", "parameter"]), "posteriors")
    save(pd.concat([one.least_squares.assign(file=name) for name, one in found.items()]), "least_squares")
    save(pd.concat([one.new_tests.assign(file=name) for name, one in found.items()]), "left_out")
    checks = [(n, check, p) for n, one in found.items() for check, p in one.record["soil_tests"]["checks"].items()]
    save(pd.DataFrame(checks, columns=["file", "check", "p"]), "checks")
    for name, one in found.items():
        (HERE / f"{name}.png").write_bytes(white_png(page.readings(one, next(iter(one.study.soil_tests))), 110))


def naive() -> None:
    """Usual practice, whose readings are independent, beside ``left_out.csv``: every test from the others."""
    stored, rows = pd.read_csv(HERE / "left_out.csv"), []
    for name in ("grc1", "cmu"):
        readings = readings_of(load_soil_test(HERE / f"{name}.toml"))
        rows += scored(name, "stated", stored[stored["file"] == name])
        rows += scored(name, "independent", pd.DataFrame(usual_predictions(readings)))
    save(pd.DataFrame(rows), "naive")


def usual_predictions(readings: Readings) -> list[dict[str, float]]:
    """Where every test lies when least squares of all other tests predict it with their own standard errors.

    log p = log(k_c/b + k_φ) + n log z with independent residuals of one standard deviation.
    """
    rows = []
    for number in range(len(readings.tests)):
        own = readings.only(np.arange(len(readings.tests)) == number)
        fitted, law, sd = usual_fit(readings.only(np.arange(len(readings.tests)) != number))
        residual = np.log(own.stress) - usual_curve(fitted, own)
        slopes = np.array([usual_curve(fitted + step, own) - usual_curve(fitted - step, own) for step in STEPS]).T
        slopes /= 2 * STEPS[0, 0]
        covariance = slopes @ law @ slopes.T + sd**2 * np.eye(len(own))
        half = len(own) // 2
        weights = {
            "level_pit": np.full(len(own), 1 / len(own)),
            "slope_pit": np.where(np.arange(len(own)) < half, -1 / half, 1 / (len(own) - half)),
        }
        rows.append({kind: float(ndtr(residual @ w / np.sqrt(w @ covariance @ w))) for kind, w in weights.items()})
    return rows


STEPS = 1e-5 * np.eye(3)


def usual_curve(u: np.ndarray, readings: Readings) -> np.ndarray:
    """Log pressures (m,) for logs of pressure at 5 mm under plates of 30 and 100 mm radius, and n."""
    ends = 1.0 / np.array([0.03, 0.10])
    share = (ends[0] - 1.0 / readings.level) / (ends[0] - ends[1])
    modulus = (1.0 - share) * np.exp(u[0]) + share * np.exp(u[1])
    return np.asarray(np.log(modulus) + u[2] * np.log(readings.path / 5e-3))


def usual_fit(readings: Readings) -> tuple[np.ndarray, np.ndarray, float]:
    """Estimate (3,), its covariance (3, 3) and the standard deviation of residuals, by least squares."""
    logs = np.log(readings.stress)
    found = least_squares(lambda u: usual_curve(u, readings) - logs, [logs.mean(), logs.mean(), 1.2])
    sd = float(np.sqrt((found.fun**2).sum() / (len(logs) - 3)))
    return found.x, sd**2 * np.linalg.inv(found.jac.T @ found.jac), sd


def scored(name: str, label: str, table: pd.DataFrame) -> list[dict[str, Any]]:
    """How many tests lie inside their 50 and 90 % intervals, and whether they are evenly spread."""
    rows = []
    for kind in ("level", "slope"):
        pit = table[f"{kind}_pit"].to_numpy()
        inside = {f"inside_{level}": int((np.abs(pit - 0.5) <= level / 200).sum()) for level in (50, 90)}
        chance = binomtest(inside["inside_90"], len(pit), 0.9, alternative="less").pvalue
        figures = {"chance_of_so_few": chance, "uniform_p": kstest(pit, "uniform").pvalue}
        rows.append({"file": name, "likelihood": label, "of": kind, "tests": len(pit), **inside, **figures})
    return rows


def table2() -> None:
    """What the paper's plate test would leave, as it is stated: simulated from Table 2, one set of tests."""
    found = bt.run(simulated(RADII, 1), seed=1)
    keys = ["parameter", "unit", "median", "sd", "hdi90_lo", "hdi90_hi"]
    truth = pd.DataFrame({"parameter": list(TABLE2), "truth": [TABLE2["kc"] / 1e3, TABLE2["kphi"] / 1e3, TABLE2["n"]]})
    words = found.identifiability[["parameter", "verdict", "contraction"]]
    save(found.summary[keys].merge(truth, how="left").merge(words, how="left"), "table2")
    save(found.least_squares, "table2_least_squares")
    draws = found.values()[:, :3]
    save(
        pd.DataFrame(np.corrcoef(draws.T), columns=list(TABLE2), index=list(TABLE2)).reset_index(names="parameter"),
        "table2_correlations",
    )


GEOMETRIES = {"50 mm wide": (0.050, 0.058), "60 mm wide": (0.060, 0.0575)}
"""Width and rim radius of the grouser wheel, m, as two sources of the laboratory give them."""
GROUSER = 0.005
SHALLOWEST, DEEPEST = 0.003, 0.030
"""Sinkages compared, m: deeper the pressures leave the range of the plate tests, shallower the zero rules."""


def wheel_force(soil: np.ndarray, z: np.ndarray, width: float, radius: float, breadth: float) -> np.ndarray:
    """Force (n, m) on a wheel pushed straight down without turning, N.

    Bekker's pressure, at every point of the immersed arc that of a plate at its depth, radial and without
    shear: F = b R ∫ p cos θ dθ. ``soil`` (n, 3) holds k_c, k_φ, n; ``z`` (n, m) the depth of the lowest
    point; ``breadth`` stands for the plate radius in k_c/b + k_φ. Zero above the soil.
    """
    modulus = soil[:, :1] / breadth + soil[:, 1:2]
    depth = np.clip(z, 0.0, 0.999 * radius)
    end = np.arccos(1.0 - depth / radius)

    def integrand(u: float) -> np.ndarray:
        theta = u * end
        sunk = np.maximum(radius * (np.cos(theta) - np.cos(end)), 0.0)
        return np.asarray(end * sunk ** soil[:, 2:] * np.cos(theta))

    inside = 2.0 * quad_vec(integrand, 0.0, 1.0, epsrel=1e-6, norm="max")[0]
    return np.where(modulus > 0, modulus, np.nan) * width * radius * inside


def insertion_tests() -> list[tuple[str, np.ndarray, np.ndarray]]:
    """Name, sinkage (m) and force (N) of every insertion, thinned like the plate tests."""
    table = read_table(HERE / "cmu_insertion.csv")
    tests = []
    for name, rows in table.groupby("test", sort=False):
        z, force = (rows[column].astype(float).to_numpy() for column in ("sinkage [mm]", "force [N]"))
        order = np.argsort(z, kind="stable")
        z, force = 1e-3 * z[order], force[order]
        kept, last = [], -np.inf
        for i, depth in enumerate(z):
            if SHALLOWEST <= depth <= DEEPEST and force[i] > 0 and np.log(depth) - last >= 0.05:
                kept.append(i)
                last = np.log(depth)
        tests.append((str(name), z[kept], force[kept]))
    return tests


def insertion_of(
    draws: np.ndarray, posterior: Experiment, variant: tuple[str, str, str]
) -> tuple[pd.DataFrame, Callable[[np.ndarray], np.ndarray]]:
    """Every insertion beside its prediction from the plates, for one reading of the wheel.

    ``variant``: geometry; breadth ``width`` (the paper's b) or ``half width`` (like the radius of a plate);
    contact along the ``tips`` or the ``rim`` (then counted from the tips, which sink freely).
    """
    geometry, breadth, contact = variant
    width, rim = GEOMETRIES[geometry]
    radius, lead = (rim + GROUSER, 0.0) if contact == "tips" else (rim, GROUSER)
    effective = width if breadth == "width" else 0.5 * width
    soil, spread = posterior.soil(draws), posterior.spread(draws)

    def force(z: np.ndarray) -> np.ndarray:
        return wheel_force(soil, spread.true_path(z) - lead, width, radius, effective)

    rows = []
    for name, depths, forces in insertion_tests():
        below = depths > lead + SHALLOWEST
        z, measured = depths[below], forces[below]
        mean = np.log(force(z))
        step = 1e-5
        slope = (np.log(force(z + step)) - mean) / step  # the seating shifts log F by its slope times ζ
        seat = spread.shift[:, None] / np.abs(soil[:, 2:]) * slope if spread.shift is not None else np.zeros_like(mean)
        law = covariance(z, Spread(spread.scatter, spread.memory, None)) + seat[:, :, None] * seat[:, None, :]
        residual = np.log(measured) - mean
        known = np.isfinite(residual).all(axis=1)
        residual, law = residual[known], law[known]
        half = len(z) // 2
        weights = {
            "level": np.full(len(z), 1 / len(z)),
            "slope": np.where(np.arange(len(z)) < half, -1 / half, 1 / (len(z) - half)),
        }
        pit = {
            f"{kind}_pit": float(ndtr(residual @ w / np.sqrt(np.einsum("i,nij,j->n", w, law, w))).mean())
            for kind, w in weights.items()
        }
        inside = ndtr(residual / np.sqrt(np.einsum("nii->ni", law))).mean(axis=0)
        covered = {f"covered_{level}": float((np.abs(inside - 0.5) <= level / 200).mean()) for level in (50, 90)}
        ratio = float(np.exp(np.median(residual.mean(axis=1))))
        head = {"geometry": geometry, "breadth": breadth, "contact": contact, "test": name, "readings": len(z)}
        rows.append({**head, "measured_over_predicted": ratio, **pit, **covered, "unphysical": 1 - known.mean()})
    return pd.DataFrame(rows), force


def insertion() -> None:
    """The held-out check: plates predict the wheel pushed straight down."""
    found = bt.soil_test(HERE / "cmu.toml", seed=1)
    draws = found.values()
    draws, posterior = draws[:: max(1, len(draws) // 1000)], bt.posterior(found.study).experiments[0]
    parts, curves = [], {}
    for geometry in GEOMETRIES:
        for breadth in ("width", "half width"):
            for contact in ("tips", "rim"):
                table, force = insertion_of(draws, posterior, (geometry, breadth, contact))
                parts.append(table)
                curves[geometry, breadth, contact] = force
    save(pd.concat(parts), "insertion")
    save(insertion_summary(pd.concat(parts)), "insertion_summary")
    draw_insertion(curves, posterior, draws)


def insertion_summary(table: pd.DataFrame) -> pd.DataFrame:
    """One row per reading of the wheel: ratio, coverage, and how many tests lie in the 90 % interval."""
    rows = []
    for key, part in table.groupby(["geometry", "breadth", "contact"], sort=False):
        inside = {
            f"{kind}s_inside_90": ((part[f"{kind}_pit"] > 0.05) & (part[f"{kind}_pit"] < 0.95)).sum()
            for kind in ("level", "slope")
        }
        medians = {"measured_over_predicted": part["measured_over_predicted"].median()}
        covered = {name: part[name].mean() for name in ("covered_50", "covered_90")}
        uniform = kstest(part["level_pit"], "uniform").pvalue
        head = dict(zip(("geometry", "breadth", "contact"), key, strict=True))
        rows.append({**head, **medians, **covered, **inside, "tests": len(part), "uniform_p": uniform})
    return pd.DataFrame(rows)


def draw_insertion(
    curves: Mapping[tuple[str, str, str], Callable[[np.ndarray], np.ndarray]], posterior: Experiment, x: np.ndarray
) -> None:
    """Bands of new insertions where b lies between the plates' radii, and all measured insertions."""
    chosen = [key for key in curves if key[:2] in (("50 mm wide", "width"), ("60 mm wide", "half width"))]
    spread, n, rng = posterior.spread(x), np.abs(posterior.soil(x)[:, 2:]), default_rng(1)
    scatter, shift = (rng.standard_normal((len(x), 1)) for _ in range(2))
    with mpl.rc_context({"font.size": 9}):
        figure = Figure(figsize=(11, 3.1), layout="constrained")
        axes = figure.subplots(1, len(chosen), sharey=True)
        for ax, key in zip(axes, chosen, strict=True):
            lead = GROUSER if key[2] == "rim" else 0.0
            grid = np.geomspace(lead + SHALLOWEST, DEEPEST, 40)
            mean = np.log(curves[key](grid))
            slope = (np.log(curves[key](grid + 1e-5)) - mean) / 1e-5
            seating = 0.0 if spread.shift is None else spread.shift[:, None] / n * shift * slope
            noisy = mean + spread.scatter[:, None] * scatter + seating
            for low, high, alpha in ((0.05, 0.95, 0.18), (0.25, 0.75, 0.3)):
                ends = np.exp(np.nanquantile(noisy, [low, high], axis=0))
                ax.fill_between(1e3 * grid, *ends, color="#0072B2", alpha=alpha, linewidth=0)
            ax.plot(1e3 * grid, np.exp(np.nanmedian(mean, axis=0)), color="#0072B2")
            for _, z, force in insertion_tests():
                ax.plot(1e3 * z, force, color="#111111", linewidth=0.6)
            where = f"{key[0]}, b = {key[1]},\ncontact along the {key[2]}"
            ax.set(xscale="log", yscale="log", title=where, xlabel="sinkage of the tips [mm]", ylim=(0.8, 500))
            ax.set_xticks([3, 5, 10, 20, 30], ["3", "5", "10", "20", "30"])
            ax.xaxis.set_minor_formatter(NullFormatter())
        axes[0].set_ylabel("force [N]")
        figure.savefig(HERE / "insertion.png", dpi=110, facecolor="white", metadata={"Software": None})


def save(table: pd.DataFrame, name: str) -> None:
    """Write a table beside this file."""
    table.to_csv(HERE / f"{name}.csv", index=False, float_format="%.5g")
    print(f"{name}.csv: {len(table)} rows", flush=True)


def statements() -> None:
    """What the paper says beside the tables of this folder."""
    sys.path.append(str(HERE))
    import soil_statements

    soil_statements.statements().to_csv(HERE / "statements.csv", index=False)


PARTS: dict[str, Callable[[], None]] = {
    "files": files,
    "naive": naive,
    "recovery": recovery,
    "wheels": wheels,
    "table2": table2,
    "insertion": insertion,
    "statements": statements,
}


if __name__ == "__main__":
    for part in sys.argv[1:] or PARTS:
        PARTS[part]()
