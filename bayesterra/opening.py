"""What a path given to a command holds: a study, a finished result, or a stream that was put down."""

from __future__ import annotations

from pathlib import Path

from bayesterra.checksums import check_sums
from bayesterra.drawn import is_result
from bayesterra.errors import ResultError
from bayesterra.reading import read_json
from bayesterra.results import Result
from bayesterra.study import STUDY_FILE, Study, load_study
from bayesterra.workflow import load_result, load_single


def opened(path: Path) -> Study | Result:
    """The result folder or the study at a path.

    Raises
    ------
    BayesterraError : it is neither, or something in it is wrong.
    """
    if is_result(path):
        return load_single(path)
    if path.is_file() or (path / "study.toml").is_file():
        return load_study(path)
    missing = "neither run.json nor study.toml in it" if path.is_dir() else "no such file or folder"
    raise ResultError(f"'{path}' is neither a study nor a result: {missing}")


def opened_for_design(path: Path) -> Study | Result:
    """The result in a folder that ``run`` wrote, else the study, with or without readings."""
    if is_result(path) and not _prior_only(path):
        return load_single(path)
    check_sums(path, STUDY_FILE, "measurements.csv")
    return load_study(path, prior_only=True)


def opened_for_stream(path: Path) -> Path | Result:
    """The result at a path; the path itself where it is a study or a stream that was put down."""
    from bayesterra.streaming.state import MARK, STATE

    if (path / MARK).exists() or (path / STATE).exists() or not is_result(path):
        return path
    return load_result(path)


def _prior_only(folder: Path) -> bool:
    try:
        return bool(read_json(folder / "run.json").get("prior_only"))
    except (OSError, ValueError, AttributeError):
        return False
