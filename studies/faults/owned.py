"""A user's own files where the package would work: every command leaves them alone, and says so in a line.

Also results that are reached by a link: the link stays, and the folder that it leads to is written.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

from short_runs import quick_study
from trials import CLEAR, RIGHT, Process, Table, command, content, emptied, everything, one_study

HERE = Path(__file__).parent
NOTES = "years of work\n"


def commands(made: Path) -> dict[str, tuple[object, ...]]:
    """Every command that makes a folder, without ``--out``."""
    study, one = quick_study(made / "study"), one_study(made / "study-of-one")
    rows = one.with_name("measurements.csv")
    return {
        "run": ("run", study, "--quiet"),
        "run --resume": ("run", study, "--quiet", "--resume"),
        "run --prior-only": ("run", study, "--quiet", "--prior-only"),
        "simulate": ("simulate", study),
        "predict": ("predict", made / "r1"),
        "compare": ("compare", made / "r1", made / "r2"),
        "identify": ("identify", study),
        "holdout": ("holdout", study),
        "design": ("design", one, "--slip", "0.2,0.4", "--quiet"),
        "calibrate": ("calibrate", one, "-n", 20, "--workers", 1, "--quiet"),
        "follow": ("follow", one, "--data", rows, "--particles", 200, "--quiet"),
        "soiltest": ("soiltest", HERE.parent / "soil-tests" / "cmu.toml", "--quiet"),
    }


def written(path: Path, text: str = NOTES) -> None:
    """Write a user's file and the folders above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def in_the_way() -> dict[str, Callable[[Path], None]]:
    """What a user may have where the package would make ``out``, by name."""
    return {
        "a folder out.part": lambda place: written(place / "out.part" / "notes.txt"),
        "an empty folder out.part": lambda place: (place / "out.part").mkdir(),
        "a file out.part": lambda place: written(place / "out.part"),
        "a folder out.part with a checkpoint": lambda place: written(place / "out.part" / "checkpoint" / "notes.txt"),
        "a link out.part": _linked_part,
    }


def _linked_part(place: Path) -> None:
    written(place / "elsewhere" / "notes.txt")
    (place / "out.part").symlink_to("elsewhere")


def in_a_result(made: Path) -> dict[str, Callable[[Path], None]]:
    """What a user may have put into a result ``out``, by name."""

    def with_result(place: Path) -> Path:
        shutil.copytree(made / "r1", place / "out")
        return place / "out"

    return {
        "notes in a result": lambda place: written(with_result(place) / "notes.txt"),
        "a folder checkpoint in a result": lambda place: written(with_result(place) / "checkpoint" / "notes.txt"),
        "a folder in a result": lambda place: written(with_result(place) / "figures" / "a" / "notes.txt"),
        "a link in a result": lambda place: (with_result(place) / "mine").symlink_to("/nowhere"),
    }


def refused(work: Callable[[], int], place: Path, notes: Path) -> tuple[str, str]:
    """Outcome of a command that must end with one line and touch nothing; 3 where it only reads a result."""
    before = everything(place)
    process = Process.begun(work, notes)
    code, error = process.code(), process.error.replace(str(place), "DIR")
    if everything(place) != before:
        return "lost", "something of the user's was touched"
    if code == 3 and (place / "out" / "run.json").exists():
        return RIGHT, "the result is read"
    clear = code == 2 and error.startswith("error: ")
    return (CLEAR, error) if clear else ("no clear error", f"{code} {error}")


def through_a_link(work: Callable[[], int], place: Path, notes: Path) -> tuple[str, str]:
    """Outcome of a command whose ``out`` is a link to ``disk/result``: that is written, and nothing else."""
    process = Process.begun(work, notes)
    if process.code() not in (0, 3):
        return "no clear error", process.error
    if not (place / "out").is_symlink() or not (place / "disk" / "result" / "SHA256SUMS").is_file():
        return "lost", "the link, or what it led to"
    left = {path.name for path in place.iterdir()} | {path.name for path in (place / "disk").iterdir()}
    if left != {"out", "disk", "result"}:
        return "remains", " ".join(sorted(left))
    return RIGHT, f"{len(content(place / 'disk' / 'result'))} files"


def cases(made: Path) -> Iterator[tuple[str, str, Callable[[Path], None], tuple[object, ...], bool]]:
    """Fault, place, what prepares it, the command, and whether it is to be refused."""
    every = commands(made)
    for fault, prepare in in_the_way().items():
        for name, arguments in every.items():
            yield fault, name, prepare, arguments, True
    for fault, prepare in in_a_result(made).items():
        for name in ("run", "run --resume", "run --prior-only"):
            yield fault, name, prepare, every[name], True
            yield fault, f"{name} --overwrite", prepare, (*every[name], "--overwrite"), True
    for name in ("run", "run --resume", "run --prior-only", "predict", "compare"):
        overwriting = (*every[name], "--overwrite")
        yield "out is a link to an old one", name, partial(_old, made, name), overwriting, False
        yield "out is a link to nothing", name, _dangling, every[name], False


def _old(made: Path, name: str, place: Path) -> None:
    """A link to an older folder of the kind that a command makes."""
    (place / "disk").mkdir()
    target = place / "disk" / "result"
    if name.startswith("run"):
        shutil.copytree(made / "r2", target)
    else:
        work = command(*commands(made)[name], "--out", target)
        assert Process.begun(work, place.parent / "notes-before").code() == 0
    (place / "out").symlink_to(Path("disk") / "result")


def _dangling(place: Path) -> None:
    (place / "disk").mkdir()
    (place / "out").symlink_to(place / "disk" / "result")


def fill(table: Table, work: Path, made: Path, *, share: float = 1.0, only: tuple[str, ...] = ()) -> None:
    """Make the trials that the table lacks, or a share of them for a quick look."""
    every = max(1, round(1 / share))
    for number, (fault, where, prepare, arguments, is_refused) in enumerate(cases(made)):
        if number % every or (only and where not in only) or not list(table.missing(fault, where, [1])):
            continue
        with emptied(work / "trial") as place:
            prepare(place)
            what = refused if is_refused else through_a_link
            outcome = what(command(*arguments, "--out", place / "out"), place, work / "notes")
        table.add(fault, where, 1, " ".join(str(one) for one in arguments[:1]), *outcome)
