"""The figure of the assumed rovers, and the tables of the README from the stored files."""

from __future__ import annotations

from io import BytesIO
from pathlib import Path

import numpy as np
import pandas as pd
from readme import markdown
from rover_drives import MODELS, drive

from bayesterra.prediction.rover import Rover
from bayesterra.report.figures import MARKS, POSTERIOR, new_figure, styled


@styled
def figure(rover: Rover, rovers: list[Rover]) -> bytes:
    """Slip and wheel loads over slope and tow force, with the spread of the assumed rovers."""
    drawn = new_figure(9.2, 6.0)
    axes = drawn.subplots(2, 2)
    colours = {"M2L": POSTERIOR, "M2": MARKS["IM1"].colour}
    for line, row in zip(axes, ("slope", "flat"), strict=True):
        for model in MODELS:
            one = drive(rover, model, row)
            line[0].plot(one.values, one.slip, "o-", markersize=3.5, color=colours[model], label=f"{model}")
            for axle, style in ((0, "--"), (1, "-")):
                name = f"{model}, {('front', 'rear')[axle]} wheel"
                line[1].plot(one.values, one.state.load[0, :, axle], style, color=colours[model], label=name)
        for other in rovers:
            one = drive(other, "M2L", row)
            line[0].plot(one.values, one.slip, color=POSTERIOR, alpha=0.18, linewidth=0.7, zorder=0)
        along = "slope α [°]" if row == "slope" else "tow force on the flat [N]"
        line[0].set(xlabel=along, ylabel="slip ratio $s$ [–]", ylim=(0, 0.8))
        line[1].set(xlabel=along, ylabel="load of a wheel [N]", ylim=(0, None))
    axes[0, 0].plot([], [], color=POSTERIOR, alpha=0.3, linewidth=0.7, label="M2L, other assumed rovers")
    axes[0, 0].legend(loc="upper left")
    axes[0, 1].legend(loc="lower left")
    buffer = BytesIO()
    drawn.savefig(buffer, format="png", dpi=130, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()


def blocks(folder: Path) -> dict[str, str]:
    """Every table by the name of its comment."""
    return {name: make(folder) for name, make in BLOCKS.items()}


def answer_block(folder: Path) -> str:
    """The answer, with its numbers."""
    verdicts = pd.read_csv(folder / "statements.csv")["verdict"].value_counts()
    bands = pd.read_csv(folder / "bands.csv").query("quantity == 'slip' and axle == 'rear'")
    at = {round(row["slope [deg]"]): row for row in bands[bands["tow [N]"] == 0].to_dict("records")}
    tops = pd.read_csv(folder / "greatest.csv").set_index(["quantity", "slips"])
    every, driven = tops.loc[("greatest_slope", "all")], tops.loc[("greatest_slope", "driven")]
    assumed = pd.read_csv(folder / "assumed-rovers.csv")
    base, rovers = assumed.iloc[0], assumed.iloc[1:]
    with_42, without = rovers["M2L_greatest_slope_deg"], rovers["M2_greatest_slope_deg"]
    phi = pd.read_csv(folder / "parameters.csv").set_index("parameter").loc["phi"]
    posterior = (
        f"**Answer.** Six published rows of one wheel leave φ open from {phi['hdi90_lo']:.0f} to",
        f"{phi['hdi90_hi']:.0f}° (90 %), but not the slope that a rover on four such wheels climbs:",
        f"{every['q50']:.1f}°, 90 % {every['q05']:.1f} to",
        f"{every['q95']:.1f}°, or {driven['q05']:.1f} to {driven['q95']:.1f}° at driven slips. What",
        "the rows fix is the pull, and a slope asks for no more. The rover slips by",
        f"{at[9]['q50']:.2f} at 9°, {at[12]['q50']:.2f} at 12° and {at[15]['q50']:.2f}",
        f"({at[15]['q05']:.2f} to {at[15]['q95']:.2f}) at 15°; {100 * at[18]['cannot']:.0f} % of draws do",
        "not climb 18°. The error of the model itself is not in these figures.",
    )
    printed = (
        f"Of what the paper says of its rover's motion, {verdicts.get('reproduced', 0)} statements are",
        f"reproduced, {verdicts.get('differs', 0)} not, and {verdicts.get('cannot be checked', 0)} cannot",
        "be checked, since it prints neither weight nor wheels of El-Dorado II. For an assumed rover Table",
        f"16's parameters give a slip of {base['M2L_slip_at_12_deg']:.2f} at 12° with (42)'s coefficients,",
        f"{base['M2_slip_at_12_deg']:.2f} without, and a greatest slope of",
        f"{base['M2L_greatest_slope_deg']:.1f}° ({base['M2_greatest_slope_deg']:.1f}° without); over",
        f"{len(rovers)} others that runs from {with_42.min():.0f} to {with_42.max():.0f}°",
        f"({without.min():.0f} to {without.max():.0f}°",
        "without).",
    )
    return " ".join(posterior) + "\n\n" + " ".join(printed)


def statements_block(folder: Path) -> str:
    """Every statement with its verdict."""
    found = pd.read_csv(folder / "statements.csv", keep_default_na=False)
    found["verdict"] = found["verdict"].where(found["verdict"] == "reproduced", "**" + found["verdict"] + "**")
    return markdown(["where", "the paper says", "printed", "ours", "difference", "verdict", "why"], found.to_numpy())


def climbs_block(folder: Path) -> str:
    """Slip of the small rover on every slope without a tow force, and the share of draws that cannot."""
    found = pd.read_csv(folder / "bands.csv")
    rows = []
    for tow in sorted(set(found["tow [N]"])):
        one = found[(found["tow [N]"] == tow) & (found["axle"] == "rear")]
        slips = one[one["quantity"] == "slip"].set_index("slope [deg]")
        depth = one[one["quantity"] == "sinkage"].set_index("slope [deg]")
        for slope, row in slips.iterrows():
            z = depth.loc[slope]
            known = np.isfinite(row["q50"]) and row["cannot"] < 0.5
            rows.append(
                [
                    f"{slope:.0f}",
                    f"{tow:.0f}",
                    f"{row['q50']:.2f} ({row['q05']:.2f}–{row['q95']:.2f})" if known else "–",
                    f"{z['q50']:.0f} ({z['q05']:.0f}–{z['q95']:.0f})" if known else "–",
                    f"{100 * row['cannot']:.0f}",
                    f"{100 * row['unanswered']:.0f}",
                ]
            )
    head = ["slope, °", "tow, N", "slip", "sinkage of the rear wheels, mm", "cannot, %", "no answer, %"]
    return markdown(head, rows)


def greatest_block(folder: Path) -> str:
    """Greatest slope and tow force of the small rover."""
    found = pd.read_csv(folder / "greatest.csv")
    rows = [
        [
            row["quantity"].replace("_", " "),
            "all to 0.95" if row["slips"] == "all" else "driven, to 0.6",
            *(f"{row[name]:.1f}" for name in ("q05", "q25", "q50", "q75", "q95")),
            "°" if row["unit"] == "deg" else "N",
        ]
        for _, row in found.iterrows()
    ]
    return markdown(["", "slips", "5 %", "25 %", "median", "75 %", "95 %", ""], rows)


BLOCKS = {"answer": answer_block, "statements": statements_block, "climbs": climbs_block, "greatest": greatest_block}
