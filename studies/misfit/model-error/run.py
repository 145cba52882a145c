"""Whether a stated discrepancy makes the intervals of a wrong model right; likewise errors in slip, ripple.

``python studies/misfit/model-error/run.py`` makes the tables and the figure beside it, in about 20 minutes of
processor time. Cases that are in ``fits.csv`` are not run again: delete the tables to begin anew. With
``--figure`` it only summarises and draws.

Everything is simulated: readings of M1 on the six wheels and soils of Ding et al. 2015, Tables 1 and 10,
fitted with M2 (parts ``model`` and, with a third of the noise, ``precise``); readings of M2 itself with
planted errors of slip (``slip``) or with ripple (``ripple``).
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng

import bayesterra as bt
from bayesterra.checking.folds import predictives
from bayesterra.checking.short_runs import ShortRuns
from bayesterra.checking.validation import trades
from bayesterra.likelihood.posterior import posterior
from bayesterra.models import M1, M2
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from paper_wheels import MEAN_COHESION, SOILS, WHEELS  # noqa: E402
from stored import done  # noqa: E402

SLIPS = np.array([0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.5, 0.6])
BETWEEN, BEYOND = (0.125, 0.225, 0.325, 0.45, 0.55), (0.7, 0.8)
LOAD = 80.0
NOISE = {"sinkage": 0.0002, "drawbar_pull": 0.25, "resistance_moment": 0.05}
SEEDS = (1,)
"""One table of each wheel; more are more entries."""
FIT = ShortRuns(
    short=SamplingOptions(target_ess=600, walkers=64, max_steps=120),
    long=SamplingOptions(target_ess=600, walkers=64, max_steps=6000),
)
SLOWER = replace(FIT, short=replace(FIT.short, max_steps=900))
"""Where sizes are estimated the chains forget more slowly."""
DRAWS = 800

SIZES = {"sinkage": 0.001, "drawbar_pull": 2.0, "resistance_moment": 0.4}
"""Stated sizes of the discrepancy: about a tenth of the largest readings, set before any fit was made."""
LENGTH = 0.3
SLIP_SD, MEMORY = 0.02, 3.0
RIPPLE = {"drawbar_pull": 1.0, "resistance_moment": 0.2}
"""Planted errors of slip, and ripple with its memory in rows."""


def truth(name: str) -> dict[str, float]:
    """True values of a wheel's soil, SI; c and φ are the means of Table 10."""
    return {**SOILS[name], **MEAN_COHESION}


def _discrepancy(factor: float, *, estimated: bool = False) -> dict[str, Any]:
    def size(sd: float) -> Any:
        return {"estimate": {"dist": "halfnorm", "scale": sd}} if estimated else sd

    return {name: {"sd": size(factor * sd), "length": LENGTH} for name, sd in SIZES.items()}


ARMS: dict[str, dict[str, dict[str, Any]]] = {
    "model": {
        "ignored": {},
        "stated": {"discrepancy": _discrepancy(1.0)},
        "a third": {"discrepancy": _discrepancy(1 / 3)},
        "estimated": {"discrepancy": _discrepancy(1.0, estimated=True)},
    },
    "precise": {"ignored": {}, "stated": {"discrepancy": _discrepancy(1.0)}},
    "ripple": {
        "ignored": {},
        "modelled": {"ripple": {name: {"sd": sd, "memory": MEMORY} for name, sd in RIPPLE.items()}},
    },
    "slip": {"ignored": {}, "modelled": {"slip": {"sd": SLIP_SD}}},
}
"""What the fit is told, by part and arm."""


OF_M1 = ("model", "precise")
"""Parts whose readings M1 makes."""


def noise(part: str) -> dict[str, float]:
    """Noise of the readings: a third of the usual one in the part ``precise``."""
    return {name: sd / 3 if part == "precise" else sd for name, sd in NOISE.items()}


def table(part: str, name: str, rng: Generator) -> pd.DataFrame:
    """Readings in the fit, and new ones (use 0) at the same slips, between them and beyond."""
    read = np.concatenate([SLIPS, SLIPS, BETWEEN, BEYOND])
    true = read + (SLIP_SD * rng.standard_normal(len(read)) if part == "slip" else 0.0)
    model, soil = (M1() if part in OF_M1 else M2()), bt.Soil(**truth(name))
    true = np.clip(true, 0.001, 0.98)
    z = np.asarray(model.sinkage(soil, WHEELS[name], true, LOAD))
    forces = model.forces(soil, WHEELS[name], true, z)
    values = {
        "sinkage": z,
        "drawbar_pull": np.asarray(forces.drawbar_pull),
        "resistance_moment": np.asarray(forces.resistance_moment),
    }
    for channel, sd in noise(part).items():
        values[channel] = values[channel] + sd * rng.standard_normal(len(read))
    if part == "ripple":
        rows = np.arange(len(SLIPS))
        root = np.linalg.cholesky(np.exp(-np.abs(rows[:, None] - rows) / MEMORY))
        for channel, sd in RIPPLE.items():
            values[channel][rows] += sd * root @ rng.standard_normal(len(rows))
            values[channel][len(rows) :] += sd * rng.standard_normal(len(read) - len(rows))
    fitted = np.arange(len(read)) < len(SLIPS)
    runs = ["fitted" if one else f"new {i}" for i, one in enumerate(fitted)]
    units = {f"{channel} [{CHANNELS[channel].dimension}]": v for channel, v in values.items()}
    return pd.DataFrame({"run": runs, "slip": read, "load [N]": LOAD, **units, "use": fitted.astype(int)})


def simulated(part: str, name: str, seed: int, told: dict[str, Any]) -> Study:
    """The study of a case, told what an arm is told."""
    place = (("model", "slip", "ripple", "precise").index(part), list(WHEELS).index(name), seed)
    return bt.Study(
        table(part, name, default_rng(SeedSequence(place))),
        {name: WHEELS[name]},
        slip_reference="shearing",
        title=f"{name}, {part} (simulated)",
        model="M2",
        noise=noise(part),
        kind="simulated",
        source=f"studies/misfit/model-error/run.py: {'M1' if part in OF_M1 else 'M2'}, Ding et al. 2015, Table 10",
        **told,
    )


def where(study: Study) -> np.ndarray[Any, Any]:
    """Of every row that is predicted: at a fitted slip, between them or beyond."""
    slip = study.observations.slip[~study.observations.use]
    return np.where(slip > SLIPS.max(), "beyond", np.where(np.isin(slip, SLIPS), "fitted slips", "between"))


def cases() -> Iterator[tuple[str, str, int, str]]:
    """Part, wheel, seed and arm; those that cost most come last."""
    found = [
        (part, name, seed, arm) for seed in SEEDS for part, arms in ARMS.items() for name in WHEELS for arm in arms
    ]
    yield from sorted(found, key=lambda case: (case[2], case[3] == "estimated"))


def analysed(part: str, name: str, seed: int, arm: str) -> dict[str, pd.DataFrame]:
    """Fit a case; score predictions and parameters."""
    study, started = simulated(part, name, seed, ARMS[part][arm]), time.process_time()
    fitted = (SLOWER if arm == "estimated" else FIT)(study, SeedSequence((seed, 7)))
    seconds = time.process_time() - started
    draws = fitted.draws[:: max(1, -(-len(fitted.draws) // DRAWS))]
    head = {"part": part, "wheel": name, "seed": seed, "arm": arm}
    how = {"converged": fitted.converged, "ess": fitted.ess, "r_hat": fitted.r_hat}
    fit = {**head, **how, "seconds": seconds}
    return {
        "predictions": pd.DataFrame(_predicted(study, draws, head)),
        "parameters": pd.DataFrame(_known(study, fitted.draws, head)),
        "trades": pd.DataFrame(_traded(study, draws, head)),
        "fits": pd.DataFrame([fit]),  # last: it says that a case is done
    }


def _predicted(study: Study, draws: Any, head: dict[str, Any]) -> Iterator[dict[str, Any]]:
    target, left = posterior(study), ~study.observations.use
    found = predictives(study, target, draws, left, default_rng(1))
    places = where(study)
    for row, index in enumerate(np.flatnonzero(left)):
        for column, channel in enumerate(found.channels):
            law, y = found.law(row, column), float(study.observations.values[channel][index])
            scale = CHANNELS[channel].scale
            if law is None:
                yield {**head, "where": places[row], "channel": channel, "pit": np.nan}
                continue
            low, q25, q75, high = law.quantiles(np.array([0.05, 0.25, 0.75, 0.95]))
            yield {
                **head,
                "where": places[row],
                "slip": study.observations.slip[index],
                "channel": channel,
                "observed": y / scale,
                "pit": float(law.cdf(np.array([y]))[0]),
                "crps": law.crps(y) / scale,
                "width50": (q75 - q25) / scale,
                "width90": (high - low) / scale,
            }


def _known(study: Study, draws: Any, head: dict[str, Any]) -> Iterator[dict[str, Any]]:
    true = truth(str(head["wheel"]))
    for i, name in enumerate(study.prior.names):
        low, q25, middle, q75, high = np.quantile(draws[:, i], [0.05, 0.25, 0.5, 0.75, 0.95])
        value, scale = true.get(name, np.nan), PARAMETERS[name].scale
        yield {
            **head,
            "parameter": name,
            "truth": value / scale,
            "median": middle / scale,
            "width90": (high - low) / scale,
            "covered50": bool(q25 <= value <= q75) if name in true else None,
            "covered90": bool(low <= value <= high) if name in true else None,
            "off": (np.mean(draws[:, i]) - value) / np.std(draws[:, i]),
        }


def _traded(study: Study, draws: Any, head: dict[str, Any]) -> Iterator[dict[str, Any]]:
    """How much of level and tilt of the discrepancy goes with the parameters."""
    if not study.errors.discrepancy:
        return
    target, slip = posterior(study), np.linspace(SLIPS.min(), SLIPS.max(), 23)
    soil, noise = target.prior.soil_values(draws), target.noise_values(draws)
    curves = target.likelihood.beyond(soil, noise, str(head["wheel"]), slip, default_rng(2))
    for column, channel in enumerate(target.likelihood.channels):
        for one in trades(target.names, draws, slip, curves[:, :, column]):
            yield {
                **head, "channel": channel, "shape": one.shape, "share": one.share,
                "most_with": one.parameter, "correlation": one.correlation,
            }  # fmt: skip


def stored(name: str) -> pd.DataFrame:
    """A table that was written before; empty where there is none."""
    path = HERE / f"{name}.csv"
    return pd.read_csv(path) if path.is_file() else pd.DataFrame()


def summaries() -> dict[str, pd.DataFrame]:
    """Coverage of predictions and of parameters over all wheels and seeds."""
    made = stored("predictions").assign(
        inside50=lambda t: (t["pit"] - 0.5).abs() <= 0.25, inside90=lambda t: (t["pit"] - 0.5).abs() <= 0.45
    )
    keys = ["part", "arm", "where", "channel"]
    predictive = made.groupby(keys, sort=False).agg(
        readings=("pit", "size"), covered50=("inside50", "mean"), covered90=("inside90", "mean"),
        crps=("crps", "mean"), width90=("width90", "mean"),
    )  # fmt: skip
    known = stored("parameters").dropna(subset=["truth"])
    known = known.assign(**{n: known[n].astype(str) == "True" for n in ("covered50", "covered90")})
    every = known.assign(parameter="all eight")
    parameters = pd.concat([known, every]).groupby(["part", "arm", "parameter"], sort=False).agg(
        intervals=("truth", "size"), covered50=("covered50", "mean"), covered90=("covered90", "mean"),
        width90=("width90", "mean"), farthest=("off", lambda off: off.abs().max()),
    )  # fmt: skip
    return {"predictive": predictive.reset_index(), "coverage": parameters.reset_index()}


def figure() -> None:
    """Draw one wheel's pull without and with a discrepancy, and how far all soils are off."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(9.6, 3.3), layout="constrained")
    axes = drawn.subplots(1, 3, width_ratios=(1, 1, 1.1))
    for ax, arm in zip(axes, ("ignored", "stated"), strict=False):
        _bands(ax, arm)
    _distances(axes[2])
    drawn.savefig(HERE / "model-error.png", dpi=150)


def _bands(ax: Any, arm: str, name: str = "Wh21", channel: str = "drawbar_pull") -> None:
    from bayesterra.checking.predictive import predict_curves

    study = simulated("model", name, 1, ARMS["model"][arm])
    draws = FIT(study, SeedSequence((1, 7))).draws[:DRAWS]
    curves = predict_curves(study, posterior(study), draws, default_rng(3))[0]
    column = curves.outcomes.index(channel)
    low, q25, middle, q75, high = np.quantile(curves.readings[:, :, column], [0.05, 0.25, 0.5, 0.75, 0.95], axis=0)
    ax.fill_between(curves.slip, low, high, color="#0072B2", alpha=0.2, linewidth=0)
    ax.fill_between(curves.slip, q25, q75, color="#0072B2", alpha=0.35, linewidth=0)
    ax.plot(curves.slip, middle, color="#0072B2")
    rows = study.observations
    for use, face in ((True, "#111111"), (False, "white")):
        chosen = (rows.use == use) & (rows.slip <= curves.slip.max())
        ax.plot(rows.slip[chosen], rows.values[channel][chosen], "o", color="#111111",
                markerfacecolor=face, markersize=4)  # fmt: skip
    ax.set(xlabel="slip ratio", ylabel="drawbar pull [N]", title=f"{name}, M2: discrepancy {arm}")


def _distances(ax: Any) -> None:
    """How far the soil's true values lie from the middle of the posteriors of all wheels."""
    table = stored("parameters")
    names = {"c": "c", "phi": "φ", "K": "K", "c1": "$c_1$", "c2": "$c_2$"}
    ax.axvspan(-1.64, 1.64, color="#E5E5E5")
    for shift, (arm, colour) in zip((-0.15, 0.15), {"ignored": "#D55E00", "stated": "#0072B2"}.items(), strict=True):
        rows = table[(table["part"] == "model") & (table["arm"] == arm) & table["parameter"].isin(names)]
        places = [list(names).index(name) + shift for name in rows["parameter"]]
        ax.plot(rows["off"], places, "o", color=colour, markersize=4, label=arm)
    ax.set_yticks(range(len(names)), names.values())
    ax.set(xlabel="middle less truth [sd]", ylim=(len(names) - 0.5, -0.5),
           title="soils of six wheels")  # fmt: skip
    ax.legend(frameon=False, fontsize=8)


def main() -> None:
    """Run what is missing, then summarise and draw."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--figure", action="store_true", help="only summarise and draw")
    given = parser.parse_args()
    made = done(HERE / "fits.csv", "part", "wheel", "seed", "arm")
    for case in cases() if not given.figure else ():
        if case in made:
            continue
        for name, rows in analysed(*case).items():
            if rows.empty:
                continue
            before = stored(name)
            pd.concat([before, rows] if len(before) else [rows]).to_csv(
                HERE / f"{name}.csv", index=False, float_format="%.5g"
            )
        print(*case, flush=True)
    for name, summary in summaries().items():
        summary.to_csv(HERE / f"{name}.csv", index=False, float_format="%.4g")
    figure()


if __name__ == "__main__":
    main()
