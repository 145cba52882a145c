"""Logs in the page: windows found, moved, left out, and rows saved."""

from __future__ import annotations

import re
from pathlib import Path

import pandas as pd
import pytest

from tests.ui.client import Client

MEASURED = Path(__file__).parents[2] / "studies" / "logs" / "measured"
DRIVE = "drive_gr810_grouser_3_4_21_10_20_0_1.parquet"
WHEEL = {"radius": "58 mm", "lugs": "24"}


def windows(text: str) -> dict[str, str]:
    """Fields of the windows on a page."""
    return dict(re.findall(r'name="(window[^"]+)" value="([^"]*)"', text))


@pytest.fixture
def log(client: Client) -> str:
    """Address of the page of a drive."""
    answer = client.upload("/logs", DRIVE, (MEASURED / DRIVE).read_bytes())
    assert answer.status == 303
    return answer.location


def test_windows_are_those_of_the_command(client: Client, log: str, folder: Path) -> None:
    """Saved untouched, the table is that of `reduce`; nothing is replaced; a study begins with it."""
    from bayesterra.reduce.reduction import reduce_logs

    page = client.post(log, WHEEL)
    assert page.text.count("data-window") == 4 * page.text.count('<svg class="panel"')
    answer = client.post(f"{log}/rows", {**WHEEL, **windows(page.text), "name": "drive"})
    assert answer.location.startswith("/draft/")
    reduction = reduce_logs([MEASURED / DRIVE], radius="58 mm", lugs=24)
    expected = reduction.tables()["measurements"]
    pd.testing.assert_frame_equal(pd.read_csv(folder / "drive.csv"), expected)
    assert client.post(f"{log}/rows", {**WHEEL, "name": "drive"}).status == 422


def test_a_window_is_moved(client: Client, log: str, folder: Path) -> None:
    """Its row is of the samples between its new ends, drift and all."""
    moved = {"window/3/start": "60.000", "window/3/end": "80.000"}
    page = client.post(log, {**WHEEL, **moved})
    assert windows(page.text)["window/3/start"] == "60.000"
    client.post(f"{log}/rows", {**WHEEL, **moved, "name": "moved"})
    (row,) = pd.read_csv(folder / "moved.csv").to_dict("records")
    assert row["# from [s]"] == pytest.approx(60.0, abs=0.1)
    assert row["# to [s]"] == pytest.approx(80.0, abs=1.0)
    assert row["sinkage [mm]"] == pytest.approx(25.2, abs=0.2)


@pytest.mark.parametrize(
    ("form", "said"),
    [
        ({"window/2/start": "30", "window/2/end": "60"}, "overlap"),
        ({"window/3/start": "80", "window/3/end": "60"}, "must end after"),
        ({"window/3/start": "x", "window/3/end": "60"}, "number of seconds"),
        ({"lugs": "many"}, "whole number"),
        ({"radius": "58"}, "unit"),
        ({"kind": "invented"}, "unknown kind"),
    ],
)
def test_mistakes_are_told_in_the_page(client: Client, log: str, form: dict[str, str], said: str) -> None:
    """And the page stays."""
    answer = client.post(log, {**WHEEL, **form})
    assert answer.status == 200
    assert said in answer.text
    assert 'role="alert"' in answer.text


def test_a_window_that_is_left_out_gives_no_row(client: Client, log: str, folder: Path) -> None:
    """The only one: nothing is left to save."""
    answer = client.post(f"{log}/rows", {**WHEEL, "window/3/use": "no", "name": "none"})
    assert answer.status == 422
    assert "no steady window" in answer.text
    assert not (folder / "none.csv").exists()


def test_plate_tests_become_readings(client: Client, folder: Path) -> None:
    """Asked for the plate first, then a picture for each test."""
    name = "cullinan_plates.parquet"
    log = client.upload("/logs", name, (MEASURED / name).read_bytes()).location
    assert "diameter is missing" in client.get(log).text
    page = client.post(log, {"plate": "100 mm"})
    assert page.text.count('<svg class="panel"') > 2
    assert client.post(f"{log}/rows", {"plate": "100 mm", "name": "plates"}).location == "/"
    assert "pressure [kPa]" in pd.read_csv(folder / "plates.csv").columns
