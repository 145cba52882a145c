"""Statements of the paper that no other study checks: lug heights, λ_s, contact length, straight lines, lunar K_s."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from paper_data import LOAD, SLIPS, SOILS, TRANSITION
from paper_statements import Statement
from paper_wheels import WHEELS

from bayesterra.models import M1, Wheel

FRICTION = np.radians(31.9)
"""Measured (Table 2)."""
K_C, K_PHI = 15.6, 2407.4
"""kPa/m^(n-1) and kPa/m^n, HIT-LSS1 (Table 2)."""
PRINTED_HEIGHTS = {"Wh11": (14.81, 9.87, 12.34), "Wh31": (14.73, 9.18, 11.96)}
"""Minimum lug heights of Section 3.1, mm: without and with full friction, and half-way."""


def lug_heights(wheel: Wheel) -> tuple[float, float, float]:
    """Minimum lug heights by (10), mm: λ of 0, 1 and 0.5."""
    slope, sector = np.tan(np.pi / 4 - FRICTION / 2), 2 * np.pi / wheel.lug_count
    smooth = wheel.radius * (np.cos(sector) + np.sin(sector) * slope - 1)
    rough = wheel.radius * np.tan(sector / 2) * slope
    return 1e3 * float(smooth), 1e3 * float(rough), 1e3 * float(smooth + rough) / 2


def statements(lines: pd.DataFrame) -> list[Statement]:
    """Every statement; ``lines`` is the stored table of straight lines."""
    heights = {name: lug_heights(WHEELS[name]) for name in PRINTED_HEIGHTS}
    away = {name: np.abs(np.subtract(heights[name], known)) for name, known in PRINTED_HEIGHTS.items()}
    half = [heights[name][2] for name in heights]
    return [
        Statement(
            "Section 3.1", "lug heights by (10) at 31.9°, without friction and with full friction",
            "14.81, 9.87; 14.73, 9.18 mm", "; ".join(f"{a:.2f}, {b:.2f}" for a, b, _ in heights.values()) + " mm", "",
            max(a[:2].max() for a in away.values()) < 0.01,
        ),
        Statement(
            "Section 3.1", "with λ = 0.5 they are larger than 10 mm, and 10 mm lugs are marginal", "12.34, 11.96 mm",
            f"{half[0]:.2f}, {half[1]:.2f} mm; with full friction 10 mm suffice", "",
            max(a[2] for a in away.values()) < 0.01,
        ),
        _shearing_radii(),
        _contact(),
        _products(lines),
        _exponents(lines),
        Statement(
            "Section 7.2", "lunar K_s can be taken as k_φ = 820 kPa/m^N (within 2 % for the paper's wheels)", "820",
            ", ".join(f"{820 + 1.4 / b:.0f}" for b in (0.110, 0.165)) + " kPa with k_c/b",
            f"+{100 * 1.4 / 0.110 / 820:.1f} % at most", 1.4 / 0.110 / 820 < 0.02,
        ),
    ]  # fmt: skip


def _shearing_radii() -> Statement:
    """λ_s by (2) beside the printed ones."""
    printed = {0.015: 0.75, 0.010: 0.65}
    found = {}
    for name, wheel in WHEELS.items():
        slope, sector = np.tan(np.pi / 4 - FRICTION / 2), 2 * np.pi / wheel.lug_count
        turned = 1 + 1 / np.tan(sector / 2) / slope
        found[name] = 1 - 3 * (wheel.radius + wheel.lug_height) / (8 * turned * wheel.lug_height)
    off = max(abs(value - printed[WHEELS[name].lug_height]) for name, value in found.items())
    high, low = ([v for n, v in found.items() if n.endswith(end)] for end in ("1", "2"))
    text = f"{min(high):.3f} to {max(high):.3f}; {min(low):.3f} to {max(low):.3f}"
    return Statement(
        "Section 3.1", "λ_s by (2) is close to 0.75 (15 mm) and 0.65 (10 mm) (within 0.03)", "0.75; 0.65", text,
        f"{off:.3f} at most", off < 0.03,
    )  # fmt: skip


def _contact() -> Statement:
    """K_s with the contact length for b."""
    ratios: Mapping[str, list[float]] = {"shorter": [], "change": []}
    for name, soil in SOILS.items():
        wheel = WHEELS[name]
        depth = np.asarray(M1(transition_slips=TRANSITION).sinkage(soil, wheel, SLIPS, LOAD))
        length = np.sqrt(depth * (2 * wheel.radius - depth))
        ratios["shorter"] += list(length / wheel.width)
        ratios["change"] += list(100 * K_C * (1 / np.minimum(length, wheel.width) - 1 / wheel.width) / K_PHI)
    return Statement(
        "Section 2, (4)", "the contact is shorter than the wheel is wide, but k_c is so small that its width may stand"
        " for b (K_s within 20 %, what moves the sinkage by less than the 10 % granted)", "kc/b much smaller than kφ",
        f"contact {min(ratios['shorter']):.2f} to {max(ratios['shorter']):.2f} of the width; K_s up by"
        f" {min(ratios['change']):.1f} to {max(ratios['change']):.1f} %", "", max(ratios["change"]) < 20,
    )  # fmt: skip


def _products(lines: pd.DataFrame) -> Statement:
    away = lines.query("case != 'exponent'")["products"].abs()
    return Statement(
        "Section 6.1", "(22), (23) differ from (20), (21) by less than 1 % in most cases (F_N of G1 and Table 10)",
        "< 1 %", f"median {away.median():.2f} %, {(away < 1).sum()} of {len(away)} below 1 %", "",
        bool((away < 1).mean() > 0.5),
    )  # fmt: skip


def _exponents(lines: pd.DataFrame) -> Statement:
    table = lines.query("case == 'exponent'")
    return Statement(
        "Section 6.1", "straight lines are valid for exponents from 0.5 to 1.6 (F_N within the 10 % of the abstract)",
        "valid", ", ".join(f"N = {r['N']:g}: {r['lines']:+.0f} %" for r in table.to_dict("records")), "",
        bool((table["lines"].abs() < 10).all()),
        "a straight line is right near N = 1.3 only; another K_s, n0 and n1 make up for it",
    )  # fmt: skip
