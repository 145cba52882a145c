"""Disks that are full: a file system of some megabytes, and a limit on the size of files."""

from __future__ import annotations

import resource
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path

from bench import Bench
from moments import disturbed
from trials import Table, emptied, rng_of

FULL, LIMITED = "small file system full", "limit on the size of files"
MEGABYTES = 24
TRIALS = {
    "run": 10,
    "run over an old result": 5,
    "calibrate": 10,
    "follow over an old stream": 8,
    "design over an old one": 5,
    "a store of tasks": 12,
}


@contextmanager
def small_disk(work: Path) -> Iterator[Path | None]:
    """A file system of ``MEGABYTES``; None where mounting one is refused."""
    place = work / "disk"
    place.mkdir(exist_ok=True)
    mount = ["mount", "-t", "tmpfs", "-o", f"size={MEGABYTES}m", "none", place]
    if subprocess.run(mount, capture_output=True, check=False).returncode:
        yield None
        return
    try:
        yield place
    finally:
        subprocess.run(["umount", "-l", place], check=True)


def used(folder: Path) -> int:
    """Bytes that the files of a folder take, by blocks."""
    return sum(path.stat().st_blocks * 512 for path in folder.rglob("*") if path.is_file())


def fill_up(disk: Path, left: int) -> Path:
    """A file that leaves so many bytes free, by blocks of 4096."""
    import os

    ballast, free = disk / "ballast", os.statvfs(disk)
    blocks = max(free.f_bavail - left // free.f_frsize, 0)
    with ballast.open("wb") as file:
        os.posix_fallocate(file.fileno(), 0, max(blocks * free.f_frsize, 1))
    return ballast


def limited(most: int) -> Callable[[], None]:
    """Let no file of this process grow beyond so many bytes."""
    return partial(resource.setrlimit, resource.RLIMIT_FSIZE, (most, most))


def trial(bench: Bench, fault: str, where: str, number: str, disk: Path | None, size: int) -> list[object]:
    """Let the disk be too small by chance, judge with room again; moment, outcome, detail."""
    rng = rng_of(fault, where, number)
    with emptied(bench.place):
        bench.fresh()
        if disk is None:
            most = int(rng.uniform(0, 1) ** 3 * size) + 4096  # room for its own words
            process = bench.begun(limited(most))
            process.code()
            return [f"{most} bytes", *bench.judged(process, killed=False)]
        left = int(rng.uniform(0, size)) // 4096 * 4096
        ballast = fill_up(disk, left)
        process = bench.begun()
        process.code()
        ballast.unlink()
        return [f"{left} bytes", *bench.judged(process, killed=False)]


def fill(table: Table, work: Path, made: Path, *, share: float = 1.0, only: tuple[str, ...] = ()) -> None:
    """Make the trials that the table lacks, or a share of them for a quick look."""
    jobs = disturbed(made)
    with small_disk(work) as disk:
        for fault, place in ((FULL, disk), (LIMITED, None)):
            if fault == FULL and disk is None:
                print("mounting is refused: no trials of a small file system")
                continue
            for where, number in TRIALS.items():
                numbers = list(table.missing(fault, where, range(1, 1 + max(1, round(share * number)))))
                if not numbers or (only and where not in only):
                    continue
                bench = Bench.of(jobs[where].saving, work, (place or work) / "trial")
                size = _needed(bench)
                for one in numbers:
                    table.add(fault, where, one, *trial(bench, fault, where, one, place, size))


def _needed(bench: Bench) -> int:
    """About what an undisturbed process needs, old and new folder together."""
    with emptied(bench.place):
        bench.fresh()
        before = used(bench.place)
        bench.begun().code()
        return used(bench.place) + (before if bench.saving.stays else 0)
