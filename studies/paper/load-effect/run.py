"""The load effect (42) of Ding et al. 2015: Table 16's two soils, what the paper says of them, a recovery.

Run it with ``python studies/paper/load-effect/run.py [curves | recovery]``; some minutes, ``curves`` seconds.
It rewrites all CSV files but ``table-16.csv``, and the plot. Wheel and mean load are assumptions, the
readings simulated.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import astuple, dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.optimize import least_squares

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.models import M2, M2L, LoadEffectSoil, Soil, Wheel
from bayesterra.parameters import PARAMETERS
from bayesterra.report.figures import DATA, MARKS, POSTERIOR, new_figure, png, styled
from bayesterra.runtime.engines import completed, local_pool

HERE = Path(__file__).parent
SLIPS = np.round(np.linspace(0.0, 0.8, 33), 3)
LOADS = (32.0, 64.0, 96.0)
MEAN_LOAD = 64.0
"""N, the mean load of a wheel: 26 kg on four wheels; an assumption."""
WHEEL = Wheel(0.090, 0.110, 0.010, 24, 0.65)
"""An assumption: the paper gives no wheel of El-Dorado II."""
TEST_SLIPS = (0.05, 0.15, 0.3, 0.45, 0.6)
DESIGNS = {"three loads": LOADS, "the mean load alone": (64.0, 64.0, 64.0)}
"""Loads (N) of the simulated rows; every design has 15 rows, five slips three times."""
OUTCOMES = ("sinkage", "drawbar_pull", "resistance_moment")
_UNITS = {"sinkage": 1e3, "drawbar_pull": 1.0, "resistance_moment": 1.0}
_COLOURS = dict(zip(LOADS, (MARKS["IM2"].colour, POSTERIOR, MARKS["IM1"].colour), strict=True))


def soils() -> dict[str, LoadEffectSoil]:
    """The two identified columns of Table 16, SI."""
    table = pd.read_csv(HERE / "table-16.csv").set_index("case")
    return {
        case: LoadEffectSoil(
            Ks=1e3 * row["Ks_kPa"], n0=row["n0"], n1=row["n1"], c=1e3 * row["c_kPa"],
            phi=float(np.radians(row["phi_deg"])), K=1e-3 * row["K_mm"], c1=0.5, c2=0.0, c3=0.0,
            cP1=row["cP1"], cP2=row["cP2"], cDP=row["cDP"], cM=row["cM"],
        )
        for case, row in table.loc[["flat", "slope"]].iterrows()
    }  # fmt: skip


def plain(soil: LoadEffectSoil) -> Soil:
    """The soil without its load effect, for M2."""
    return Soil(*astuple(soil)[:9])


def response(soil: Soil, load: float, slips: FloatArray = SLIPS) -> dict[str, FloatArray]:
    """Sinkage (m), pull (N) and moment (N m) under ``load`` (N): by M2L with a load effect, by M2 without."""
    model = M2L(mean_load=MEAN_LOAD) if isinstance(soil, LoadEffectSoil) else M2()
    z = model.sinkage(soil, WHEEL, slips, load)
    forces = model.forces(soil, WHEEL, slips, z)
    values = (z, forces.drawbar_pull, forces.resistance_moment)
    return {name: np.asarray(value) for name, value in zip(OUTCOMES, values, strict=True)}


def curves() -> pd.DataFrame:
    """Outcomes against slip for wheels of three loads, both soils, with and without the load effect."""
    tables = []
    for case, soil in soils().items():
        for load in LOADS:
            for model, kind in (("M2L", soil), ("M2", plain(soil))):
                found = response(kind, load)
                table = pd.DataFrame({"slip": SLIPS})
                table["sinkage [mm]"] = 1e3 * found["sinkage"]
                table["drawbar_pull [N]"] = found["drawbar_pull"]
                table["resistance_moment [N m]"] = found["resistance_moment"]
                table["pull_over_load"] = found["drawbar_pull"] / load
                tables.append(table.assign(case=case, model=model, load=load))
    return pd.concat(tables, ignore_index=True)


@dataclass(frozen=True)
class Statement:
    """What the paper says in a place, what comes out here, and whether that is the same."""

    table_or_figure: str
    statement: str
    printed: str
    ours: str
    difference: str
    verdict: str
    why: str


def statements() -> Iterator[Statement]:
    """Every statement of Section 8 that the paper's own numbers can test."""
    known = soils()
    yield from _equations(known)
    yield from _soil_values(known)
    yield from _signs(known)
    why = "Figures 20 and 21 exist as pictures only, and the vehicle's geometry is not given"
    fidelity = "slip, pull, moment, normal force and sinkage are predicted with high fidelity"
    yield Statement("Figs. 20, 21", fidelity, "-", "-", "-", "cannot be checked", why)


def _equations(known: dict[str, LoadEffectSoil]) -> Iterator[Statement]:
    off = 0.0
    for soil in known.values():
        zeros = LoadEffectSoil(*astuple(soil)[:9])
        for load in LOADS:
            ours, m2 = response(zeros, load), response(plain(soil), load)
            off = max(off, *(float(np.abs(ours[n] - m2[n]).max() / np.abs(m2[n]).max()) for n in OUTCOMES))
    text = "(42) is the decoupled closed form M2, improved to reflect the load effect"
    printed, ours = "M2 with all four coefficients 0", f"largest relative difference {off:.1g}"
    yield Statement("(42)", text, printed, ours, "-", "reproduced" if off < 1e-12 else "differs", "")

    flat, heavy = known["flat"], LOADS[-1]
    only = LoadEffectSoil(*astuple(flat)[:9], cDP=float(flat.cDP))
    with_it, without = response(only, heavy), response(plain(flat), heavy)
    shift = float(np.abs(with_it["sinkage"] / without["sinkage"] - 1).max())
    pull = 100 * _mean_ratio(with_it["drawbar_pull"], without["drawbar_pull"]) - 100
    yield Statement(
        "(42)", "c_DP reflects the influence of the vertical load on the normal force", "normal force",
        f"at 96 N the pull {pull:+.0f} %, the sinkage under the load {100 * shift:+.1g} %", "-", "differs",
        "c_DP stands in (42b) alone, so it scales the drawbar pull; the normal force knows c_M only, through "
        "M_DR in (42a). A slip of the pen",
    )  # fmt: skip
    only = LoadEffectSoil(*astuple(flat)[:9], cM=float(flat.cM))
    moment = 100 * _mean_ratio(response(only, heavy)["resistance_moment"], without["resistance_moment"]) - 100
    own = 100 * float(np.mean(response(only, heavy)["sinkage"] / without["sinkage"])) - 100
    yield Statement(
        "(42)", "c_M reflects the influence of the vertical load on the resistance moment", "moment",
        f"at 96 N the moment {moment:+.0f} %, the sinkage {own:+.1f} %", "-", "reproduced", "",
    )  # fmt: skip
    for case, soil in known.items():
        crossing = -float(soil.cP1) / float(soil.cP2)
        c1, c2, rest = angles_in_place_of_factor(soil)
        yield Statement(
            "(42)",
            f"1 + c_P1 + c_P2 s reflects the slip, as the contact angles are held constant ({case})",
            "c1 = 0.5, c2 = 0 held",
            f"factor {1 + soil.cP1:.3f} at s = 0, 1 at s = {crossing:.2f}; with c1 = {c1:.2f}, "
            f"c2 = {c2:+.2f} M2 comes to within {rest:.1f} % of its pull",
            f"{rest:.1f} % of the largest pull",
            "reproduced" if rest < 5 else "differs",
            "two contact angles in M2 do to the pull at the mean load what the two coefficients do, for "
            "slips from 0.05 to 0.6; the same pair moves sinkage and moment too" if rest < 5 else
            "no contact angles in M2 give this pull over slip: the factor is no mere stand-in for them",
        )  # fmt: skip


def angles_in_place_of_factor(soil: LoadEffectSoil) -> tuple[float, float, float]:
    """c1, c2 with which M2 comes nearest to M2L's pull at the mean load; what is left, % of its maximum."""
    slips = np.linspace(0.05, 0.6, 12)
    wanted = response(soil, MEAN_LOAD, slips)["drawbar_pull"]

    def misfit(x: FloatArray) -> FloatArray:
        values = Soil(*astuple(soil)[:6], float(x[0]), float(x[1]))
        return (response(values, MEAN_LOAD, slips)["drawbar_pull"] - wanted) / np.abs(wanted).max()

    best = least_squares(misfit, np.array([0.5, 0.0]), bounds=([0.05, -0.7], [0.9, 0.15]))
    return float(best.x[0]), float(best.x[1]), float(100 * np.abs(best.fun).max())


def _soil_values(known: dict[str, LoadEffectSoil]) -> Iterator[Statement]:
    flat, slope = known["flat"], known["slope"]
    reference = pd.read_csv(HERE / "table-16.csv").set_index("case").loc["reference"]
    changed = [n for n in ("Ks", "n0", "n1", "c", "phi", "K") if getattr(flat, n) != getattr(slope, n)]
    deeper = response(slope, MEAN_LOAD)["sinkage"] / response(flat, MEAN_LOAD)["sinkage"]
    yield Statement(
        "Table 16", "the soil parameters were kept almost the same", "flat and slope",
        f"only {', '.join(changed)} changes, {flat.n0:g} to {slope.n0:g}",
        f"sinkage {100 * (deeper.min() - 1):+.0f} to {100 * (deeper.max() - 1):+.0f} %", "reproduced",
        "a change of 5 % in n0 moves the sinkage by more than that",
    )  # fmt: skip
    Ks = 1e3 * float(reference["Ks_kPa"])
    ours, theirs = (k * 0.01**n / 1e3 for k, n in ((flat.Ks, flat.n0), (Ks, float(reference["n0"]))))
    yield Statement(
        "Table 16", "K_s is close to the value of Ishigami (2008)", f"{reference['Ks_kPa']:g} kPa/m^N",
        f"{flat.Ks / 1e3:g} kPa/m^N; pressure at 10 mm and zero slip {ours:.0f} against {theirs:.0f} kPa",
        f"{100 * (flat.Ks / Ks - 1):+.1f} %; pressure {ours / theirs:.1f} times", "reproduced",
        "the figures agree, the soils do not: K_s has another unit with N = 0.63 than with N = 1, and 1790 "
        "was its start value, from which the paper's solver hardly moves it (Table 10)",
    )  # fmt: skip
    angle, stress = float(np.degrees(flat.phi)), 5e3
    strength, other = (
        c + stress * np.tan(phi)
        for c, phi in (
            (float(flat.c), float(flat.phi)),
            (1e3 * float(reference["c_kPa"]), np.radians(float(reference["phi_deg"]))),
        )
    )
    yield Statement(
        "Table 16", "c and φ are close to the values of the same reference",
        f"{reference['c_kPa']:g} kPa, {reference['phi_deg']:g} deg", f"{flat.c / 1e3:g} kPa, {angle:.1f} deg",
        f"{angle - float(reference['phi_deg']):+.1f} deg; "
        f"strength at 5 kPa {100 * (strength / other - 1):+.0f} %",
        "reproduced", "",
    )  # fmt: skip


def _signs(known: dict[str, LoadEffectSoil]) -> Iterator[Statement]:
    for case, soil in known.items():
        light, heavy = (effect(soil, load) for load in (LOADS[0], LOADS[-1]))
        signs = " ".join(
            f"{n} {'<' if v < 0 else '>'} 0"
            for n, v in zip(("c_P1", "c_P2", "c_DP", "c_M"), astuple(soil)[9:], strict=True)
        )
        moment_words = f"M_DR {light[2]:+.0f} % at 32 N and {heavy[2]:+.0f} % at 96 N"
        pull_words = f"F_DP {light[1]:+.0f} % and {heavy[1]:+.0f} %"
        words = f"{moment_words}; {pull_words}; z {light[0]:+.1f} % and {heavy[0]:+.1f} %"
        right = light[2] > 0 > heavy[2]
        yield Statement(
            "Table 16", f"signs of the coefficients ({case})", signs,
            f"against the same wheel without c_DP and c_M: {words}", "-",
            "reproduced" if right else "differs",
            "c_M > 0: the friction under a wheel grows less than its load; c_DP < 0 gives back some of the "
            "pull that this takes away. Both columns have the same signs; the paper has no word on them",
        )  # fmt: skip


def effect(soil: LoadEffectSoil, load: float) -> tuple[float, float, float]:
    """Mean change (%) of sinkage, pull and moment over slips 0.1 to 0.6 by c_DP and c_M."""
    without = LoadEffectSoil(*astuple(soil)[:9], cP1=soil.cP1, cP2=soil.cP2)
    slips = np.linspace(0.1, 0.6, 11)
    ours, base = (response(one, load, slips) for one in (soil, without))
    z, pull, moment = (100 * (_mean_ratio(ours[name], base[name]) - 1) for name in OUTCOMES)
    return z, pull, moment


def _mean_ratio(values: FloatArray, base: FloatArray) -> float:
    """Ratio of means: single pulls may be zero."""
    return float(values.mean() / base.mean())


def simulated() -> pd.DataFrame:
    """Readings of three loads at five slips, made by M2L from Table 16's flat soil; simulated."""
    return bt.simulate(design("three loads"), seed=1).drop(columns="use")


def design(name: str) -> bt.Study:
    """The shipped study with the loads of a design and readings yet to be made."""
    shipped = bt.load_study(HERE)
    loads = np.repeat(DESIGNS[name], len(TEST_SLIPS))
    blank = np.full(len(loads), 1e-3)
    table = pd.DataFrame({"slip": np.tile(TEST_SLIPS, 3), "load": loads, **dict.fromkeys(OUTCOMES, blank)})
    return _study(table.rename(columns=_si), shipped, name)


def study(name: str) -> bt.Study:
    """The simulated study of a design, seed 1."""
    conditions = design(name)
    return _study(bt.simulate(conditions, seed=1), bt.load_study(HERE), name)


def _si(column: str) -> str:
    units = {"load": "N", "sinkage": "m", "drawbar_pull": "N", "resistance_moment": "N m"}
    return f"{column} [{units[column]}]" if column in units else column


def _study(table: pd.DataFrame, shipped: bt.Study, name: str) -> bt.Study:
    return bt.Study(
        table, dict(shipped.wheels), title=f"Load effect, {name}, simulated", kind="simulated",
        source="made by M2L from Table 16", slip_reference="shearing", model=shipped.model,
        noise=dict(shipped.noise), priors={"set": "paper-box"}, truth=shipped.truth,
        sampling=shipped.sampling,
    )  # fmt: skip


def recovery(name: str) -> pd.DataFrame:
    """Posterior and verdict of every parameter beside the truth, for one design."""
    result = bt.run(study(name), seed=1)
    verdicts = result.identifiability.set_index("parameter")
    truth = bt.load_study(HERE).truth
    rows: list[dict[str, object]] = []
    for row in result.summary.itertuples():
        if truth is None or row.parameter not in truth.values:
            continue
        true = truth.values[row.parameter] / PARAMETERS[row.parameter].scale
        rows.append(
            {
                "design": name, "parameter": row.parameter, "unit": row.unit, "truth": true,
                "median": row.median, "sd": row.sd, "hdi90_lo": row.hdi90_lo, "hdi90_hi": row.hdi90_hi,
                "prior_sd": row.prior_sd, "covered": bool(row.hdi90_lo <= true <= row.hdi90_hi),
                "verdict": verdicts.loc[row.parameter, "verdict"],
                "contraction": verdicts.loc[row.parameter, "contraction"], "converged": result.converged,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


@styled
def curve_figure(table: pd.DataFrame) -> Figure:
    """Sinkage, pull and moment against slip: both soils, three loads, with and without the load effect."""
    figure = new_figure(9.0, 5.2)
    panels = figure.subplots(2, 3, sharex=True)
    columns = {"sinkage [mm]": "$z$ [mm]", "drawbar_pull [N]": r"$F_\mathrm{DP}$ [N]",
               "resistance_moment [N m]": r"$M_\mathrm{DR}$ [N m]"}  # fmt: skip
    for row, case in zip(panels, ("flat", "slope"), strict=True):
        for ax, (column, text) in zip(row, columns.items(), strict=True):
            for (load, model), part in table[table["case"] == case].groupby(["load", "model"]):
                dashes = {} if model == "M2L" else {"dashes": (4, 2), "linewidth": 1.0}
                shown = f"{load:g} N, {'(42)' if model == 'M2L' else 'M2'}"
                ax.plot(part["slip"], part[column], color=_COLOURS[float(load)], label=shown, **dashes)
            if column.startswith("drawbar"):
                ax.axhline(0, color=DATA, linewidth=0.5)
            ax.set_ylabel(text)
            ax.set_title(f"Table 16, {'moving on flat terrain' if case == 'flat' else 'climbing slopes'}")
    for ax in panels[1]:
        ax.set_xlabel("slip $s$")
    handles, labels = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=6)
    return figure


def write_curves() -> None:
    """Write the simulated readings, the curves with their plot, and the statements."""
    simulated().to_csv(HERE / "measurements.csv", index=False, float_format="%.5g")
    table = curves()
    table.to_csv(HERE / "curves.csv", index=False, float_format="%.5g")
    figure = curve_figure(table)
    (HERE / "curves.png").write_bytes(png(figure.axes[0], 1350))
    found = pd.DataFrame([vars(one) for one in statements()])
    found.to_csv(HERE / "statements.csv", index=False)
    print(found[["statement", "ours", "verdict"]].to_string())


def write_recovery() -> None:
    """Write what the posteriors of all designs find."""
    with local_pool() as engine:
        found = dict(completed(recovery, DESIGNS, engine))
    recovered = pd.concat([found[design] for design in DESIGNS], ignore_index=True)
    recovered.to_csv(HERE / "recovery.csv", index=False, float_format="%.5g")
    print(recovered.to_string())


def main(part: str | None = None) -> None:
    """Write one part of the study, or all of it."""
    parts = {"curves": write_curves, "recovery": write_recovery}
    for name in parts if part is None else [part]:
        parts[name]()


if __name__ == "__main__":
    main(*sys.argv[1:])
