"""The statements of Sections 4.2.1 and 4.2.2, Tables 5 to 7, Figs. 7 to 9, each put as a test."""

from __future__ import annotations

import numpy as np
import section4_curves as curves
from paper_wheels import WHEELS
from section4_curves import BEARING, SHEARING, curve, errors, part
from section4_findings import FIT, Finding
from section4_tables import tables_6_to_8
from sensitivity.groups import REFERENCE, Setting, soil_array
from sensitivity.shares import force_shares

from bayesterra.models import M1, SOIL_FIELDS


def deformation_modulus() -> list[Finding]:
    """Table 5: K of G1, which Table 7 prints otherwise."""
    soils, setting = soil_array([REFERENCE] * 2), Setting(WHEELS["Wh31"], 80.0, np.array([0.6]))
    soils[0, SOIL_FIELDS.index("K")] = 0.025
    wrong, right = 100 * force_shares(M1(), soils, setting).shear_share[:, 0]
    return [
        Finding(
            "Table 5",
            "K of G1 is 25 mm (Table 7: 12 mm)",
            "must give the 15.0 % of Wh31 in Table 4",
            f"{wrong:.1f} % with 25 mm, {right:.1f} % with 12 mm",
            abs(wrong - 15.0) < 0.05,
        )
    ]


def error_tables() -> list[Finding]:
    """Tables 6 to 8: printed errors within the bounds."""
    table = tables_6_to_8()
    rows = []
    for number, some in table.groupby("table"):
        out = some[some["verdict"] == "differs"]
        beyond = np.maximum(out["printed"] - out["high"], out["low"] - out["printed"])
        text = ", ".join(f"{name} z by {by:.1f}" for name, by in zip(out["group"], beyond, strict=True))
        rows.append(
            Finding(
                f"Table {number}",
                f"{len(some)} errors (16) of z, F_DP, M_DR",
                "inside our bounds",
                f"{len(some) - len(out)} of {len(some)}" + (f"; beyond: {text} points" if text else ""),
                out.empty,
            )
        )
    return rows


def bearing_errors() -> list[Finding]:
    """Table 6, Figs. 7 and 8: P_I moves sinkage, not moment."""
    ratio = min(errors()[name][0] / errors()[name][1:].max() for name in BEARING)
    moment, name = curves.worst(BEARING, 2)
    found = curves.stresses(("G1", *BEARING)).shear.max(axis=2)[:, 0]
    shear = float(np.abs(found / found[0] - 1).max())
    return [
        Finding(
            "Table 6, Fig. 7",
            "P_I influences z much more than F_DP and M_DR",
            "three times in each group",
            f"{ratio:.1f} times or more",
            ratio > 3,
        ),
        Finding(
            "Table 6, Fig. 7",
            "the influence of P_I on M_DR is ignorable",
            "below 10 %, the margin the paper grants its models",
            f"at most {moment:.1f} % ({name})",
            moment < 10,
        ),
        Finding(
            "Fig. 8",
            "P_I obviously influences the distribution of τ",
            "over 10 % of its maximum, slip 0.2",
            f"up to {100 * shear:.0f} %",
            shear > 0.1,
        ),
    ]


def bearing_directions() -> list[Finding]:
    """Figs. 7 and 8: directions in which n0, n1 and K_s move stress, sinkage and forces."""
    depth = curves.stresses(("G2", "G1", "G3", "G4", "G5"), 0.01).normal.max(axis=2)[:, 0] / 1e3
    z = curve(0)
    orders = ((("G2", "G1", "G3"), 0), (("G4", "G1", "G5"), 1), (("G6", "G1", "G7"), 0))
    deeper = all(curves.rises(z, *names, beyond=row) for names, row in orders)
    grows = all(
        curves.rises(each, *names, beyond=row)
        for each in (part("F_DPtau"), curve(2), part("F_DPsigma"))
        for names, row in orders
    )
    falls = all(curves.rises(curve(1), *names[::-1], beyond=row) for names, row in orders)
    return [
        Finding(
            "Fig. 8",
            "σ falls with n0 and n1",
            "its maximum at 10 mm and slip 0.2",
            f"n0 {depth[0]:.0f} > {depth[1]:.0f} > {depth[2]:.0f} kPa, "
            f"n1 {depth[3]:.0f} > {depth[1]:.0f} > {depth[4]:.0f} kPa",
            bool(depth[0] > depth[1] > depth[2] and depth[3] > depth[1] > depth[4]),
        ),
        Finding(
            "Fig. 7",
            "z increases with n0 and n1 and decreases with K_s",
            "at all 61 slips (n1: above 0)",
            "at every one" if deeper else "not at every one",
            deeper,
        ),
        Finding(
            "Fig. 7",
            "a deeper wheel has slightly more M_DR and F_DPτ and still more F_DPσ, so less F_DP",
            "at all 61 slips, by n0, n1 and K_s",
            "at every one" if grows and falls else "not at every one",
            grows and falls,
        ),
    ]


def two_bearing_parameters() -> list[Finding]:
    """Table 6: K_s can be chosen."""
    most = np.max([errors()[name] for name in ("G8", "G9")], axis=0)
    free = {"n0": (0.0, 2.0), "n1": (0.0, 3.0)}
    found = [curves.refit(REFERENCE, free, Ks=modulus).errors for modulus in (250.0, 20_000.0)]
    text = " and ".join(f"{each[0]:.1f}, {each[1]:.1f}, {each[2]:.1f} %" for each in found)
    return [
        Finding(
            "Table 6",
            "G1, G8 and G9 give almost the same predictions",
            "below 3 %",
            f"z {most[0]:.1f}, F_DP {most[1]:.1f}, M_DR {most[2]:.1f} % at most",
            bool(most.max() < 3),
        ),
        Finding(
            "Table 6",
            "two of K_s, n0 and n1 suffice",
            "n0, n1 refitted to G1; F_DP, M_DR within its fit",
            f"K_s of a tenth (250): {text.replace(' and ', '; of eight times (20 000): ')}",
            bool(np.max(found, axis=0)[1:][0] < FIT["F_DP"] and np.max(found, axis=0)[2] < FIT["M_DR"]),
        ),
    ]


def shearing_errors() -> list[Finding]:
    """Table 7, Fig. 9: P_II and the sinkage; G1 against G16."""
    sinkage, name = curves.worst(SHEARING, 0)
    same = errors()["G16"]
    other = curves.refit(REFERENCE, {"c": (0.0, 5.0), "K": (2.0, 50.0)}, phi=25.0)
    return [
        Finding(
            "Table 7", "P_II has little influence on z", "below 5 %", f"at most {sinkage:.1f} % ({name})", sinkage < 5
        ),
        Finding(
            "Table 7, Fig. 9",
            "G1 and G16 give almost the same; c, φ and K are not independent",
            "within G1's fit",
            f"z {same[0]:.1f}, F_DP {same[1]:.1f}, M_DR {same[2]:.1f} %; with φ = 25° refitted "
            f"(c {other.values[0]:.2f} kPa, K {other.values[1]:.1f} mm) F_DP {other.errors[1]:.1f} %",
            bool((same < list(FIT.values())).all()),
        ),
    ]


def shearing_directions() -> list[Finding]:
    """Fig. 9: directions and slips of the influence of c, φ and K."""
    orders = (("G10", "G1", "G11"), ("G13", "G1", "G12"), ("G14", "G1", "G15"))
    right = all(curves.rises(curve(i), *names) for i in (1, 2) for names in orders)
    pull = curve(1)
    c, low, high = (pull[name] - pull["G1"] for name in ("G11", "G15", "G14"))
    early, late = 10, 60
    return [
        Finding(
            "Fig. 9",
            "M_DR and F_DP increase with c and φ and decrease with K",
            "at all 61 slips",
            "at every one" if right else "not at every one",
            right,
        ),
        Finding(
            "Fig. 9",
            "c acts at large slips, K mainly at small ones",
            "change of F_DP at slip 0.1 and 0.6",
            f"c (G11) {c[early]:+.1f} and {c[late]:+.1f} N, "
            f"K (G15) {low[early]:+.1f} and {low[late]:+.1f} N, "
            f"K (G14) {high[early]:+.1f} and {high[late]:+.1f} N",
            bool(c[late] > c[early] and low[early] > low[late] and high[early] < high[late]),
        ),
    ]
