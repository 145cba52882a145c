"""Folders to work in, and pages of them at work."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.ui.client import Client, served

HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the study of the Harbin wheel."""
    place = tmp_path / "work"
    (place / "hit-wh32").mkdir(parents=True)
    for name in ("study.toml", "measurements.csv"):
        shutil.copy(HIT / name, place / "hit-wh32")
    return place


@pytest.fixture
def client(folder: Path) -> Iterator[Client]:
    """A reader of the page of that folder."""
    with served(folder) as reader:
        yield reader
