"""Kills over the life of a run: as it ends, as another one replaces it, and as that one is gone on with.

Every kill falls on a call that changes a file (see ``points.py``). Beside the runs lie a user's own files
under names that look like the package's; they must stand to the end, byte by byte.
"""

from __future__ import annotations

import os
import shutil
import signal
import time
from collections.abc import Callable
from contextlib import redirect_stdout
from dataclasses import dataclass
from functools import partial
from io import StringIO
from pathlib import Path

from points import KINDS, arm, counted
from short_runs import put, quick_study
from trials import RIGHT, Process, Table, command, content, emptied, everything, rng_of, sums_hold

from bayesterra.runtime import folders
from bayesterra.runtime.ownership import WORK

KILLS = dict(list(KINDS.items())[:2])
LATE = "the end of a run; then another seed over it, killed, and gone on with"
OVER = "the end of a run in place of another that a kill left untidy"
OTHERS = {
    "notes.txt": "mine",
    "out.part.txt": "mine",
    "out.part-of-mine/run.json": "mine",
    ".out.removed-42/notes.txt": "mine",
    ".out.replaced-42/run.json.mine": "mine",
    "checkpoint/lock": "mine",
}
"""A user's files beside a result ``out``."""


@dataclass(frozen=True)
class Scene:
    """What the trials of this part begin with.

    Attributes
    ----------
    study : the study file.
    made : folder with ``ended-1`` and ``ended-2``, the segments of runs of seeds 1 and 2 that have all.
    results : content of the undisturbed results by seed.
    """

    study: Path
    made: Path
    results: dict[int, dict[str, str]]

    @classmethod
    def of(cls, made: Path) -> Scene:
        """Make two runs, each once to its end and once killed just before its folder was closed."""
        study, results = quick_study(made / "study"), {}
        text = study.read_text(encoding="utf-8").replace("max_steps = 30", "max_steps = 12")
        study = made / "study-of-a-life.toml"
        study.write_text(text.replace("measurements.csv", "study/measurements.csv"), encoding="utf-8")
        for seed in (1, 2):
            place = made / f"ended-{seed}"
            with emptied(place / "whole") as whole:
                run = command("run", study, "--out", whole / "out", "--seed", seed, "--quiet")
                assert Process.begun(run, made / "notes").code() == 3
                results[seed] = content(whole / "out")
            run = command("run", study, "--out", place / "out", "--seed", seed, "--quiet")
            assert Process.begun(run, made / "notes", _die_at_the_end).code() == -signal.SIGKILL
        return cls(study, made, results)

    def run(self, place: Path, seed: int, *options: str) -> Callable[[], int]:
        """The work of a run into ``out`` of a place."""
        return command("run", self.study, "--out", place / "out", "--seed", seed, "--quiet", *options)

    def set_up(self, place: Path, seed: int) -> None:
        """Put the segments of a run that has all into a place, and a user's files beside them."""
        shutil.copytree(self.made / f"ended-{seed}" / "out.part", place / "out.part")
        for name, text in OTHERS.items():
            (place / name).parent.mkdir(exist_ok=True)
            (place / name).write_text(text, encoding="utf-8")

    def problem(self, place: Path, seeds: tuple[int, ...]) -> tuple[str, str] | None:
        """What is wrong just after a kill: the folder, or a user's files."""
        if touched := [name for name, text in OTHERS.items() if not _holds(place / name, text)]:
            return "lost", f"a user's {touched[0]}"
        out = place / "out"
        whole = not out.exists() or (content(out) in [self.results[n] for n in seeds] and sums_hold(out))
        return None if whole else ("half", "the folder is neither the old one nor the new one")

    def ended(self, place: Path, notes: Path, saved: set[str]) -> tuple[str, str]:
        """Go on with seed 2, which must be refused where that needs a word, and change nothing then."""
        for options in ((), ("--resume",), ("--resume", "--overwrite")):
            before = everything(place)
            process = Process.begun(self.run(place, 2, *options), notes)
            if process.code() == 3:
                break
            if process.code() != 2 or "not one line" in process.error:
                return "no clear error", f"{process.code()} {process.error}"
            if everything(place) != before:
                return "lost", f"a refusal has changed something: {process.error}"
        else:
            return "not to be repeated", process.error
        if twice := saved & set(process.saved):
            return "done again", " ".join(sorted(twice))
        if problem := self.problem(place, (2,)):
            return problem
        if not (place / "out").exists():
            return "wrong", "there is no result"
        left = {path.name for path in place.iterdir()} - {"out", *(name.split("/")[0] for name in OTHERS)}
        left |= {path.name for path in (place / "out").iterdir()} & {WORK, "status.json"}
        return ("remains", " ".join(sorted(left))) if left else (RIGHT, "killed")


def _die_at_the_end() -> None:
    put(folders, _close=lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL))


def _holds(path: Path, text: str) -> bool:
    return path.is_file() and path.read_text(encoding="utf-8") == text


def over(scene: Scene, place: Path, notes: Path, before: Callable[[], None]) -> tuple[str, str]:
    """Kill a run of seed 2 that replaces a result of seed 1, which a kill before left untidy; then go on."""
    scene.set_up(place, 2)
    process = Process.begun(scene.run(place, 2, "--overwrite", "--resume"), notes, before)
    process.code()
    return scene.problem(place, (1, 2)) or scene.ended(place, notes, set(process.saved))


def late(scene: Scene, place: Path, notes: Path, before: Callable[[], None], segments: int) -> tuple[str, str]:
    """Kill a run of seed 1 as it ends, then one of seed 2 once it has saved so many segments; then go on."""
    scene.set_up(place, 1)
    Process.begun(scene.run(place, 1, "--resume"), notes, before).code()
    if problem := scene.problem(place, (1,)):
        return problem
    process = Process.begun(scene.run(place, 2, "--overwrite"), notes)
    while len(process.saved) < segments:
        time.sleep(0.002)
    process.struck(0.0)
    process.code()
    return scene.problem(place, (1, 2)) or scene.ended(place, notes, set(process.saved))


def untidy(scene: Scene, place: Path, notes: Path) -> None:
    """Put a result of seed 1 into a place, with its checkpoint still in it."""
    shutil.copytree(scene.made / "ended-1" / "out.part", place / "out.part")
    keep = partial(put, folders, tidy=lambda place: None)
    assert Process.begun(scene.run(place, 1, "--resume"), notes, keep).code() == 3
    assert (place / "out" / WORK / "lock").exists()


def fill(table: Table, work: Path, made: Path, *, share: float = 1.0, only: tuple[str, ...] = ()) -> None:
    """Make the trials that the table lacks: at every call by one kind of kill, or at a share of the calls."""
    scene, place, notes = Scene.of(made / "lives"), work / "trial", work / "notes"
    old = made / "lives" / "untidy"
    with emptied(place), redirect_stdout(StringIO()):  # here, for what is computed or imported once
        scene.set_up(place, 1)
        scene.run(place, 1, "--resume")()
    with emptied(place):
        untidy(scene, place, notes)
        shutil.copytree(place / "out", old)
    every = max(2, round(2 / share))
    for name, options, seed in ((OVER, ("--overwrite", "--resume"), 2), (LATE, ("--resume",), 1)):
        if only and name not in only:
            continue
        with emptied(place):
            if name == OVER:
                shutil.copytree(old, place / "out")
            scene.set_up(place, seed)
            number = counted(scene.run(place, seed, *options), place, work, code=3)
        for fault, kind in KILLS.items():
            for call in table.missing(fault, name, range(1 + (kind - 1) % every, number + 1, every)):
                before = partial(arm, place, int(call), kind)
                with emptied(place):
                    if name == OVER:
                        shutil.copytree(old, place / "out")
                        found = over(scene, place, notes, before)
                    else:
                        segments = int(rng_of(fault, name, call).integers(1, 4))
                        found = late(scene, place, notes, before, segments)
                table.add(fault, name, call, f"{call} of {number}", *found)
