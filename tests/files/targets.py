"""Ways for bytes into the package: each either works or raises an error of the package, and nothing else.

A target takes any bytes and returns; whatever else it raises is a failure of the package, and so are warnings
(they would reach a terminal), hanging, and memory out of proportion. Used by the tests, with Hypothesis and
with every seed in ``seeds``, and by ``fuzz.py``, which looks for new inputs guided by coverage.
"""

from __future__ import annotations

import io
import json
import os
import tempfile
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, replace
from hashlib import sha256
from pathlib import Path
from unittest.mock import patch

import xarray as xr

from bayesterra.analysis import result as run_results
from bayesterra.analysis.result import check_draws, read_pooled, read_result
from bayesterra.checking.calibration import Outcome
from bayesterra.errors import BayesterraError, ResultError
from bayesterra.follow.rows import read_row
from bayesterra.follow.session import rows_of
from bayesterra.follow.stream import State, load_stream
from bayesterra.likelihood.page import study_overview
from bayesterra.prediction.prediction import predict
from bayesterra.prediction.rover import read_rover
from bayesterra.report.terminal import PlainConsole, show
from bayesterra.runtime import netcdf
from bayesterra.runtime.checkpoints import Checkpoints, digest, read_tasks, unpack
from bayesterra.runtime.netcdf import read_tree
from bayesterra.runtime.reading import damage
from bayesterra.runtime.tables import csv_text, read_cells
from bayesterra.study.canonical import write_study
from bayesterra.study.observations import read_table
from bayesterra.study.previous import taken
from bayesterra.study.priors import Source
from bayesterra.study.result import Result
from bayesterra.study.study import Study, load_soil_test, load_study
from bayesterra.study.wheels import read_wheel
from tests.support.thinned import thinned

SEEDS = Path(__file__).parent / "seeds"
BREAK = b"\n#-----\n"
"""Stands between the files of one input."""
RESULT_FILES = (
    "run.json", "summary.csv", "least_squares.csv", "identifiability.csv", "predictive.csv", "study.toml",
    "measurements.csv",
)  # fmt: skip
REFERENCES = {"slip_reference": "shearing", "sinkage_reference": "rim"}
STORE_FILES = ("begun.json", "state.segment", "task-1.segment", "tasks", "stream.json", "updates.csv")


class FailureError(AssertionError):
    """Something that must not happen."""


@contextmanager
def allowed() -> Iterator[None]:
    """Let errors of the package pass, if they are one line."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        try:
            yield
        except BayesterraError as error:
            if not str(error) or not str(error).isprintable():
                raise FailureError(f"no line for people: {error!r}") from error


@contextmanager
def folder() -> Iterator[Path]:
    """An empty folder; nothing may appear beside it."""
    with tempfile.TemporaryDirectory(prefix="hostile-") as name:
        inner = Path(name) / "inner"
        inner.mkdir()
        yield inner
        if os.listdir(name) != ["inner"]:
            raise FailureError(f"written beside the folder: {os.listdir(name)}")


def parts(data: bytes, number: int) -> list[bytes]:
    """The files of an input; missing ones are empty."""
    found = data.split(BREAK, number - 1)
    return [*found, *[b""] * (number - len(found))]


def study(data: bytes) -> None:
    """A study file and its table: read, shown, written out and read again."""
    with folder() as inner:
        for name, content in zip(("study.toml", "measurements.csv"), parts(data, 2), strict=True):
            (inner / name).write_bytes(content)
        with allowed():
            loaded = load_study(inner)
            _same_again(loaded, inner / "copy")
        with allowed():
            show(study_overview(load_study(inner)), console=quiet_console())
        with allowed():
            load_study(inner, prior_only=True)


def _same_again(loaded: Study, copy: Path) -> None:
    """What is written into a result folder is the same study when it is read there."""
    copy.mkdir()
    write_study(loaded, copy)
    try:
        again = load_study(copy)
    except BayesterraError as error:
        raise FailureError(f"its copy cannot be read: {error}") from error
    if again.fingerprint != loaded.fingerprint:
        raise FailureError("its copy is another study")


def quiet_console() -> PlainConsole:
    """A console that nobody reads; what it prints must be harmless."""
    console = PlainConsole()
    console.file = _Watched()
    return console


class _Watched(io.StringIO):
    """A terminal that cannot bear control characters."""

    def write(self, text: str) -> int:
        if bad := [one for one in text if not one.isprintable() and one != "\n"]:
            raise FailureError(f"control characters on the terminal: {bad!r}")
        return len(text)


def table(data: bytes) -> None:
    """A table of measurements, as a file and row by row, written and read again."""
    with folder() as inner:
        path = inner / "rows.csv"
        path.write_bytes(data)
        with allowed():
            frame = read_table(path)
            (inner / "again.csv").write_text(csv_text(frame), encoding="utf-8", newline="")
            if len(frame.columns) > 1:  # a lone empty cell is a blank line
                cells, _ = read_cells(inner / "again.csv")
                if cells != [list(frame.columns), *frame.to_numpy().tolist()]:
                    raise FailureError("a table changed on its way to the disk and back")
        with allowed(), ExitStack() as stack:
            for number, row in enumerate(rows_of(path, stack), start=1):
                if number > 50:
                    break
                with allowed():
                    read_row(base().study, row, number, REFERENCES)


def soiltest(data: bytes) -> None:
    """A soil-test file and its table."""
    with folder() as inner:
        toml, rows = parts(data, 2)
        (inner / "soiltest.toml").write_bytes(toml)
        (inner / "readings.csv").write_bytes(rows)
        with allowed():
            test = load_soil_test(inner)
            (inner / "copy").mkdir()
            write_study(test, inner / "copy")
            try:
                again = load_study(inner / "copy")
            except BayesterraError as error:
                raise FailureError(f"its copy cannot be read: {error}") from error
            series = [next(iter(each.soil_tests.values())).readings for each in (again, test)]
            if series[0].tests != series[1].tests:
                raise FailureError("its copy is another test")


def rover(data: bytes) -> None:
    """A rover file, and the same bytes as a file of a wheel."""
    with folder() as inner:
        path = inner / "rover.toml"
        path.write_bytes(data)
        with allowed():
            str(read_rover(path, base().study.wheels, 0.5).assumptions)
        with allowed():
            read_wheel(path)


def draws(data: bytes) -> None:
    """Draws with some bytes edited, and with any bytes in their place."""
    with folder() as inner:
        path = inner / "draws.nc"
        path.write_bytes(edited((base().folder / "draws.nc").read_bytes(), data))
        with allowed(), damage(ResultError, path):
            check_draws(read_tree(path), base().study)


def result(data: bytes) -> None:
    """A result folder with one file replaced: the first byte says which; its draws stay."""
    if not data:
        return
    name = RESULT_FILES[data[0] % len(RESULT_FILES)]
    with folder() as inner, _same_draws():
        for path in base().folder.iterdir():
            (inner / path.name).symlink_to(path)
        (inner / name).unlink()
        (inner / name).write_bytes(data[1:])
        with allowed():
            loaded = read_result(inner)
            predict(loaded, [0.1, 0.3])
            str(loaded.validation)
        with allowed():
            read_pooled(inner)
        if name in ("run.json", "study.toml"):
            with allowed():
                taken(Source(inner, None, 1.0))


@contextmanager
def _same_draws() -> Iterator[None]:
    """Draws that are not spoilt need not be read from the disk each time, which takes most of the time."""
    with patch.object(run_results, "read_tree", base().tree), patch.object(netcdf, "read_tree", base().tree):
        yield


def edited(content: bytes, edits: bytes) -> bytes:
    """Bytes with others in their places: three bytes say where, a fourth what; 255 at the end cuts there."""
    found = bytearray(content)
    for start in range(0, len(edits) - 3, 4):
        at = int.from_bytes(edits[start : start + 3], "big") % max(1, len(found))
        found[at] = edits[start + 3]
    if edits[-1:] == b"\xff":
        del found[int.from_bytes(edits[:3], "big") % max(1, len(found)) :]
    return bytes(found)


def store(data: bytes) -> None:
    """What serves to go on: checkpoints, saved streams and finished tasks; the first byte says which."""
    if not data:
        return
    name, content = STORE_FILES[data[0] % len(STORE_FILES)], data[1:]
    with folder() as inner:
        if name == "tasks":
            _write_task(inner, content)
        elif name.endswith(".segment"):  # whoever writes one can reckon its checksum
            (inner / name).write_bytes(sha256(content).hexdigest().encode() + b"\n" + content)
        else:
            (inner / name).write_bytes(content)
        with allowed():
            checkpoints = Checkpoints.opened(inner, {"seed": 1})
            segment = checkpoints.load("state")
            if segment is not None:
                with _misfit():
                    unpack(State, segment)
            with _misfit():
                [Outcome.from_record(one) for one in checkpoints.tasks().values()]
            checkpoints.add({7: {"task": 7}})
        with allowed():
            read_tasks(inner)
        if name in ("stream.json", "updates.csv"):
            write_study(base().study, inner)
            with allowed():
                load_stream(inner)


@contextmanager
def _misfit() -> Iterator[None]:
    """What is caught where it is called: content that does not fit."""
    with suppress(ValueError, LookupError, TypeError, AttributeError):
        yield


def _write_task(inner: Path, content: bytes) -> None:
    """A sound piece of work that is a task of that content."""
    whole = json.dumps({"run": digest({"seed": 1}), "segment": "task-1"}).encode() + b"\n" + content
    (inner / "task-1.segment").write_bytes(sha256(whole).hexdigest().encode() + b"\n" + whole)


TARGETS: dict[str, Callable[[bytes], None]] = {
    "study": study,
    "table": table,
    "soiltest": soiltest,
    "rover": rover,
    "result": result,
    "draws": draws,
    "store": store,
}


@dataclass(frozen=True)
class Base:
    """A sound result, and the folder that it is saved in."""

    study: Study
    folder: Path
    draws: xr.DataTree

    def tree(self, path: Path) -> xr.DataTree:
        """Its draws, as if they were read."""
        return self.draws


_BASE: list[Base] = []


def base() -> Base:
    """The sound result that inputs are set beside; see :func:`set_base`."""
    return _BASE[0]


def set_base(small: Result, where: Path | None = None) -> Base:
    """Save a result with few of its draws, for targets to spoil; or take a folder of one."""
    if where is None:
        where = small.study.path.parent if small.study.path else Path()
    else:
        replace(small, draws=thinned(small.draws)).write(where)
    _BASE[:] = [Base(small.study, where, read_tree(where / "draws.nc"))]
    return _BASE[0]


def seeds(target: str) -> list[Path]:
    """Inputs that are kept: sound ones to begin from, and all that once failed."""
    return sorted((SEEDS / target).glob("*"))
