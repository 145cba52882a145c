"""Six wheels on one soil: the joint posterior of all, and whether the verdict finds what belongs to the soil.

Run it with ``python studies/many-wheels/run.py``; it takes some minutes per case and rewrites the tables and
the figure beside it. ``--case NAME`` remakes one case.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

import bayesterra as bt
from bayesterra.models import M1
from bayesterra.parameters import PARAMETERS
from bayesterra.pooling.run import PooledResult, run_pooled
from bayesterra.report.figures import DATA, MARKS, POSTERIOR, PRIOR, label, new_figure, styled
from bayesterra.sampling.sampler import Progress

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "support"))

from paper_wheels import SOILS, WHEELS  # noqa: E402

SLIPS = np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6])
LOAD = 80.0
NOISE = {"sinkage": 0.0002, "drawbar_pull": 0.25, "resistance_moment": 0.05}
"""Standard deviations, SI; an assumption: about those of means over several turns of a wheel."""
SOIL = ("c", "phi")
OWN = ("Ks", "n0", "n1", "K", "c1", "c2")
LEVELS = {"q05": 0.05, "q25": 0.25, "q50": 0.5, "q75": 0.75, "q95": 0.95}

CASES = {
    "one-soil": dict.fromkeys(WHEELS, (0.19, 30.1)),
    "six-soils": dict(
        zip(WHEELS, ((0.2, 24.0), (1.0, 27.0), (0.2, 36.0), (2.0, 30.0), (0.6, 33.0), (1.5, 22.0)), strict=True)
    ),
}
"""c (kPa) and φ (deg) of every wheel: the mean of Table 10 for all, or made to differ."""
ROLES: dict[str, dict[str, object]] = {
    "one-soil": {"shared": SOIL},
    "six-soils": {"hierarchical": {name: {} for name in SOIL}},
}
"""What the study states of c and φ: one value as the paper has it, or values of one population."""


def truth(case: str, name: str) -> dict[str, float]:
    """True values of a wheel's soil, SI: Table 10, but for c and φ."""
    c, phi = CASES[case][name]
    return {**SOILS[name], "c": c * 1e3, "phi": float(np.radians(phi))}


def simulated(case: str, seed: int = 1) -> bt.Study:
    """The study of a case: readings made by M1, load-driven, with stated noise."""
    frames = []
    for stream, name in zip(np.random.SeedSequence(seed).spawn(len(WHEELS)), WHEELS, strict=True):
        soil, rng = bt.Soil(**truth(case, name)), np.random.default_rng(stream)
        z = np.asarray(M1().sinkage(soil, WHEELS[name], SLIPS, LOAD))
        forces = M1().forces(soil, WHEELS[name], SLIPS, z)
        exact = {"sinkage": z, "drawbar_pull": forces.drawbar_pull, "resistance_moment": forces.resistance_moment}
        read = {n: values + NOISE[n] * rng.standard_normal(len(SLIPS)) for n, values in exact.items()}
        frames.append(
            pd.DataFrame(
                {
                    "wheel": name,
                    "slip": SLIPS,
                    "load [N]": LOAD,
                    "sinkage [m]": read["sinkage"],
                    "drawbar_pull [N]": read["drawbar_pull"],
                    "resistance_moment [N m]": read["resistance_moment"],
                }
            )
        )
    return bt.Study(
        pd.concat(frames, ignore_index=True),
        dict(WHEELS),
        slip_reference="shearing",
        title=f"Six wheels, {case.replace('-', ' ')} (simulated)",
        model="M1",
        noise=NOISE,
        kind="simulated",
        source="studies/many-wheels/run.py: M1, soils of Ding et al. 2015, Table 10, c and φ as stated there",
        pooling={"by": "wheel", **ROLES[case], "separate": OWN},
    )


def known(case: str, parameter: str) -> float:
    """True value of a parameter, field units; of a population, mean or sd of its wheels' values."""
    base, _, name = parameter.removesuffix("]").partition("[")
    base, _, what = base.partition(".")
    values = [truth(case, one)[base] / PARAMETERS[base].scale for one in ([name] if name else WHEELS)]
    return float(np.std(values, ddof=1) if what == "spread" else np.mean(values))


def recovered(case: str, result: PooledResult) -> pd.DataFrame:
    """Every parameter's true value beside its posterior, field units."""
    rows = []
    for row in result.summary.to_dict("records"):
        true = known(case, str(row["parameter"]))
        rows.append(
            {
                "case": case,
                "parameter": row["parameter"],
                "unit": row["unit"],
                "truth": true,
                "median": row["median"],
                "hdi90_lo": row["hdi90_lo"],
                "hdi90_hi": row["hdi90_hi"],
                "inside": bool(row["hdi90_lo"] <= true <= row["hdi90_hi"]),
                "ess": min(row["ess_bulk"], row["ess_tail"]),
                "r_hat": row["r_hat"],
            }
        )
    return pd.DataFrame(rows)


def costs(case: str, result: PooledResult) -> pd.DataFrame:
    """Size, convergence, time and effective draws per second of processor time."""
    verdict, seconds = result.record["verdict"], result.record["seconds"]
    return pd.DataFrame(
        [
            {
                "case": case,
                "free_parameters": len(result.summary),
                "converged": verdict["converged"],
                "ess": verdict["ess"],
                "r_hat": verdict["r_hat"],
                "processor_seconds": seconds["processor"],
                "ess_per_processor_second": verdict["ess"] / seconds["processor"],
            }
        ]
    )


def alone(case: str, result: PooledResult) -> pd.DataFrame:
    """What each wheel alone says of c and φ, and what it or the soil says with the others: quantiles."""
    rows = []
    for name in SOIL:
        scale, joint = PARAMETERS[name].scale, result.draws["posterior"][name]
        separate = result.draws["alone"][name]
        laws = [("alone", wheel, separate.sel(group=wheel)) for wheel in WHEELS]
        if "group" in joint.dims:
            laws += [("together", wheel, joint.sel(group=wheel)) for wheel in WHEELS]
        else:
            laws.append(("together", "all", joint))
        for how, wheel, draws in laws:
            values = draws.to_numpy().ravel() / scale
            levels = dict(zip(LEVELS, np.quantile(values, list(LEVELS.values())), strict=True))
            true = known(case, f"{name}[{wheel}]" if wheel in WHEELS else name)
            rows.append({"case": case, "parameter": name, "how": how, "wheel": wheel, "truth": true, **levels})
    return pd.DataFrame(rows)


@styled
def picture(table: pd.DataFrame) -> Figure:
    """Draw c and φ of both cases: each wheel alone in grey, with the others in blue, circles the truth."""
    figure = new_figure(7.2, 5.2)
    panels = figure.subplots(2, 2, sharex="col")
    for line, case in zip(panels, CASES, strict=True):
        for ax, name in zip(line, SOIL, strict=True):
            _panel(ax, table[(table["case"] == case) & (table["parameter"] == name)])
        line[0].set_ylabel(case.replace("-", " "))
    for ax, name in zip(panels[1], SOIL, strict=True):
        ax.set_xlabel(label(PARAMETERS[name]))
    bar = {"linewidth": 4.0, "solid_capstyle": "butt"}
    marks = [
        Line2D([], [], color=PRIOR, label="each wheel alone, 50 and 90 %", **bar),
        Line2D([], [], color=POSTERIOR, label="with the others", **bar),
        Line2D([], [], marker=MARKS["truth"].marker, color=DATA, linestyle="", markerfacecolor="none",
               label="truth (simulated)"),
    ]  # fmt: skip
    figure.legend(handles=marks, loc="outside upper center", ncols=3, frameon=False)
    return figure


def _panel(ax: Axes, part: pd.DataFrame) -> None:
    places = list(dict.fromkeys(part["wheel"]))
    for row in part.to_dict("records"):
        place, together = places.index(row["wheel"]), row["how"] == "together"
        colour, aside = (POSTERIOR, 0.14) if together else (PRIOR, -0.14)
        at = [place + (0.0 if row["wheel"] == "all" else aside)] * 2
        ax.plot([row["q05"], row["q95"]], at, color=colour, linewidth=1.2)
        ax.plot([row["q25"], row["q75"]], at, color=colour, linewidth=4.0, solid_capstyle="butt")
        marker = MARKS["truth"].marker
        ax.plot(row["truth"], place, marker, color=DATA, markerfacecolor="none", markersize=5)
    ax.set(yticks=range(len(places)), yticklabels=places, ylim=(len(places) - 0.4, -0.6))
    ax.tick_params(axis="y", length=0)


def judged(case: str, table: pd.DataFrame) -> pd.DataFrame:
    """A table of the result with the case in front."""
    return pd.concat([pd.Series([case] * len(table), name="case"), table], axis=1)


def _shown(case: str, progress: Progress) -> None:
    found = progress.diagnosis
    rest = "" if found is None else f" {found.steps} steps, {found.ess:.0f} effective, {found.worst_r_hat:.4f}"
    print(f"{case}: {progress.stage} {progress.done:.2f}{rest}", flush=True)


def remake(case: str, keep: Path | None) -> dict[str, pd.DataFrame]:
    """Run a case and make its tables."""
    result = run_pooled(simulated(case), report=lambda progress: _shown(case, progress))
    if keep is not None:
        result.save(keep / case, overwrite=True)
    return {
        "recovery": recovered(case, result),
        "alone": alone(case, result),
        "costs": costs(case, result),
        "sharing": judged(case, result.sharing),
        "pooling": judged(case, result.pooling),
        "by_wheel": judged(case, result.left_out[result.left_out["what"] == "group"].reset_index(drop=True)),
    }


def main() -> None:
    """Remake the tables, all cases or one."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--case", choices=CASES)
    parser.add_argument("--keep", type=Path, help="folder for whole result folders, which are not stored")
    given = parser.parse_args()
    if given.keep is not None:
        given.keep.mkdir(parents=True, exist_ok=True)
    for case in [given.case] if given.case else CASES:
        for name, table in remake(case, given.keep).items():
            path = HERE / f"{name}.csv"
            old = pd.read_csv(path) if path.is_file() else table.iloc[:0]
            kept = old[old["case"] != case]
            pd.concat([kept, table] if len(kept) else [table]).to_csv(path, index=False, float_format="%.6g")
    picture(pd.read_csv(HERE / "alone.csv")).savefig(
        HERE / "soils.png", dpi=150, facecolor="white", metadata={"Software": None}
    )


if __name__ == "__main__":
    main()
