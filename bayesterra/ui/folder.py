"""Folder that the page works in: studies, results and drafts by name, and nothing outside."""

from __future__ import annotations

import os
import re
import secrets
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesterra.errors import BayesterraError, ResultError, StudyError
from bayesterra.runtime.folders import part_of, write_bytes, write_text
from bayesterra.runtime.reading import MOST_TABLE, read_bytes, read_json

HIDDEN = ".bayesterra-ui"
"""Folder of drafts and of the queue, in the folder that the page works in."""
STUDY_FILES = ("study.toml", "soiltest.toml")
MARKS = {
    "run.json": ("result", "report.html"),
    "comparison.csv": ("comparison", "comparison.html"),
    "design.json": ("design", "report.html"),
    "identifiability.json": ("identifiability", "report.html"),
    "holdout.json": ("holdout", "report.html"),
    "calibration.json": ("calibration", "report.html"),
}
"""Kind and page of finished folders, by the file that marks them."""
SAVED = "saved"
"""File in the folder of a draft that was saved."""
MOST_DRAFTS = 6
LONGEST_NAME = 80
MOST_SHOWN = 400


@dataclass(frozen=True)
class Entry:
    """A study or a result in the folder."""

    name: str
    kind: str
    title: str = ""
    page: str = ""
    record: Mapping[str, Any] | None = None


class Folder:
    """The folder that was given to ``bayesterra ui``, and what may be touched: only what lies in it."""

    def __init__(self, root: Path) -> None:
        if not root.is_dir():
            raise StudyError(f"'{root}' is not a folder: give one that holds studies, or will")
        self.root = root.resolve()

    @property
    def hidden(self) -> Path:
        """Folder of drafts and of the queue."""
        return self.root / HIDDEN

    def inside(self, path: Path) -> Path:
        """The path with its links followed; StudyError where that leads out of the folder."""
        resolved = Path(os.path.realpath(path))
        if not resolved.is_relative_to(self.root):
            raise StudyError(f"'{path.name}' lies outside the folder of this page: copy it into the folder")
        return resolved

    def named(self, name: str) -> Path:
        """An entry by its name; StudyError where there is none of that name, or it is a way out."""
        path = self.root / checked_entry(name)
        if not path.exists():
            raise StudyError(f"there is no '{name}' in the folder of this page")
        self.inside(path)
        return path

    def free(self, name: str) -> str:
        """The name itself, or the next one with a number that nothing has yet."""
        number, free = 1, checked_entry(name)
        while (path := self.root / free).exists() or path.is_symlink() or part_of(path).exists():
            number += 1
            free = f"{name}-{number}"
        return free

    def opened(self, name: str) -> Path:
        """An entry whose files, and those that its study names, all lie in the folder; StudyError otherwise."""
        path = self.named(name)
        self.check(path)
        return path

    def check(self, path: Path) -> None:
        """StudyError where a study or a result at a path reaches out of the folder."""
        self._check(path, set())

    def _check(self, path: Path, seen: set[Path]) -> None:
        path = self.inside(path)
        if path in seen:
            return
        seen.add(path)
        for folder, folders, files in os.walk(path):
            for name in (*folders, *files):
                if (Path(folder) / name).is_symlink():
                    self.inside(Path(folder) / name)
        studies = [path] if path.is_file() else [path / name for name in STUDY_FILES if (path / name).is_file()]
        for study in studies:
            for named in _references(study):
                target = self.inside(study.parent / named)
                if target.is_dir():
                    self._check(target, seen)

    def studies(self) -> list[Entry]:
        """Studies in the folder; those of results stay with their results."""
        return [entry for entry in self._entries() if entry.kind in ("study", "soil tests")]

    def results(self) -> list[Entry]:
        """Finished folders, the latest first."""
        done = [entry for entry in self._entries() if entry.page]
        return sorted(done, key=lambda entry: -(self.root / entry.name).stat().st_mtime)

    def _entries(self) -> Iterator[Entry]:
        names = sorted(name for name in os.listdir(self.root) if not name.startswith("."))
        for name in names[:MOST_SHOWN]:
            try:
                path = self.named(name)
            except StudyError:
                continue
            if name.endswith(".part"):
                continue
            if path.is_file() and name.endswith(".toml") and "data" in _content(path):
                yield Entry(name, "study", _title(path))
            elif path.is_dir():
                yield from self._of_folder(name, path)

    def _of_folder(self, name: str, path: Path) -> Iterator[Entry]:
        for mark, (kind, page) in MARKS.items():
            if (path / mark).is_file():
                record = self._record(path / mark) if mark.endswith(".json") else {}
                prior = " of the prior" if record.get("prior_only") else ""
                yield Entry(name, f"{kind}{prior}", str(record.get("title", "")) or _title(path), page, record)
                return
        for file, kind in zip(STUDY_FILES, ("study", "soil tests"), strict=True):
            if (path / file).is_file():
                yield Entry(name, kind, _title(path / file))
                return

    def _record(self, path: Path) -> dict[str, Any]:
        try:
            content = read_json(self.inside(path))
        except (OSError, ValueError, BayesterraError):
            return {}
        return content if isinstance(content, dict) else {}

    def record(self, name: str) -> dict[str, Any]:
        """Record of a result; ResultError where it has none."""
        content = self._record(self.named(name) / "run.json")
        if not content:
            raise ResultError(f"'{name}' is not a result that can be read")
        return content

    def served(self, name: str, file: str) -> bytes:
        """Content of a file of a finished folder."""
        path = self.inside(self.named(name) / checked_entry(file))
        try:
            return read_bytes(path, MOST_TABLE)
        except OSError as error:
            raise ResultError(f"'{file}' cannot be read: {error.strerror or error}") from error

    def draft(self, number: str) -> Path:
        """Folder of a draft; StudyError where there is none."""
        path = self.hidden / "drafts" / number
        if not re.fullmatch(r"[0-9a-f]{16}", number) or not path.is_dir():
            raise StudyError("this draft is not there any more: begin with the table again")
        self.inside(path)
        return path

    def drafts(self) -> list[Entry]:
        """Drafts that were not saved yet, the latest first."""
        place = self.hidden / "drafts"
        found = [self.draft(name) for name in os.listdir(place)] if place.is_dir() else []
        open_ = [path for path in found if not (path / SAVED).exists()]
        latest = sorted(open_, key=lambda path: -path.stat().st_mtime)[:MOST_DRAFTS]
        return [Entry(path.name, "draft", _title(path)) for path in latest]

    def discard_draft(self, number: str) -> None:
        """Remove a draft that its maker does not want any more; what was saved of it stays."""
        shutil.rmtree(self.draft(number))

    def begin_draft(self) -> Path:
        """A new, empty folder for a draft."""
        path = self.hidden / "drafts" / secrets.token_hex(8)
        self.inside(path.parent)
        path.mkdir(parents=True)
        return path

    def content(self, name: str) -> bytes:
        """Content of a table in the folder."""
        return read_bytes(self.inside(self.named(name)), MOST_TABLE)

    def keep_upload(self, name: str, content: bytes) -> str:
        """Keep a log that was sent; the number by which it is found."""
        path = self.hidden / "logs" / secrets.token_hex(8)
        self.inside(path.parent)
        file = path / checked_entry(name)
        path.mkdir(parents=True)
        write_bytes(file, content)
        return path.name

    def upload(self, number: str) -> Path:
        """A log that was sent; StudyError where there is none."""
        path = self.hidden / "logs" / number
        files = list(path.iterdir()) if re.fullmatch(r"[0-9a-f]{16}", number) and path.is_dir() else []
        if len(files) != 1:
            raise StudyError("this log is not there any more: send it again")
        return self.inside(files[0])

    def write_all(self, name: str, files: Mapping[str, bytes]) -> Path:
        """Write files into a new folder; StudyError where something has the name."""
        path = self.root / checked_entry(name)
        if path.exists() or path.is_symlink():
            raise StudyError(f"there is a '{name}' already, and nothing is replaced: give another name")
        self.inside(path)
        path.mkdir()
        for file, content in files.items():
            write_bytes(path / file, content)
        return path


def checked_entry(name: str) -> str:
    """A name of one file or folder, or StudyError: no path, nothing hidden, nothing that does not show."""
    plain = name.strip()
    if not plain or len(plain) > LONGEST_NAME or not re.fullmatch(r"[\w][\w .,()+=-]*", plain) or plain.endswith("."):
        raise StudyError(
            f"a name must be letters, digits, blanks and -_.,()+= only, {LONGEST_NAME} at most, and begin with a"
            f" letter or digit (got {name!r:.60})"
        )
    return plain


def _content(path: Path) -> dict[str, Any]:
    from bayesterra.study.schema import read_toml

    try:
        return read_toml(path)
    except BayesterraError:
        return {}


def _title(path: Path) -> str:
    return str(_content(path / "study.toml" if path.is_dir() else path).get("title", ""))


def _references(study: Path) -> Iterator[str]:
    """Paths that a study names: tables, readings of soil tests, earlier results."""
    content = _content(study)
    tables = [content.get("data"), *_values(content.get("soil_tests"))]
    yield from (table["file"] for table in tables if isinstance(table, dict) and isinstance(table.get("file"), str))
    priors = content.get("priors")
    sources = priors.get("from", []) if isinstance(priors, dict) else []
    for source in sources if isinstance(sources, list) else [sources]:
        if isinstance(source, dict) and isinstance(source.get("result"), str):
            yield source["result"]


def _values(table: object) -> list[object]:
    return list(table.values()) if isinstance(table, dict) else []


def write_record(path: Path, text: str) -> None:
    """Write a small file whole, its folder too where it is not there."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_text(path, text)
