"""A rover's posterior row by row: against the batch, time per row, and planted changes of soil.

Run ``python studies/streaming/run.py``, or parts of it: ``at_once``, ``one_by_one``, ``changed``, ``same``,
``figures``. All readings are simulated. Tables are gone on with where they end: remove them to begin anew.
One process; about four, eight, three, three and no minutes on a core of its own.
"""

from __future__ import annotations

import runpy
import sys
import time
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.ticker import FuncFormatter
from numpy.random import Generator, SeedSequence, default_rng

import bayesterra as bt
from bayesterra.arrays import FloatArray, IntArray
from bayesterra.follow.page import bands_over_rows
from bayesterra.likelihood.posterior import draw_cut_prior
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.report.figures import new_figure, styled, white_png
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.evidence import evidence
from bayesterra.sampling.sampler import Samples, sample, thin
from bayesterra.stats.mixture import weighted_quantiles
from bayesterra.study.observations import Observations

HERE = Path(__file__).parent
sys.path.append(str(HERE.parent / "support"))

from paper_wheels import SOILS, WHEELS  # noqa: E402
from stored import append, done  # noqa: E402

WHEEL, TRUTH = WHEELS["Wh32"], dict(SOILS["Wh32"])
"""Wheel Wh32 and its soil, Ding et al. 2015, Tables 1 and 10."""
NOISE = {"sinkage": 0.0005, "drawbar_pull": 0.5, "resistance_moment": 0.15}
SLIPS, LOADS = (0.05, 0.6), (60.0, 100.0)
ROWS = 500
SEEDS = (1, 2, 3)
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
PLAN = AdaptationOptions(particles=512, components=16, refinements=(4, 4, 8), shores=20)
"""Half the adaptation of ``bt.run``: with 500 rows it takes most of the time."""
PAPER_MS = {"drawbar_pull": 21.916, "normal_force": 17.842, "resistance_moment": 29.209}
"""Computing times of IM3 for wheel Wh32, ms, Ding et al. 2015, Table 15, force by force."""


def drive(rows: int, rng: Generator, model: str = "M1") -> bt.Study:
    """A drive of so many rows at slips and loads drawn at random; its readings are yet to be made."""
    table = pd.DataFrame(
        {
            "slip": rng.uniform(*SLIPS, rows),
            "load [N]": rng.uniform(*LOADS, rows),
            **{f"{name} [{CHANNELS[name].dimension}]": np.full(rows, 1e-3) for name in NOISE},
        }
    )
    return bt.Study(table, {"Wh32": WHEEL}, **_tables(model))


def driven(plan: bt.Study, truth: dict[str, float], seed: int) -> bt.Study:
    """The same drive with simulated readings of a soil."""
    table = bt.simulate(plan, truth, seed=seed)
    return bt.Study(table, {"Wh32": WHEEL}, **_tables(plan.model.name))


def read_off(plan: bt.Study, truth: dict[str, float], seed: int) -> Observations:
    """The same, as rows that no study has checked: wheels that hardly sink may read sinkages below zero."""
    table = bt.simulate(plan, truth, seed=seed)
    columns = {name: f"{name} [{CHANNELS[name].unit}]" for name in NOISE}
    values = {name: table[column].to_numpy() * CHANNELS[name].scale for name, column in columns.items()}
    return plan.with_data(values).observations


def _tables(model: str) -> dict[str, Any]:
    tables: dict[str, Any] = {"model": model, "noise": NOISE, "slip_reference": "shearing"}
    return {**tables, "kind": "simulated", "source": "studies/streaming/run.py", "title": "Wh32, simulated"}


def row(rows: Observations, index: int) -> Observations:
    """One row of a table."""
    return rows.take(np.arange(len(rows)) == index)


def streamed(
    study: bt.Study, order: Sequence[int] | IntArray, **options: Any
) -> tuple[bt.Stream, list[dict[str, Any]]]:
    """All rows of a study in some order, one by one; the stream, and what every row took."""
    stream, steps = bt.Stream(study, **options), []
    for index in order:
        wall, cpu = time.perf_counter(), time.process_time()
        update = stream.learn(row(study.observations, index))
        steps.append(
            {
                "row": update.row,
                "cpu_ms": 1e3 * (time.process_time() - cpu),
                "wall_ms": 1e3 * (time.perf_counter() - wall),
                "sweeps": sum(event.sweeps for event in update.rejuvenations),
                "steps": len(update.rejuvenations),
                "correlation": max((event.correlation for event in update.rejuvenations), default=np.nan),
                "effective": update.effective,
                "log_statistic": update.log_statistic,
                **{
                    f"{name}_{key}": value / PARAMETERS[name].scale
                    for name, column in zip(update.names, update.quantiles.T, strict=True)
                    for key, value in zip(("q05", "q50", "q95"), column, strict=True)
                },
            }
        )
        if update.rejuvenated:
            print(steps[-1]["row"], round(steps[-1]["cpu_ms"]), steps[-1]["sweeps"], flush=True)
    return stream, steps


def quantiles_with_errors(x: FloatArray, weights: FloatArray, effective: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Quantiles (k, d) of weighted draws (n, d), and their Monte Carlo errors at effective numbers (d,)."""
    found = weighted_quantiles(x, weights, QUANTILES)
    errors = np.empty_like(found)
    for i, p in enumerate(QUANTILES):
        for j in range(x.shape[1]):
            half = np.sqrt(p * (1 - p) / effective[j])
            ends = weighted_quantiles(x[:, j : j + 1], weights, (max(0.0, p - half), min(1.0, p + half)))
            errors[i, j] = 0.5 * (ends[1, 0] - ends[0, 0])
    return found, errors


def batch(study: bt.Study) -> tuple[Samples, FloatArray, float, float]:
    """The sampler of ``bt.run`` on all rows at once: draws (n, d), log evidence and its error."""
    density = bt.posterior(study)
    sampling, weighing = SeedSequence(1).spawn(2)
    samples = sample(density, study.sampling, sampling, adaptation=PLAN)
    proposals = [one.proposal for one in samples.adaptations]
    found = evidence(samples.target.densities, proposals, default_rng(weighing))
    return samples, thin(samples.chains).flat, found.log_z, found.error


def at_once() -> None:
    """All 500 rows at once: quantiles and evidence; and the time of a point estimate."""
    study = driven(drive(ROWS, default_rng(2015)), TRUTH, seed=5)
    point_estimates(study)
    samples, draws, log_z, error = batch(study)
    diagnosis = samples.diagnosis
    size = np.asarray(np.minimum(diagnosis.ess_bulk, diagnosis.ess_tail))
    found = quantiles_with_errors(draws, np.full(len(draws), 1 / len(draws)), size)
    told = {"run": "batch", "log_evidence": log_z, "error": error, "effective": size.min()}
    _write("batch.csv", _quantiles("batch", samples.names, found))
    _write("batch-evidence.csv", [{**told, "converged": diagnosis.converged, "alarm": None}])


def one_by_one() -> None:
    """The same rows one by one, with several seeds and in another order; and through M2, for the time."""
    study = driven(drive(ROWS, default_rng(2015)), TRUTH, seed=5)
    runs = [(f"seed {seed}", seed, np.arange(ROWS)) for seed in SEEDS]
    runs += [("another order", 4, default_rng(4).permutation(ROWS))]
    for name, seed, order in runs:
        if (name,) in done(HERE / "streams.csv", "run"):
            continue
        stream, steps = streamed(study, order, seed=seed)
        if seed == SEEDS[0]:
            _write("rows.csv", steps)
        cloud = stream.cloud
        size = np.full(len(stream.names), cloud.effective)
        alarm = stream.alarm.row if stream.alarm else None
        told = {"run": name, "log_evidence": stream.log_evidence, "error": stream.log_evidence_error}
        _append("streams-evidence.csv", [{**told, "effective": cloud.effective, "alarm": alarm}])
        _append("streams.csv", _quantiles(name, stream.names, quantiles_with_errors(cloud.x, cloud.weights, size)))
    linear = driven(drive(ROWS, default_rng(2015), "M2"), TRUTH, seed=5)
    _, steps = streamed(linear, np.arange(ROWS), seed=1)
    kept = ("row", "cpu_ms", "wall_ms", "sweeps", "steps", "effective")
    _write("rows-M2.csv", [{name: step[name] for name in kept} for step in steps])


def _quantiles(run: str, names: tuple[str, ...], found: tuple[FloatArray, FloatArray]) -> list[dict[str, Any]]:
    """Every quantile of every parameter and its error, in field units."""
    return [
        {
            "run": run,
            "parameter": name,
            "unit": PARAMETERS[name].unit,
            "probability": p,
            "value": found[0][i, j] / PARAMETERS[name].scale,
            "error": found[1][i, j] / PARAMETERS[name].scale,
        }
        for j, name in enumerate(names)
        for i, p in enumerate(QUANTILES)
    ]


def _write(file: str, rows: list[dict[str, Any]]) -> None:
    pd.DataFrame(rows).to_csv(HERE / file, index=False, float_format="%.7g")


def point_estimates(study: bt.Study, repeats: int = 3) -> None:
    """Computing time of IM3, a point estimate, on six rows as in the paper and on all of them."""
    found = []
    for rows in (6, ROWS):
        part = study.with_rows(study.observations.take(np.arange(ROWS) < rows))
        bt.fit(part, methods=("IM3",))
        for _ in range(repeats):
            cpu = time.process_time()
            bt.fit(part, methods=("IM3",))
            found.append({"method": "IM3", "rows": rows, "cpu_ms": 1e3 * (time.process_time() - cpu)})
    pd.DataFrame(found).to_csv(HERE / "point-estimates.csv", index=False, float_format="%.5g")
    print(found, flush=True)


CHANGES: dict[str, dict[str, float]] = {
    "phi - 5 deg": {"phi": TRUTH["phi"] - float(np.radians(5.0))},
    "phi - 1 deg": {"phi": TRUTH["phi"] - float(np.radians(1.0))},
    "Ks x 0.3": {"Ks": 0.3 * TRUTH["Ks"]},
    "Ks x 0.8": {"Ks": 0.8 * TRUTH["Ks"]},
    "c + 1 kPa": {"c": TRUTH["c"] + 1000.0},
    "c + 0.2 kPa": {"c": TRUTH["c"] + 200.0},
    "one wild reading": {},
    "none": {},
}
"""True soil after the change."""
WILD = {"drawbar_pull": 8.0}
"""Shift of one reading of the row at which else the soil changes, N: sixteen standard deviations."""
SOILS, DRIVES = 40, 5
LEARNED, UNCHANGED_ROWS = 20, 50
"""Unchanged soils: first soils, drives on soils like each, rows before these and in each."""
RUNS = {"M2": 8, "M1": 4}
BEFORE, AFTER = 30, 40
"""Rows on the first soil, and on the second one, at most."""
PARTICLES = 300


def changed() -> None:
    """Delays until a change of soil is found; goes on where the table ends."""
    for run in range(max(RUNS.values())):
        for model in (model for model, runs in RUNS.items() if run < runs):
            if (model, run) not in done(HERE / "delays.csv", "model", "run"):
                _append("delays.csv", delays(model, run))


def same() -> None:
    """False alarms on soils that stay the same; goes on where the table ends."""
    for soil in range(SOILS):
        if (soil,) not in done(HERE / "unchanged.csv", "soil"):
            _append("unchanged.csv", unchanged(soil))


def _append(file: str, rows: list[dict[str, Any]]) -> None:
    append(HERE / file, pd.DataFrame(rows), "%.7g")


def unchanged(soil: int) -> list[dict[str, Any]]:
    """Drives on soils that stay the same: the greatest evidence for a change that never was.

    A first soil is drawn from the prior and driven on for some rows; every further soil is drawn from the
    posterior of these rows, so that it is one that could have made them.
    """
    rng = default_rng((1, soil))
    plan = drive(LEARNED + UNCHANGED_ROWS, rng, "M2")
    density = bt.posterior(plan)
    first = draw_cut_prior(density, 1, rng, batch=64).x[0]
    rows = read_off(plan, dict(zip(density.names, map(float, first), strict=True)), seed=soil)
    learned = bt.Stream(plan, seed=soil, particles=PARTICLES)
    for index in range(LEARNED):
        learned.learn(row(rows, index))
    table = []
    for number in range(DRIVES):
        stream, found = deepcopy(learned), [learned.watch.candidates.log_statistic]
        possible = learned.cloud.weights * (density.reasons(learned.cloud.x) == 0)
        x = learned.cloud.x[rng.choice(PARTICLES, p=possible / possible.sum())]
        same = read_off(plan, dict(zip(density.names, map(float, x), strict=True)), seed=int(rng.integers(2**31)))
        for index in range(LEARNED, LEARNED + UNCHANGED_ROWS):
            found.append(stream.learn(row(same, index)).log_statistic)
            if stream.alarm:
                break
        alarm = stream.alarm.row if stream.alarm else None
        table.append({"soil": soil, "drive": number, "log_statistic": max(found), "alarm": alarm})
    print("unchanged", soil, [round(one["log_statistic"], 1) for one in table], flush=True)
    return table


def delays(model: str, run: int) -> list[dict[str, Any]]:
    """One drive on Table 10's soil for Wh32, which then goes on in every way of ``CHANGES``."""
    plan = drive(BEFORE + AFTER, default_rng((2, run)), model)
    rows = driven(plan, TRUTH, seed=run).observations
    stream = bt.Stream(plan, seed=run, particles=PARTICLES)
    for index in range(BEFORE):
        stream.learn(row(rows, index))
    return [_delay(stream, plan, rows, name, run) for name in CHANGES]


def _delay(stream: bt.Stream, plan: bt.Study, before: Observations, name: str, run: int) -> dict[str, Any]:
    early = stream.alarm is not None
    going, alarm, index = deepcopy(stream), stream.alarm, BEFORE
    after = driven(plan, {**TRUTH, **CHANGES[name]}, seed=run).observations if CHANGES[name] else before
    while alarm is None and index < BEFORE + AFTER:
        read = row(after, index)
        if name == "one wild reading" and index == BEFORE:
            wild = {channel: read.values[channel] + shift for channel, shift in WILD.items()}
            read = replace(read, values={**read.values, **wild})
        alarm = going.learn(read).alarm
        index += 1
    found = {"model": plan.model.name, "change": name, "run": run, "false": early}
    if alarm is None or early:
        return {**found, "delay": None, "off": None}
    print(found, alarm.row - BEFORE, flush=True)
    return {**found, "delay": alarm.row - BEFORE, "off": alarm.since - BEFORE - 1}


def figures() -> None:
    """Draw the time per row, and what is known after each row, and write the README, from the tables."""
    rows = pd.read_csv(HERE / "rows.csv")
    units = {name: PARAMETERS[name].unit for name in TRUTH}
    renamed = {
        f"{name}_{key}": f"{name}_{key} [{unit}]"
        for name, unit in units.items()
        if unit != "-"
        for key in ("q05", "q50", "q95")
    }
    (HERE / "bands.png").write_bytes(white_png(bands_over_rows(rows.rename(columns=renamed), TRUTH), 150))
    (HERE / "time.png").write_bytes(time_png({"M1": rows, "M2": pd.read_csv(HERE / "rows-M2.csv")}))
    runpy.run_path(str(HERE / "words.py"))["write"]()


@styled
def time_png(rows: dict[str, pd.DataFrame]) -> bytes:
    """Computing time of every row; filled marks, rows that asked for moves of the particles."""
    estimates = pd.read_csv(HERE / "point-estimates.csv").groupby("rows")["cpu_ms"].median()
    figure = new_figure(6.4, 3.6)
    ax = figure.subplots()
    for colour, (model, table) in zip(("#0072B2", "#E69F00"), rows.items(), strict=True):
        moved = table["sweeps"] > 0
        ax.plot(table["row"][~moved], table["cpu_ms"][~moved], ".", color=colour, markersize=2.5, alpha=0.6)
        ax.plot(table["row"][moved], table["cpu_ms"][moved], "o", color=colour, markersize=4, label=f"{model}, moved")
        ax.plot([], [], ".", color=colour, label=f"{model}, weighed only")
    lines = {"IM3, paper": (sum(PAPER_MS.values()), "--"), "IM3, ours, 500 rows": (estimates[ROWS], ":")}
    for label, (level, style) in lines.items():
        ax.axhline(level, color="#333333", linewidth=0.9, linestyle=style, label=label)
    ax.set(xscale="log", yscale="log", xlabel="row", ylabel="computing time [ms]")
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    figure.legend(loc="outside lower center", ncols=3)
    buffer = BytesIO()
    figure.savefig(buffer, format="png", dpi=150, facecolor="white", metadata={"Software": None})
    return buffer.getvalue()


def main(names: Sequence[str]) -> None:
    """Do the parts that are named, or all."""
    parts = {"at_once": at_once, "one_by_one": one_by_one, "changed": changed, "same": same, "figures": figures}
    for name in names or parts:
        parts[name]()


if __name__ == "__main__":
    main(sys.argv[1:])
