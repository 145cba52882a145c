"""Is yesterday's posterior today's prior? Two halves of a wheel test one after the other, and both at once.

Run it with ``python studies/streaming/sequential/run.py``; it takes some minutes and rewrites the tables, the
figures, the draws that the quick test weighs, and ``second-half``, the study of the second half with its
prior as numbers.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.parameters import PARAMETERS
from bayesterra.report.figures import MARKS, POSTERIOR, PRIOR, label, new_figure, png, styled
from bayesterra.study.canonical import write_study

HERE = Path(__file__).parent
FIRST, SECOND = (0.1, 0.3, 0.6), (0.2, 0.4)
"""Slips of the rows that are measured first, and then."""
KEPT = "planetary"
"""The prior set of the study as stored; its second half is kept, with draws for the quick test."""
WAYS = ("first half", "all rows", "joint prior", "independent prior")
"""Results: of the first half, of all rows at once, and of the second half after the first, with the
correlations of its posterior and without."""
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
DRAWS = 4000


def study(slips: tuple[float, ...], priors: dict[str, Any], title: str) -> bt.Study:
    """Some rows of ``studies/hit-wh32``, through M2 for speed."""
    shipped = bt.load_study(HERE.parents[1] / "hit-wh32")
    rows = shipped.observations
    table = pd.DataFrame(
        {
            "slip": rows.slip,
            "load [N]": rows.load,
            "sinkage [m]": rows.values["sinkage"],
            "drawbar_pull [N]": rows.values["drawbar_pull"],
            "resistance_moment [N m]": rows.values["resistance_moment"],
            "use": np.isin(rows.slip, slips).astype(int),
        }
    )
    return bt.Study(
        table,
        dict(shipped.wheels),
        title=title,
        kind="digitised",
        source=shipped.source,
        slip_reference="shearing",
        model="M2",
        noise={"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3},
        priors=priors,
        sampling={"target_ess": 4000},
    )


def runs(chosen: str) -> dict[str, bt.Result]:
    """The results of all ways with a prior set."""
    first = bt.run(study(FIRST, {"set": chosen}, "Wh32, first half"))
    everything = bt.run(study((*FIRST, *SECOND), {"set": chosen}, "Wh32, all rows"))
    second = study(SECOND, {"from": [{"result": first}]}, "Wh32, second half after the first")
    alone = study(SECOND, dict(second.prior.entries), "Wh32, second half, correlations left out")
    results = (first, everything, bt.run(second), bt.run(alone))
    return dict(zip(WAYS, results, strict=True))


def quantiles(draws: FloatArray, weights: FloatArray | None = None) -> FloatArray:
    """Quantiles (levels, d) of draws (n, d), weighted or not."""
    if weights is None:
        return np.quantile(draws, LEVELS, axis=0)
    found = []
    for column in draws.T:
        order = np.argsort(column)
        found.append(np.interp(LEVELS, np.cumsum(weights[order]) / weights.sum(), column[order]))
    return np.array(found).T


def compared(chosen: str, results: dict[str, bt.Result]) -> pd.DataFrame:
    """Quantiles of every way (field units), and how far they are from those of all rows, in their sd."""
    whole = results[WAYS[1]].values()
    rows = []
    for way, result in results.items():
        draws = result.values()
        shifts = (quantiles(draws) - quantiles(whole)) / whole.std(axis=0)
        for i, name in enumerate(result.names):
            scale = PARAMETERS[name].scale
            known = {f"q{100 * q:02.0f}": v / scale for q, v in zip(LEVELS, quantiles(draws)[:, i], strict=True)}
            away = {f"shift{100 * q:02.0f}": v for q, v in zip(LEVELS, shifts[:, i], strict=True)}
            ratio = draws[:, i].std() / whole[:, i].std()
            rows.append({"set": chosen, "way": way, "parameter": name, **known, **away, "sd_ratio": ratio})
    return pd.DataFrame(rows)


def judged(chosen: str, results: dict[str, bt.Result]) -> pd.DataFrame:
    """Per way: convergence, the largest shifts, and the log evidence of all rows in one step or two."""
    table = compared(chosen, results).set_index("way")
    shifts = [f"shift{100 * q:02.0f}" for q in LEVELS]
    evidence = {way: float(result.record["evidence"]["log_z"]) for way, result in results.items()}
    before = {WAYS[0]: np.nan, WAYS[1]: 0.0, WAYS[2]: evidence[WAYS[0]], WAYS[3]: evidence[WAYS[0]]}
    joint = results[WAYS[2]].study.taken[0].fidelity
    rows = [
        {
            "set": chosen,
            "way": way,
            "converged": result.converged,
            "largest_median_shift": table.loc[[way], "shift50"].abs().max(),
            "largest_shift": table.loc[[way], shifts].abs().to_numpy().max(),
            "log_evidence_of_all_rows": evidence[way] + before[way],
            "copula_off_by": joint.difference if way == WAYS[2] else np.nan,
            "its_noise": joint.noise if way == WAYS[2] else np.nan,
        }
        for way, result in results.items()
    ]
    return pd.DataFrame(rows)


def weighed(second: bt.Study, draws: FloatArray) -> FloatArray:
    """Shifts (levels, d), in sd, of all rows' posterior when another prior stands for the first half.

    Draws (n, d) of all rows' posterior are weighed by that prior over the posterior of the first half:
    nothing is sampled anew.
    """
    first = bt.posterior(study(FIRST, {"set": KEPT}, "Wh32, first half"))
    before = first.log_density(draws)
    draws, before = draws[np.isfinite(before)], before[np.isfinite(before)]  # rounded when stored
    log_weights = second.prior.log_density(draws) - before
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray((quantiles(draws, weights) - quantiles(draws)) / draws.std(axis=0))


@styled
def figure(table: pd.DataFrame) -> bytes:
    """Intervals of every parameter by every way, one panel each."""
    colours = dict(zip(WAYS, (PRIOR, "#111111", POSTERIOR, MARKS["IM1"].colour), strict=True))
    names = list(dict.fromkeys(table["parameter"]))
    axes = new_figure(7.6, 3.6).subplots(2, 4)
    for ax, name in zip(axes.ravel(), names, strict=True):
        for place, way in enumerate(WAYS):
            row = table[(table["way"] == way) & (table["parameter"] == name)].iloc[0]
            ax.plot([row["q05"], row["q95"]], [-place] * 2, color=colours[way], lw=1.2)
            ax.plot([row["q25"], row["q75"]], [-place] * 2, color=colours[way], lw=4.0, solid_capstyle="butt")
            ax.plot(row["q50"], -place, "o", color="white", mec=colours[way], ms=4.5)
        first = name in (names[0], names[4])
        ax.set_yticks([-place for place in range(len(WAYS))], WAYS if first else [""] * len(WAYS))
        ax.set_xlabel(label(PARAMETERS[name]))
        ax.set_ylim(-3.6, 0.6)
    return png(axes, 1520)


def main(sets: list[str]) -> None:
    """Rewrite what is stored, or do the same for other prior sets."""
    for chosen in sets or [KEPT]:
        results = runs(chosen)
        table, verdict = compared(chosen, results), judged(chosen, results)
        table.to_csv(HERE / f"quantiles-{chosen}.csv", index=False, float_format="%.4g")
        verdict.to_csv(HERE / f"ways-{chosen}.csv", index=False, float_format="%.4g")
        (HERE / f"{chosen}.png").write_bytes(figure(table))
        if chosen == KEPT:
            (HERE / "second-half").mkdir(exist_ok=True)
            write_study(results[WAYS[2]].study, HERE / "second-half")
            draws = results[WAYS[1]].values()
            spaced = draws[:: -(-len(draws) // DRAWS)]
            np.savez_compressed(HERE / "all-rows.npz", draws=spaced.astype(np.float32))
        print(verdict.to_string(index=False))


if __name__ == "__main__":
    main(sys.argv[1:])
