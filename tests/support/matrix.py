"""Kinds of study by a covering design of pairs, and every command run on each: works, or says why not.

Everything goes through the command line and study files, so that the same cells can be run on other versions:
``python -m tests.support.matrix DIR`` prints the counts.
"""

from __future__ import annotations

import io
import re
import sys
import traceback
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import dataclass, replace
from functools import cache
from itertools import combinations, product
from pathlib import Path

import numpy as np
import pytest
import typer

from bayesterra.__main__ import main
from bayesterra.checking import calibration, holdout, loo, predictive_checks, short_runs
from bayesterra.checking.predictive import ReplicateOptions
from bayesterra.models import M2, Soil, Wheel
from bayesterra.pooling import degrees
from bayesterra.sampling import evidence, joint, sampler
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study

FACTORS: Mapping[str, Sequence[str]] = {
    "model": ("M2", "M1", "M3", "M2L", "own"),
    "drive": ("load", "sinkage", "both"),
    "noise": ("given", "estimated", "fraction", "student", "own"),
    "errors": ("none", "discrepancy", "ripple", "slip"),
    "prior": ("independent", "correlated"),
    "groups": ("none", "population", "separate"),
    "readings": ("numbers", "resolution", "limits"),
}
"""What studies differ in."""
Kind = Mapping[str, str]


@cache
def kinds() -> list[Kind]:
    """Kinds of study in which every pair of levels of two factors occurs."""
    left = [((a, x), (b, y)) for a, b in combinations(FACTORS, 2) for x in FACTORS[a] for y in FACTORS[b]]
    found: list[Kind] = []
    candidates = [dict(zip(FACTORS, levels, strict=True)) for levels in product(*FACTORS.values())]
    while left:
        counts = [sum(kind[a] == x and kind[b] == y for (a, x), (b, y) in left) for kind in candidates]
        best = candidates[int(np.argmax(counts))]
        left = [((a, x), (b, y)) for (a, x), (b, y) in left if (best[a], best[b]) != (x, y)]
        found.append(best)
    return found


def title(kind: Kind) -> str:
    """Its levels in a line."""
    return " ".join(kind.values())


WHEELS = {"Wh11": Wheel(0.135, 0.165, 0.015, 24, 0.75), "Wh32": Wheel(0.15735, 0.165, 0.010, 30, 0.65)}
SLIPS = (0.1, 0.25, 0.45)
SOIL = {"Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 268.0, "phi": 0.51, "K": 0.0101, "c1": 0.339, "c2": -0.017}
PRIORS = """[priors]
Ks = "2500 kPa"
n0 = 0.85
n1 = 1.06
c = "0.268 kPa"
c1 = 0.339
c2 = -0.017
phi = { dist = "norm", loc = "29 deg", scale = "3 deg", lower = "10 deg", upper = "50 deg" }
K = { dist = "norm", loc = "11 mm", scale = "3 mm", lower = "3 mm", upper = "40 mm" }
"""
LOAD_EFFECT = "cP1 = 0.0\ncP2 = 0.0\ncDP = 0.0\ncM = 0.0\n"
ROVER = """name = "made up"
weight = "320 N"
wheelbase = "0.8 m"
tow_height = "0.25 m"
wheel = "Wh32"

[centre_of_gravity]
height = "0.35 m"
ahead_of_rear_axle = "0.4 m"
"""


def write(kind: Kind, folder: Path) -> None:
    """Write the study file, its table and a rover into a new folder."""
    folder.mkdir(parents=True)
    (folder / "study.toml").write_text(_study(kind), encoding="utf-8")
    (folder / "measurements.csv").write_text(_table(kind), encoding="utf-8")
    (folder / "rover.toml").write_text(ROVER, encoding="utf-8")


def _study(kind: Kind) -> str:
    model = "bekker-janosi" if kind["model"] == "own" else kind["model"]
    head = f'title = "{title(kind)}"\nmodel = "{model}"\ndrive = "{kind["drive"]}"\n'
    if kind["drive"] == "both":
        head += 'load_range = ["40 N", "120 N"]\n'
    data = '[data]\nfile = "measurements.csv"\nslip_reference = "shearing"\nkind = "simulated"\n'
    options = '[model_options]\nmean_load = "80 N"\n' if kind["model"] == "M2L" else ""
    priors = PRIORS + (LOAD_EFFECT if kind["model"] == "M2L" else "")
    if kind["model"] == "own":
        priors = re.sub(r"(n1|c1|c2) = .*\n", "", priors)
    if kind["prior"] == "correlated":
        priors += '[priors.correlation]\n"phi, K" = 0.6\n'
    groups = {
        "none": "",
        "population": '[pooling]\nby = "wheel"\nshared = ["phi"]\nhierarchical = { K = {} }\n',
        "separate": '[pooling]\nby = "wheel"\nshared = ["phi"]\nseparate = ["K"]\n',
    }[kind["groups"]]
    sampling = "[sampling]\ntarget_ess = 100\nwalkers = 32\nmax_steps = 10\n"
    parts = [head, data, _wheels(), options, _noise(kind), _errors(kind), priors, groups, sampling]
    return "\n".join(part for part in parts if part)


def _wheels() -> str:
    tables = [
        f'[wheels.{name}]\nradius = "{1e3 * wheel.radius:g} mm"\nwidth = "{1e3 * wheel.width:g} mm"\n'
        f'lug_height = "{1e3 * wheel.lug_height:g} mm"\nlug_count = {wheel.lug_count}\n'
        f"shearing_radius_coefficient = {wheel.shearing_radius_coefficient:g}\n"
        for name, wheel in WHEELS.items()
    ]
    return "".join(tables)


SIZES = {"sinkage": "1 mm", "normal_force": "2 N", "drawbar_pull": "1 N", "resistance_moment": "0.3 N m"}
READ = {"load": ("sinkage",), "sinkage": ("normal_force",), "both": ("sinkage", "normal_force")}
"""Readings of a drive beside pull and moment."""


def _noise(kind: Kind) -> str:
    lines = {name: f'sd = "{SIZES[name]}"' for name in (*READ[kind["drive"]], *list(SIZES)[2:])}
    lines["drawbar_pull"] = {
        "given": 'sd = "1 N"',
        "estimated": 'estimate = { dist = "halfnorm", scale = "1 N", lower = "0.3 N" }',
        "fraction": 'fraction = 0.05, floor = "0.5 N"',
        "student": 'sd = "1 N", dof = 4',
        "own": 'sd = "1 N", residuals = "laplace"',
    }[kind["noise"]]
    if kind["readings"] == "resolution":
        lines["resistance_moment"] += ', resolution = "0.5 N m"'
    return "[noise]\n" + "".join(f"{name} = {{ {line} }}\n" for name, line in lines.items())


def _errors(kind: Kind) -> str:
    return {
        "none": "",
        "discrepancy": '[discrepancy]\ndrawbar_pull = { sd = "1 N", length = 0.3 }\n',
        "ripple": '[ripple]\ndrawbar_pull = { sd = "1 N", memory = 2 }\n',
        "slip": "[slip]\nsd = 0.005\n",
    }[kind["errors"]]


def _table(kind: Kind) -> str:
    names = [{"normal_force": "normal_force [N]", "sinkage": "sinkage [mm]"}[n] for n in READ[kind["drive"]]]
    names += ["load [N]"] if kind["drive"] == "load" else ["sinkage [mm]"] if kind["drive"] == "sinkage" else []
    lines = [",".join(["wheel", "slip", *names, "drawbar_pull [N]", "resistance_moment [N m]"])]
    for name, wheel in WHEELS.items():
        sinkage = M2().sinkage(Soil(**SOIL), wheel, np.array(SLIPS), 80.0)
        forces = M2().forces(Soil(**SOIL), wheel, np.array(SLIPS), sinkage)
        for i, slip in enumerate(SLIPS):
            known = {"sinkage [mm]": f"{1e3 * np.asarray(sinkage)[i]:.1f}"}
            known |= dict.fromkeys(("load [N]", "normal_force [N]"), "80")
            pull, moment = (
                f"{np.asarray(values)[i]:.1f}" for values in (forces.drawbar_pull, forces.resistance_moment)
            )
            if kind["readings"] == "limits" and i == 2:
                pull = f">{float(pull) - 1:.1f}"
            lines.append(",".join([name, f"{slip:g}", *(known[n] for n in names), pull, moment]))
    return "\n".join(lines) + "\n"


ONE = ("--workers", "1")
COMMANDS: Mapping[str, tuple[str, ...]] = {
    "check": ("check", "STUDY"),
    "run": ("run", "STUDY", "--out", "RESULT", "--quiet"),
    "run --prior-only": ("run", "STUDY", "--prior-only", "--out", "NEW", "--quiet"),
    "fit": ("fit", "STUDY"),
    "simulate": ("simulate", "STUDY", "--set", "phi=29 deg", "--set", "K=11 mm", "--out", "NEW"),
    "identify": ("identify", "RESULT", *ONE, "--quiet", "--out", "NEW"),
    "identify --prior-only": ("identify", "STUDY", "--prior-only", "--quiet"),
    "calibrate": ("calibrate", "STUDY", "-n", "2", *ONE, "--quiet", "--out", "NEW"),
    "holdout": ("holdout", "STUDY", "--by", "wheel", *ONE, "--quiet", "--out", "NEW"),
    "follow": ("follow", "STUDY", "--data", "TABLE", "--particles", "128", "--quiet", "--out", "NEW"),
    "predict": ("predict", "RESULT", "--slip", "0.2,0.4", "--load", "80 N", "--out", "NEW"),
    "predict --rover": ("predict", "RESULT", "--rover", "ROVER", "--slope", "0,5", "--out", "NEW"),
    "compare": ("compare", "RESULT", "RESULT", "--out", "NEW"),
    "export": ("export", "RESULT", "--tables", "csv", "--methods", "--to", "json", "--out", "NEW"),
    "design": ("design", "RESULT", "--slip", "0.3", "--load", "80 N", *ONE, "--quiet", "--out", "NEW"),
}
"""Commands that read studies or results; a result is what ``run`` wrote."""
GROUPED = {"design": ("--group", "Wh11")}
"""What a command must be told of groups."""
FEW_REPLICATES = ReplicateOptions(number=20, pool=512, draws=100, local=(256, 256))
LITTLE = AdaptationOptions(particles=128, sweeps=1, components=4, refinements=(2,), more=(), shores=2, climbs=10)


@dataclass(frozen=True)
class Cell:
    """How a command ended on a kind of study: ``works``, ``refused`` or ``traceback``, its last line, and all of it."""

    word: str
    said: str = ""
    printed: str = ""


def cells(kind: Kind, folder: Path, commands: Sequence[str] = tuple(COMMANDS)) -> Iterator[tuple[str, Cell]]:
    """Run commands on a kind of study, in a folder that is made for it."""
    write(kind, folder / "study")
    places = {
        "STUDY": folder / "study", "RESULT": folder / "result",
        "TABLE": folder / "study" / "measurements.csv", "ROVER": folder / "study" / "rover.toml",
    }  # fmt: skip
    for number, command in enumerate(commands):
        paths = {**places, "NEW": folder / f"made-{number}"}
        if "RESULT" in COMMANDS[command] and command != "run" and not places["RESULT"].exists():
            yield command, Cell("no result")
            continue
        words = (*COMMANDS[command], *(GROUPED.get(command, ()) if kind["groups"] != "none" else ()))
        yield command, ended([str(paths.get(word, word)) for word in words])


def ended(words: Sequence[str]) -> Cell:
    """How a command line ended."""
    out, error = io.StringIO(), io.StringIO()
    try:
        with redirect_stdout(out), redirect_stderr(error):
            code = main(list(words))
    except SystemExit as exit_:
        code = exit_.code if isinstance(exit_.code, int) else 1
    except Exception:
        return Cell("traceback", traceback.format_exc().strip().splitlines()[-1])
    said = " ".join(error.getvalue().split()) or " ".join(out.getvalue().split())[-300:]
    if "Traceback" in said:
        return Cell("traceback", said)
    return Cell("works" if code in (0, 3) else "refused", said, out.getvalue() + error.getvalue())


@contextmanager
def quick() -> Iterator[None]:
    """Samplings that adapt next to nothing: cells ask whether a command works, not whether it converged."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(sampler, "AdaptationOptions", lambda: LITTLE)
        joint_plan = joint.PoolingOptions
        plan = joint_plan((2, 4), LITTLE)
        patch.setattr(joint, "PoolingOptions", lambda *of: joint_plan(*of) if of else plan)
        little = {"WALKERS": 32, "WARM_UPS": (2, 4), "SWEEPS": (8,), "OUTER": 256, "INNER": 16}
        for name, value in little.items():
            patch.setattr(degrees, name, value)
        patch.setattr(joint, "ROUND_SWEEPS", 10)
        patch.setattr(calibration, "FEWEST", 2)
        patch.setattr(short_runs, "enough", lambda _: True)
        patch.setattr(predictive_checks, "ReplicateOptions", lambda: FEW_REPLICATES)
        patch.setattr(loo, "FINAL_DRAWS", (512, 1024))
        patch.setattr(evidence, "REFINEMENT", replace(evidence.REFINEMENT, particles=128, refinements=(1,)))
        patch.setattr(calibration, "short_runs", _little_runs, raising=False)
        patch.setattr(holdout, "refits", _little_runs, raising=False)
        yield


def _little_runs(study: Study) -> short_runs.ShortRuns:
    """Short runs of next to nothing."""
    short = SamplingOptions(target_ess=100, walkers=32, max_steps=10)
    if study.pooling is None:
        return short_runs.ShortRuns(short=short, adaptation=LITTLE)
    return short_runs.ShortGroupRuns(short=short, adaptation=LITTLE, warm_ups=(2, 4))


def table(folder: Path) -> None:
    """Print every cell that does not work, and the counts of each command."""
    counts: dict[str, Counter[str]] = {command: Counter() for command in COMMANDS}
    with quick():
        for number, kind in enumerate(kinds()):
            for command, cell in cells(kind, folder / f"{number:02d}"):
                counts[command][cell.word] += 1
                if cell.word in ("refused", "traceback"):
                    typer.echo(f"{title(kind)} | {command} | {cell.word}: {cell.said}")
                    sys.stdout.flush()
    for command, words in counts.items():
        typer.echo(f"{command}: {dict(words)}")
    typer.echo(dict(sum(counts.values(), Counter[str]())))


if __name__ == "__main__":
    table(Path(sys.argv[1]))
