"""The statements of Section 4.1, Table 4 and Figs. 5 and 6, each put as a test."""

from __future__ import annotations

import numpy as np
import section4_curves as curves
from section4_curves import BEARING, CONTACT, FIG_5, NAMES, SHEARING, curve, part
from section4_findings import Finding
from section4_tables import table_4


def table_4_values() -> list[Finding]:
    """The eight shares of Table 4 and the sentence about them."""
    table = table_4()
    exact, off = int((table["verdict"] == "reproduced").sum()), table["difference"]
    high, whose = max(zip(table["ours_percent"], table["wheel"], strict=True))
    return [
        Finding(
            "Table 4",
            "F_Nτ/F_N of G1 at slip 0.6 for six wheels, 35 to 150 N",
            "to the last digit",
            f"{exact} of {len(table)}; the others by {off.min():+.1f} to {off.max():+.1f} points",
            exact == len(table),
        ),
        Finding(
            "Table 4",
            "F_Nτ/F_N is less than 18 % for all wheels and loads",
            "",
            f"at most {high:.2f} % ({whose})",
            high < 18,
        ),
    ]


def shares_of_normal_force() -> list[Finding]:
    """Fig. 5(a): F_Nτ/F_N over slip."""
    share = dict(zip(NAMES, 100 * curves.shares().shear_share, strict=True))
    top, name = max((float(each.max()), name) for name, each in share.items())
    rising = all((np.diff(each) > 0).all() for each in share.values())
    ratio = top / (100 - top)
    return [
        Finding("Fig. 5(a)", "F_Nτ/F_N increases with slip", "all 22 groups, Wh31, 80 N", "in every one", rising),
        Finding(
            "Fig. 5(a)",
            "F_Nτ/F_N is less than 24 % to slip 0.6",
            "all 22 groups, Wh31, 80 N",
            f"at most {top:.1f} % ({name})",
            top < 24,
        ),
        Finding(
            "Fig. 5(a)",
            "F_Nτ is much smaller than F_Nσ, which mainly sustains the load",
            "below a third",
            f"F_Nτ/F_Nσ at most {ratio:.2f} ({name})",
            ratio < 1 / 3,
        ),
    ]


def shear_below_normal() -> list[Finding]:
    """Section 4.1: greatest shear stress below greatest normal stress."""
    found = curves.stresses(NAMES)
    ratio = (found.shear.max(axis=2) / found.normal.max(axis=2))[:, 0]
    text = f"τ_max/σ_max from {ratio.min():.2f} to {ratio.max():.2f} ({NAMES[int(ratio.argmax())]})"
    return [
        Finding(
            "Section 4.1",
            "the shear stress is obviously lower than the normal stress",
            "maxima at slip 0.2, all groups",
            text,
            bool(ratio.max() < 1),
        )
    ]


def resistance_below_thrust() -> list[Finding]:
    """Fig. 5(b, c): F_DPσ below F_DPτ."""
    resistance, thrust = part("F_DPsigma"), part("F_DPtau")
    above = {name: resistance[name] >= thrust[name] for name in FIG_5}
    slips = {name: curves.FINE.slips[each].max() for name, each in above.items() if each.any()}
    text = "; ".join(
        f"in all but {name} to slip {slip:.2g} (F_DP at slip 0: {curve(1)[name][0]:.1f} N)"
        for name, slip in slips.items()
    )
    return [
        Finding(
            "Fig. 5(b, c)",
            "F_DPσ is lower than F_DPτ",
            "the six groups drawn, slips 0 to 0.6",
            text or "at every slip",
            not slips,
        )
    ]


def shapes_over_slip() -> list[Finding]:
    """Fig. 5(b, c): a straight F_DPσ and an exponential F_DPτ."""
    line = {name: curves.off_line(part("F_DPsigma")[name]) for name in FIG_5}
    bend = {name: curves.off_exponential(part("F_DPtau")[name]) for name in FIG_5}
    straight = min(curves.off_line(part("F_DPtau")[name]) for name in FIG_5)
    return [
        Finding(
            "Fig. 5(b)",
            "F_DPσ increases linearly with slip",
            "6 % of its maximum off a straight line",
            f"{min(line.values()):.1f} to {max(line.values()):.1f} % off",
            max(line.values()) < 6,
        ),
        Finding(
            "Fig. 5(c)",
            "F_DPτ increases exponentially, by 1 − exp(−j/K)",
            "6 % of its maximum off a + b (1 − exp(−s/d))",
            f"{min(bend.values()):.1f} to {max(bend.values()):.1f} % off; a line {straight:.0f} % or more",
            max(bend.values()) < 6,
        ),
    ]


def what_moves_the_parts() -> list[Finding]:
    """Fig. 5(b, c): which parameters the parts of the pull answer to."""
    most = {kind: curves.largest_change("F_DPtau", kind) for kind in (BEARING, SHEARING, CONTACT)}
    each = {kind: curves.change_per_change("F_DPsigma", kind) for kind in (BEARING, SHEARING, CONTACT)}
    return [
        Finding(
            "Fig. 5(c)",
            "F_DPτ is influenced by P_II only",
            "error (16) by P_I and P_III below 1 %",
            f"P_I up to {most[BEARING]:.1f} %, P_III {most[CONTACT]:.1f} %, P_II {most[SHEARING]:.0f} %",
            max(most[BEARING], most[CONTACT]) < 1,
        ),
        Finding(
            "Fig. 5(b)",
            "F_DPσ is primarily influenced by P_I and P_III",
            "relative change, as for Table 9",
            f"P_I {each[BEARING]:.2f}, P_III {each[CONTACT]:.2f}, P_II {each[SHEARING]:.2f}",
            min(each[BEARING], each[CONTACT]) > each[SHEARING],
        ),
    ]


def moduli() -> list[Finding]:
    """Fig. 6: the share of k_c in K_s."""

    def share(cohesive: float, frictional: float, width: float) -> float:
        return 100 * cohesive / width / (cohesive / width + frictional)

    narrow, wide, moon = (share(15.6, 2407.4, 0.1), share(15.6, 2407.4, 0.5), share(1.4, 820.0, 0.1))
    return [
        Finding(
            "Fig. 6",
            "(k_c/b)/K_s of HIT-LSS1 falls from 6.08 % at 0.1 m to 1.28 % at 0.5 m",
            "to 0.01 points",
            f"{narrow:.3f} and {wide:.3f} %",
            abs(narrow - 6.08) < 0.01 and abs(wide - 1.28) < 0.01,
        ),
        Finding(
            "Fig. 6",
            "(k_c/b)/K_s of lunar soil is less than 1.68 % above 0.1 m",
            "",
            f"{moon:.3f} % at 0.1 m",
            moon < 1.68,
        ),
    ]
