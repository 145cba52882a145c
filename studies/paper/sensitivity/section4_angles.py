"""The statements of Sections 4.2.3 and 4.2.4, Tables 8 and 9, Figs. 10 and 11, each put as a test."""

from __future__ import annotations

import numpy as np
import section4_curves as curves
from paper_wheels import WHEELS
from section4_curves import BEARING, CONTACT, curve, errors
from section4_findings import FIT, Finding
from section4_tables import error_bounds_of, table_9
from sensitivity.groups import GROUPS

from bayesterra.models import M1


def contact_errors() -> list[Finding]:
    """Table 8, Fig. 10: what P_III moves how much."""
    moment, name = curves.worst(CONTACT, 2)
    others = tuple(each for each in CONTACT if each != "G20")
    (sinkage, whose), (bearing, softest) = curves.worst(others, 0), curves.least(BEARING, 0)
    less = [each for each in CONTACT if errors()[each][1] < max(errors()[each][0], errors()[each][2])]
    text = "; ".join(f"not {each}: F_DP {errors()[each][1]:.1f}, z {errors()[each][0]:.1f} %" for each in less)
    return [
        Finding(
            "Table 8",
            "the influence of P_III on M_DR is very small",
            "within G1's fit, 4.55 %",
            f"at most {moment:.1f} % ({name})",
            moment < FIT["M_DR"],
        ),
        Finding(
            "Table 8",
            "but for G20, the influence on z is not obvious beside that of P_I",
            "below every single change of P_I",
            f"at most {sinkage:.1f} % ({whose}); P_I at least {bearing:.1f} % ({softest})",
            sinkage < bearing,
        ),
        Finding(
            "Table 8, Fig. 10",
            "P_III influences F_DP more than z and M_DR",
            "each of six groups",
            f"{len(CONTACT) - len(less)} of 6; {text}",
            not less,
        ),
    ]


def given_sinkage() -> list[Finding]:
    """Fig. 11: c1 and c2 at a given sinkage."""
    z = 0.01
    orders = (("G17", "G1", "G18"), ("G1", "G19", "G20"))
    found = [curves.stresses(names, z) for names in orders]
    turned = all((np.diff(each.maximum[:, 0]) > 0).all() for each in found)
    lower = all((np.diff(each.normal.max(axis=2)[:, 0]) < 0).all() for each in found)
    force = [[float(M1().forces(GROUPS[n].soil, WHEELS["Wh31"], 0.2, z).normal) for n in o] for o in orders]
    peak = [each.normal.max(axis=2)[:, 0] / 1e3 for each in found]
    text = ", ".join(
        f"{name}: σ_max {p[0]:.2f} to {p[2]:.2f} kPa, F_N {f[0]:.1f} to {f[2]:.1f} N"
        for name, p, f in zip(("c1", "c2"), peak, force, strict=True)
    )
    return [
        Finding(
            "Fig. 11",
            "at a given z, θm grows with c1 and c2, and σ_max and F_N fall",
            "10 mm, slip 0.2",
            text,
            bool(turned and lower and (np.diff(force, axis=1) < 0).all()),
        )
    ]


def given_load() -> list[Finding]:
    """Fig. 10: c1 and c2 at a given load."""
    orders = ((("G17", "G1", "G18"), 0), (("G1", "G19", "G20"), 1))
    right = all(
        curves.rises(curve(0), *names, beyond=row) and curves.rises(curve(1), *names[::-1], beyond=row)
        for names, row in orders
    )
    return [
        Finding(
            "Fig. 10",
            "at a given load z increases and F_DP decreases with c1 and c2",
            "all slips (c2: above 0)",
            "at every one" if right else "not at every one",
            right,
        )
    ]


def sign_of_c3() -> list[Finding]:
    """Section 4.2.3 on c3: the sentence, and what the errors of Table 8 say of it."""
    as_stated = curves.rises(curve(1), "G22", "G1", "G21") and curves.rises(curve(0), "G21", "G1", "G22")
    reverse = curves.rises(curve(1), "G21", "G1", "G22") and curves.rises(curve(0), "G22", "G1", "G21")
    z = [1e3 * float(curve(0)[name][-1]) for name in ("G1", "G21")]
    pull = [float(curve(1)[name][-1]) for name in ("G1", "G21")]
    own, other = error_bounds_of("G21", "sinkage"), error_bounds_of("G22", "sinkage")
    how = "the reverse at all 61 slips" if reverse else "mixed"
    return [
        Finding(
            "Fig. 10",
            "with an increase in c3 z decreases and F_DP increases",
            "c3 = 0.2 for 0",
            f"{how}; at 0.6 z {z[1]:.1f} for {z[0]:.1f} mm, F_DP {pull[1]:.1f} for {pull[0]:.1f} N. "
            f"Table 8 agrees with that: its {own[0]:.2f} % of G21 suits c3 = 0.2 "
            f"({own[1]:.1f} to {own[2]:.1f} %), not −0.2 ({other[1]:.1f} to {other[2]:.1f} %)",
            as_stated,
        )
    ]


def two_contact_parameters() -> list[Finding]:
    """Section 4.2.3: c3 can be set to zero."""
    free = {"c1": (0.05, 0.95), "c2": (-0.6, 0.4)}
    found = np.max([curves.refit(GROUPS[name], free, c3=0.0).errors for name in ("G21", "G22")], axis=0)
    typical = errors()["G19"]
    return [
        Finding(
            "Table 8",
            "two of c1, c2 and c3 suffice",
            "c1, c2 refitted with c3 = 0; within 5 %",
            f"of G21 and G22 z {found[0]:.1f}, F_DP {found[1]:.1f}, M_DR {found[2]:.1f} % are left",
            bool(found.max() < 5),
        ),
        Finding(
            "Table 8",
            "c1 = 0.5, c2 = c3 = 0 will do, but F_DP should be noted",
            "F_DP changes most",
            f"z {typical[0]:.1f}, F_DP {typical[1]:.1f}, M_DR {typical[2]:.1f} %",
            bool(typical.argmax() == 1),
        ),
    ]


def words_of_table_9() -> list[Finding]:
    """Table 9 and the conclusions from it."""
    table = table_9()
    same = int((table["verdict"] == "reproduced").sum())
    influence = table.set_index(["parameter_group", "outcome"])["influence"]
    top = [influence.unstack()[name].idxmax() for name in ("sinkage", "drawbar_pull", "resistance_moment")]
    first, third = influence["P_I", "drawbar_pull"], influence["P_III", "drawbar_pull"]
    return [
        Finding("Table 9", "nine words", "classes whose bounds lie between our figures", f"{same} of 9", same == 9),
        Finding(
            "Table 9",
            "z goes with P_I, M_DR with P_II; P_III is nowhere the first",
            "largest influence",
            f"z {top[0]}, F_DP {top[1]}, M_DR {top[2]}",
            top == ["P_I", "P_II", "P_II"],
        ),
        Finding(
            "Table 9",
            "with P_II known, F_DP is mainly influenced by P_III",
            "more than by P_I",
            f"{third:.2f} for {first:.2f}",
            bool(third > first),
        ),
    ]
