"""The paper's claims, one by one, beside what a posterior measures at three noises.

Run it with ``python studies/paper/claims/run.py`` after ``identification`` and ``variants``; it rewrites the CSV files
of this folder and its README. With one of the names ``measures``, ``posteriors`` and ``page`` it does that part.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pandas as pd

HERE = Path(__file__).parent
PAPER = HERE.parent
sys.path[:0] = [str(HERE), str(PAPER), str(PAPER / "identification"), str(HERE.parents[1] / "support")]

import claim_measures as measures  # noqa: E402
import paper_statements  # noqa: E402
import sentences  # noqa: E402
import small_checks  # noqa: E402
from paper_data import LOAD, SLIPS  # noqa: E402
from readme import filled, markdown, minus  # noqa: E402

from bayesterra.models import M1, Soil, Wheel  # noqa: E402

MEASURES = {"groups": measures.groups, "directions": measures.directions, "mutual": measures.mutual}
ELSEWHERE = {
    **{name: PAPER / "identification" / f"{name}.csv" for name in (
        "comparison", "fits", "model-errors", "paths", "posteriors", "solver-fits", "solver-starts",
        "solver-without-shear", "without-shear",
    )},
    "variants-comparison": PAPER / "variants" / "comparison.csv",
    "sensitivity": PAPER / "sensitivity" / "index.csv",
}  # fmt: skip
"""Stored tables of other studies that measures are taken from."""
EXPONENTS = (0.5, 0.8, 1.1, 1.6)
DEPTH = 0.02
"""m, at which straight lines are judged by exponent."""


def straight_lines() -> pd.DataFrame:
    """Normal force by straight stresses (20) less that by (4), and by straight products (22) less that by (20), %.

    Without the shear stress, to which the same lines apply.
    """
    rows: list[dict[str, object]] = []
    for name, (soil, wheel, transition) in measures.SETTINGS.items():
        rig = measures.WHEELS[wheel]
        depths = np.asarray(M1(transition_slips=transition).sinkage(soil, rig, SLIPS, LOAD))
        for slip, depth in zip(SLIPS, depths, strict=True):
            rows.append({"case": name, "slip": slip, "N": soil.n0 + soil.n1 * slip, **_lines(soil, rig, slip, depth)})
    soil, wheel, _ = measures.SETTINGS["G1"]
    for n in EXPONENTS:
        one = Soil(**{**vars(soil), "n0": n, "n1": 0.0})
        rows.append({"case": "exponent", "slip": 0.2, "N": n, **_lines(one, measures.WHEELS[wheel], 0.2, DEPTH)})
    return pd.DataFrame(rows)


def _lines(soil: Soil, wheel: Wheel, slip: float, depth: float) -> dict[str, float]:
    entrance = float(np.arccos(1 - depth / wheel.radius))
    middle, leaving = (soil.c1 + soil.c2 * slip) * entrance, soil.c3 * entrance
    exponent = soil.n0 + soil.n1 * slip
    front, rear = np.linspace(middle, entrance, 2001), np.linspace(leaving, middle, 2001)
    turned = entrance - (rear - leaving) / (middle - leaving) * (entrance - middle)

    def stress(angle: np.ndarray) -> np.ndarray:
        return np.asarray(np.maximum(np.cos(angle) - np.cos(entrance), 0.0) ** exponent)

    def force(values: np.ndarray, angle: np.ndarray) -> float:
        return float(np.trapezoid(values, angle))

    exact = force(stress(front) * np.cos(front), front) + force(stress(turned) * np.cos(rear), rear)
    top = float(stress(np.array([middle]))[0])
    falls, rises = (entrance - front) / (entrance - middle), (rear - leaving) / (middle - leaving)
    lines = top * (force(falls * np.cos(front), front) + force(rises * np.cos(rear), rear))
    products = top * np.cos(middle) * (force(falls, front) + force(rises, rear))
    return {"lines": 100 * (lines / exact - 1), "products": 100 * (products / lines - 1)}


def stored() -> dict[str, pd.DataFrame]:
    """The result files of this folder, and those of others, by name."""
    own = {name: pd.read_csv(HERE / f"{name}.csv") for name in (*MEASURES, "straight-lines", "posterior-directions")}
    return {**own, **{name: pd.read_csv(path) for name, path in ELSEWHERE.items()}}


def blocks(kept: dict[str, pd.DataFrame], claims: pd.DataFrame) -> dict[str, str]:
    """The tables of the README."""
    rows = []
    for row in claims.to_dict("records"):
        figures = [row["full"], row["half"], row["quarter"]] if row["by_noise"] else [row["full"], "", ""]
        words = "; ".join(f"{v}" for v in row["verdict"].split("; "))
        rows.append([row["section"], row["claim"], row["shown"], row["threshold"], *figures, f"**{words}**"])
    head = ["section", "the paper claims", "shown by", "confirmed if", "full noise", "half", "quarter", "verdict"]
    counts = claims["verdict"].map(lambda v: v if ";" not in v else "it depends on the noise").value_counts()
    groups = kept["groups"].query("soil == 'G1'")
    said = groups.set_index(["output", "noise", "group"])[["unknown", "known"]].to_dict("index")
    nats = [
        [output, *(
            "{unknown:.2f} ({known:.2f})".format(**said[output, noise, group])
            for noise in (1.0, 0.25) for group in measures.GROUPS
        )]
        for output in ("sinkage", "drawbar_pull", "resistance_moment", "all")
    ]  # fmt: skip
    heads = [f"{group}, {name}" for name in ("full noise", "quarter") for group in measures.GROUPS]
    mutual = kept["mutual"].query("soil == 'G1'").pivot(index="pair", columns="noise", values="nats")
    shared = [[pair, *(f"{row[noise]:.2f}" for noise in measures.NOISES)] for pair, row in mutual.iterrows()]
    turned = kept["directions"].set_index(["soil", "noise", "group"])["contractions"]
    found = [
        [soil, *(str(turned[soil, noise, group]) for noise in (1.0, 0.25) for group in measures.GROUPS)]
        for soil in ("G1", "Wh11", "Wh32")
    ]
    made = {
        "count": f"{len(claims)} claims: " + ", ".join(f"{n} {word}" for word, n in counts.items()) + ".",
        "claims": markdown(head, rows),
        "nats": markdown(["output", *heads], nats, "|rrrrrr"),
        "mutual": markdown(["groups", "full noise", "half", "quarter"], shared, "|rrr"),
        "directions": markdown(["soil", *heads], found),
    }
    return {name: minus(block) for name, block in made.items()}


def page(text: str) -> str:
    """The README with its tables made anew."""
    kept = stored()
    return filled(text, blocks(kept, sentences.table(kept)))


def main(parts: list[str]) -> None:
    """Remake the parts named, by default all."""
    for part in parts or ["measures", "posteriors", "page"]:
        if part == "measures":
            for name, make in {**MEASURES, "straight-lines": straight_lines}.items():
                make().to_csv(HERE / f"{name}.csv", index=False, float_format="%.5g")
        elif part == "posteriors":
            made = measures.posterior_directions()
            made.to_csv(HERE / "posterior-directions.csv", index=False, float_format="%.5g")
        else:
            kept = stored()
            sentences.table(kept).to_csv(HERE / "claims.csv", index=False)
            paper_statements.write(small_checks.statements(kept["straight-lines"]), HERE)
            readme = HERE / "README.md"
            readme.write_text(page(readme.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
