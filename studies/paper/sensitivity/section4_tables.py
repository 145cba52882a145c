"""Tables 4 and 6 to 9 of Ding et al. (2015) from M1, beside what is printed."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
from paper_wheels import WHEELS
from sensitivity.cut_prior import group_inputs, study_problem
from sensitivity.groups import GROUPS, REFERENCE, SECTION_4, Setting, soil_array
from sensitivity.influence import influences
from sensitivity.responses import OUTCOMES, error_bounds, error_figures, error_table, respond, respond_groups
from sensitivity.shares import group_shares
from sensitivity.sobol import Sobol, sobol

import bayesterra as bt
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.models import M1, SOIL_FIELDS
from bayesterra.stats.laws import Law

HERE = Path(__file__).parent
ALL = tuple(GROUPS.values())
ROUNDING = 0.05
"""Half of the last printed digit of Table 4, percentage points."""
NEAR = 0.2
"""Half width of the box about G1, relative to G1; c3, which is 0 there, relative to c1."""
BOXES = ("near G1", "planetary", "paper-box")


def verdict(holds: bool) -> str:
    """The word of the index."""
    return "reproduced" if holds else "differs"


def table_4() -> pd.DataFrame:
    """F_Nτ of G1 at slip 0.6 and its share of the load, beside the print; how much sinkage would explain."""
    printed = pd.read_csv(HERE / "printed-table-4.csv")
    given = zip(printed["wheel"], printed["load_N"], printed["F_Ntau_N"], strict=True)
    rows = [_table_4_row(*row) for row in given]
    table = printed.join(pd.DataFrame(rows))
    difference = table["ours_percent"] - table["share_percent"]
    words = [verdict(abs(each) <= ROUNDING) for each in difference]
    return table.assign(difference=difference, verdict=words)


def _table_4_row(wheel: str, load: float, printed: float) -> dict[str, float]:
    """Our force and share, and the change of sinkage that would turn our force into the printed one."""
    setting = Setting(WHEELS[wheel], load, np.array([0.6]))
    found = group_shares(M1(), [REFERENCE], setting)
    depth = float(respond_groups(M1(), [REFERENCE], setting).sinkage[0, 0])
    step = depth * np.linspace(-0.1, 0.1, 401)
    parts = M1().components(REFERENCE.soil, setting.wheel, np.full(401, 0.6), depth + step)
    needed = np.interp(printed, np.asarray(parts.F_Ntau), step)
    return {
        "ours_N": float(found.F_Ntau[0, 0]),
        "ours_percent": 100 * float(found.shear_share[0, 0]),
        "sinkage_mm": 1e3 * depth,
        "needed_mm": 1e3 * float(needed),
    }


def tables_6_to_8() -> pd.DataFrame:
    """Errors (16) of G2 to G22: printed, ours against G1's curve, their difference, bounds and verdict."""
    table = error_table(M1(), ALL[1:], SECTION_4)
    words = [verdict(inside) for inside in table.pop("inside")]
    return table.assign(difference=table["ours"] - table["printed"], verdict=words)


def error_bounds_of(name: str, outcome: str) -> tuple[float, float, float]:
    """Printed error of a group and the bounds that hold for it, percent."""
    table = error_table(M1(), [GROUPS[name]], SECTION_4).set_index("outcome")
    printed, low, high = table[["printed", "low", "high"]].loc[[outcome]].to_numpy(dtype=float)[0].tolist()
    return printed, low, high


def inside_with_k_of_25_mm() -> int:
    """How many of the 63 printed errors would lie within their bounds with the K of Table 5."""
    soils = soil_array(ALL)
    i = SOIL_FIELDS.index("K")
    soils[soils[:, i] == soils[0, i], i] = 0.025
    values = respond(M1(), soils, SECTION_4).values
    low, high = error_bounds(error_figures(values[1:], values[0]), np.array(REFERENCE.printed_errors))
    printed = np.array([group.printed_errors for group in ALL[1:]])
    return int(((printed >= low) & (printed <= high)).sum())


def c1_of_g17() -> pd.DataFrame:
    """Printed errors of G17 beside those that other values of its c1 give."""
    values = np.arange(0.26, 0.421, 0.005)
    i = SOIL_FIELDS.index("c1")
    rows = []
    for value in values:
        changed = (*GROUPS["G17"].values[:i], float(value), *GROUPS["G17"].values[i + 1 :])
        table = error_table(M1(), [replace(GROUPS["G17"], values=changed)], SECTION_4)
        rows.append((value, *table["ours"], bool(table["inside"].all())))
    return pd.DataFrame(rows, columns=["c1", *OUTCOMES, "inside"])


def implied_sinkage() -> pd.DataFrame:
    """The measured sinkage at slip 0.6 that the printed error of each group implies, mm.

    From printed errors beyond 5 %, each of which stems from slip 0.6 whatever the measurements, within G1's
    fit: z_m = z_p/(1 ± Err), eq. (16) solved for it.
    """
    depth = 1e3 * respond_groups(M1(), ALL, SECTION_4).sinkage
    worst = np.abs(depth - depth[0]).argmax(axis=1)
    rows = [
        (group.name, own[-1], own[-1] / (1 + np.sign(own[-1] - depth[0, -1]) * group.printed_errors[0]))
        for group, own, row in zip(ALL, depth, worst, strict=True)
        if group.printed_errors[0] > 0.05 and row == depth.shape[1] - 1
    ]
    return pd.DataFrame(rows, columns=["group", "ours_mm", "implied_mm"])


def table_9() -> pd.DataFrame:
    """The words of Table 9 beside the influences behind ours."""
    table = influences(M1())
    same = (table["word"] == table["printed"]).tolist()
    return table.assign(verdict=[verdict(each) for each in same])


def prior_study(box: str) -> Posterior:
    """Wh31 under 80 N at the slips of Section 3.1 with simulated readings of G1, and one of ``BOXES``.

    Readings carry no noise: only the prior and where it is cut matter here.
    """
    values = respond_groups(M1(), [REFERENCE], SECTION_4).values[0]
    table = pd.DataFrame(values, columns=["sinkage [m]", "drawbar_pull [N]", "resistance_moment [N m]"])
    table.insert(0, "slip", SECTION_4.slips)
    table.insert(1, "load [N]", SECTION_4.load)
    return posterior(
        bt.Study(
            table, {"Wh31": SECTION_4.wheel}, title=f"G1 on Wh31, {box}", kind="simulated", model="M1",
            slip_reference="shearing", drive="load",
            noise={"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3},
            priors={"set": "paper-box", **_near_laws()} if box == "near G1" else {"set": box},
        )
    )  # fmt: skip


def _near_laws() -> dict[str, Law]:
    """Flat laws within ``NEAR`` of G1."""
    soil = REFERENCE.soil
    middles = dict(zip(SOIL_FIELDS, soil.as_array().tolist(), strict=True))
    ends = {name: NEAR * abs(value or middles["c1"]) for name, value in middles.items()}
    return {name: Law("uniform", lower=value - ends[name], upper=value + ends[name]) for name, value in middles.items()}


def sobol_table(box: str, n: int, seed: int = 1) -> pd.DataFrame:
    """Sobol indices of the parameter groups, for every slip and for all slips together (slip NaN)."""
    density = prior_study(box)
    found = sobol(study_problem(density, group_inputs(density)), n, np.random.default_rng(seed))
    each = found.table.drop(columns=["row", "load [N]"])
    names = [output.split(" [")[0] for output in each.pop("output")]
    moments = {name: np.repeat(getattr(found, name), len(found.inputs)) for name in ("mean", "sd")}
    each = each.rename(columns={"input": "parameter_group"}).assign(outcome=names, **moments)
    table = pd.concat([each, _all_slips(found)], ignore_index=True).assign(
        box=box, n=n, accepted=found.accepted, unmatched=found.unmatched
    )
    return table[["box", "outcome", "slip", "parameter_group", *_INDICES, *_ABOUT]]


_ABOUT = ("mean", "sd", "n", "accepted", "unmatched")
"""Mean and sd of the outcome (mm, N, N m), base draws, shares inside the cut and without partner."""
_INDICES = ("first", "first_error", "total", "total_error")


def _all_slips(found: Sobol) -> pd.DataFrame:
    """Indices of each outcome as a curve over slip: means weighted by variance; errors at their most."""
    names = found.outputs["output"].str.split(" [", regex=False).str[0].to_numpy()
    rows = []
    for outcome in OUTCOMES:
        weight = np.where(names == outcome, found.sd**2, 0.0)
        means = [getattr(found, name) @ (weight / weight.sum()) for name in _INDICES]
        rows += [(outcome, np.nan, kind, *figures) for kind, *figures in zip(found.inputs, *means, strict=True)]
    return pd.DataFrame(rows, columns=["outcome", "slip", "parameter_group", *_INDICES])
