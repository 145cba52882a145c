"""From logs to rows and readings: what `reduce` makes of raw records and of simulated logs whose means are known.

Usage: python run.py [PART ...] (default: all). Parts: drives (CMU wheel, beside its authors' averages),
simulated (200 logs with lug ripple and noise that hangs together), plates (Cullinan's plates, and the CMU
wheel pushed down: `bayesterra reduce`, then `bayesterra soiltest`). Each writes its CSV beside this file.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import SeedSequence, default_rng

from bayesterra.reduce.log import LOGGED
from bayesterra.reduce.reduction import reduce_logs
from bayesterra.study.units import known_column

HERE = Path(__file__).parent
MEASURED = HERE / "measured"
sys.path.append(str(HERE.parent / "support"))

from readme import filled, markdown, minus  # noqa: E402
from simulated_drives import LUGS, RADIUS, STATES, simulated_drive  # noqa: E402

LOGS, SEED = 200, 22
CMU: dict[str, Any] = {"radius": "58 mm", "lugs": 24}
FIXED = (70.51, 75.51)
"""Window (s) for all trials: the authors' own, 70 to 75 s after the start of a record that is lost."""
AREA = {"cullinan": 0.018, "insertion": 0.0046}
"""m². Cullinan: the plate's, as published. Insertion: that of a wheel of 63 mm in its tips and 50 mm width over
the chord at 20 mm of depth: an assumption that makes one number of an area which grows with depth."""


def drives() -> pd.DataFrame:
    """Every drive: the authors' averages, those of a fixed window, and what `reduce` makes of it."""
    rows = []
    for trial in pd.read_csv(MEASURED / "drive_trials.csv").to_dict("records"):
        path = MEASURED / trial["file"]
        log = pd.read_parquet(path)
        fixed = log[log["time [s]"].between(*FIXED)].mean()
        reduction = reduce_logs([path], **CMU)
        (window,) = reduction.kept
        speeds = {name: 1e3 * fixed[f"{name} [m/s]"] for name in ("travel_speed", "rim_speed")}
        rows.append({
            "log": path.stem.removeprefix("drive_"),
            **{f"{name}_authors": trial[f"{name} [mm/s]"] for name in speeds},
            **{f"{name}_fixed": value for name, value in speeds.items()},
            **{f"{name}_reduce": 1e3 * window.mean[name] for name in speeds},
            "sinkage_authors": trial["sinkage [mm]"], "sinkage_fixed": fixed["sinkage [mm]"],
            "sinkage_reduce": 1e3 * window.mean["sinkage"], "sinkage_sd": 1e3 * window.sd["sinkage"],
            "slip_authors": trial["slip_ratio"], "slip_reduce": window.mean["slip"], "slip_sd": window.sd["slip"],
            "from": window.start, "to": window.end, "periods": window.blocks,
            "authors_from": trial["window_start [s]"], "authors_to": trial["window_end [s]"],
            "rejected": " | ".join(dict.fromkeys(each.rejected for each in reduction.windows if each.rejected)),
        })  # fmt: skip
    return pd.DataFrame(rows)


def simulated(logs: int = LOGS, only: int = LOGS) -> pd.DataFrame:
    """Simulated logs, or the first of them: true means of states beside mean, error and sd/√n of their windows."""
    rows = []
    with TemporaryDirectory() as folder:
        for number, seed in enumerate(SeedSequence(SEED).spawn(logs)[:only]):
            drive, path = simulated_drive(default_rng(seed)), Path(folder, "simulated.parquet")
            drive.table.to_parquet(path)
            windows = {window.start: window for window in reduce_logs([path], radius=f"{RADIUS} m", lugs=LUGS).kept}
            time, edge = drive.table["time [s]"], 3.0
            for state, (slip, seconds) in enumerate(STATES):
                inside = [w for w in windows.values() if edge - 1 <= w.start < edge + seconds - 1]
                edge += seconds
                for window in inside:
                    samples = drive.table[time.between(window.start, window.end)]
                    for column, means in drive.truth.items():
                        name, scale = known_column(column, LOGGED)[0], LOGGED[known_column(column, LOGGED)[0]].scale
                        rows.append({
                            "log": number, "slip": slip, "channel": name, "truth": means[state],
                            "mean": window.mean[name] / scale, "sd": window.sd[name] / scale,
                            "naive": samples[column].std() / np.sqrt(len(samples)),
                            "from": window.start, "periods": window.blocks,
                        })  # fmt: skip
    return pd.DataFrame(rows)


def plates() -> pd.DataFrame:
    """Posteriors of the soil tests of reduced records, by the command line alone; readings stay beside this file."""
    zero = ["--zero", str(MEASURED / "zero_20220114T2225.parquet")]
    insertions = [str(MEASURED / f"insertion_large_box_grouser_{i}.parquet") for i in (1, 2, 3)]
    logs = {"cullinan": [str(MEASURED / "cullinan_plates.parquet")], "insertion": [*insertions, *zero]}
    posteriors = []
    for name, records in logs.items():
        with TemporaryDirectory() as folder:
            diameter, table = f"{2e3 * np.sqrt(AREA[name] / np.pi):.1f} mm", Path(folder, f"{name}.csv")
            _bayesterra("reduce", *records, "--plate", diameter, "--out", str(table))
            shutil.copy(table, HERE)
            _bayesterra("soiltest", str(HERE / f"{name}.toml"), "--out", str(Path(folder, "result")), "--quiet")
            summary = pd.read_csv(Path(folder, "result", "summary.csv"))
            verdicts = pd.read_csv(Path(folder, "result", "identifiability.csv"))[["parameter", "verdict"]]
            posteriors.append(summary.merge(verdicts, how="left").assign(test=name))
    kept = ["test", "parameter", "unit", "median", "hdi90_lo", "hdi90_hi", "r_hat", "verdict"]
    return pd.concat(posteriors)[kept]


def _bayesterra(*arguments: str) -> None:
    done = subprocess.run([sys.executable, "-m", "bayesterra", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(f"bayesterra {' '.join(arguments)}: {done.stderr}")


def loads_at_depth() -> pd.DataFrame:
    """Loads (N) of the insertions at four depths: by the authors' own way, and from the readings of `reduce`."""
    trials, readings = pd.read_csv(MEASURED / "insertion_trials.csv"), pd.read_csv(HERE / "insertion.csv")
    rows = []
    for name, curve in readings.groupby("test"):
        trial = trials[trials["file"] == name].iloc[0]
        for depth in (10, 20, 30, 40):
            load = float(np.interp(depth, curve["sinkage [mm]"], curve["force [N]"]))
            rows.append((str(name).removesuffix(".parquet"), depth, trial[f"load_at_{depth}mm [N]"], load))
    return pd.DataFrame(rows, columns=["test", "depth", "authors", "reduce"])


def inside(table: pd.DataFrame, sd: str, errors: float = 2.0) -> float:
    """Share of means within some stated errors of the truth."""
    return float((np.abs(table["mean"] - table["truth"]) <= errors * table[sd]).mean())


def figures(table: pd.DataFrame) -> pd.Series:
    """Of means of simulated logs: shares inside two errors, and deviations over errors (root mean square; right: 1)."""
    off = table["mean"] - table["truth"]
    shares = {"inside two stated errors": inside(table, "sd"), "inside two sd/√n": inside(table, "naive")}
    over = {f"off / {word}": float(np.sqrt(((off / table[sd]) ** 2).mean())) for word, sd in
            (("stated error", "sd"), ("(sd/√n)", "naive"))}  # fmt: skip
    return pd.Series({"means": len(table), **shares, **over})


def tables() -> dict[str, str]:
    """Tables of the README, from the stored files."""
    d, s, p = (pd.read_csv(HERE / f"{name}.csv") for name in ("drives", "simulated", "plates"))
    by_drive = [
        (
            f"{row['slip_authors']:.3f}",
            f"{row['slip_reduce']:.4f} ± {row['slip_sd']:.4f}",
            f"{row['sinkage_authors']:.2f}",
            f"{row['sinkage_reduce']:.2f} ± {row['sinkage_sd']:.2f}",
            f"{row['from']:.1f}–{row['to']:.1f}",
            *(
                f"{row[f'{name}_fixed'] - row[f'{name}_authors']:.4f}"
                for name in ("travel_speed", "rim_speed", "sinkage")
            ),
        )
        for _, row in d.sort_values("slip_authors").iterrows()
    ]
    groups = {"all": s, **dict(iter(s.groupby("channel"))), **{f"slip {k:g}": v for k, v in s.groupby("slip")}}
    by_group = [
        (name, f"{f.iloc[0]:.0f}", *(f"{100 * x:.1f} %" for x in f.iloc[1:3]), *(f"{x:.2f}" for x in f.iloc[3:]))
        for name, f in ((name, figures(group)) for name, group in groups.items())
    ]
    soil = [
        (
            row["test"],
            row["parameter"],
            row["unit"],
            *(f"{row[name]:.3g}" for name in ("median", "hdi90_lo", "hdi90_hi")),
        )
        for _, row in p.fillna("").iterrows()
    ]
    soil = [(*cells, verdict) for cells, verdict in zip(soil, p["verdict"].fillna(""), strict=True)]
    loads = loads_at_depth().pivot(index="test", columns="depth")
    by_load = [
        (name, *(f"{row['authors', depth]:.1f}, {row['reduce', depth]:.1f}" for depth in (10, 20, 30, 40)))
        for name, row in loads.iterrows()
    ]
    drive_head = (
        *("slip, authors", "slip, reduce", "sinkage, authors [mm]", "sinkage, reduce [mm]", "window of reduce [s]"),
        *("fixed − authors: travel speed [mm/s]", "rim speed [mm/s]", "sinkage [mm]"),
    )
    group_head = ("", "means", "inside two stated errors", "inside two sd/√n", "off / stated error", "off / (sd/√n)")
    soil_head = ("test", "parameter", "unit", "median", "90 % HDI from", "to", "verdict")
    return {
        "drives": minus(markdown(drive_head, by_drive, "rrrrrrrr")),
        "simulated": markdown(group_head, by_group, "|rrrrr"),
        "loads": markdown(
            ("insertion: authors, reduce", *(f"{depth} mm" for depth in (10, 20, 30, 40))), by_load, "|rrrr"
        ),
        "plates": minus(markdown(soil_head, soil, "|||rrr|")),
    }


PARTS = {"drives": drives, "simulated": simulated, "plates": plates}


def main(parts: list[str]) -> None:
    """Make the parts named, or all, and the tables of the README anew."""
    for name in parts or PARTS:
        PARTS[name]().to_csv(HERE / f"{name}.csv", index=False, float_format="%.7g")
    path = HERE / "README.md"
    path.write_text(filled(path.read_text(encoding="utf-8"), tables()), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
