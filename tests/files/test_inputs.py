"""Sound inputs, spoilt in many ways: each works or is refused in one line; so is all that once failed."""

from __future__ import annotations

import json
import os
import tomllib
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from . import targets

TIMES = int(os.environ.get("HOSTILE_TIMES", "1"))
"""As many times more examples than usual."""
MANY = settings(max_examples=60 * TIMES, deadline=None, suppress_health_check=list(HealthCheck))
FEW = settings(max_examples=20 * TIMES, deadline=None, suppress_health_check=list(HealthCheck))
WORDS = (Path(__file__).parent / "words.txt").read_text(encoding="ascii").splitlines()

texts = st.one_of(
    st.sampled_from([word.strip('"') for word in WORDS]),
    st.text(max_size=30),
    st.sampled_from(["", " ", "\t=1+1", "../../etc/passwd", "/dev/zero", "a" * 20_000, "[/]", "{{7*7}}", "$x$"]),
    st.sampled_from(["\x00", "\x1b[2J", "\u202e", "\r", "1" * 5000 + " mm", " " * 5000, "m^9^9^9", "1 m**99"]),
)
numbers = st.one_of(
    st.sampled_from([0, 1, -1, 0.5, 1e308, -1e308, 1e-320, float("nan"), float("inf"), 10**400, 2**63, 1e200]),
    st.floats(),
    st.integers(),
)
values = st.recursive(
    st.one_of(texts, numbers, st.booleans(), st.just(date(2026, 1, 1))),
    lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(texts, inner, max_size=3)),
    max_leaves=5,
)


def places(content: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths to everything in nested tables and lists."""
    inner = content.items() if isinstance(content, dict) else enumerate(content) if isinstance(content, list) else ()
    return [one for key, item in inner for one in ((*path, key), *places(item, (*path, key)))]


@st.composite
def spoilt(draw: st.DrawFn, content: dict[str, Any]) -> dict[str, Any]:
    """Nested tables with one to three things replaced, removed or added."""
    content = json.loads(json.dumps(content, default=str))
    for _ in range(draw(st.sampled_from([1, 1, 1, 2, 3]))):
        found = places(content)
        *path, key = draw(st.sampled_from(found))
        home: Any = content
        for step in path:
            home = home[step]
        change = draw(st.sampled_from(["replace", "replace", "replace", "remove", "add", "like another"]))
        if change == "remove":
            del home[key]
        elif change == "replace":
            home[key] = draw(values)
        elif change == "add" and isinstance(home, dict):
            home[draw(texts)] = draw(values)
        else:
            other: Any = content
            for step in draw(st.sampled_from(found)):
                other = other[step] if not isinstance(other, (str, int, float, bool)) else other
            home[key] = json.loads(json.dumps(other, default=str))
        if not content:
            break
    return content


def toml(content: dict[str, Any]) -> bytes:
    """TOML of nested tables, all of them inline."""
    lines = (f"{json.dumps(key)} = {_toml(value)}" for key, value in content.items())
    return "\n".join(lines).encode(errors="surrogatepass")


def _toml(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{json.dumps(k)} = {_toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(_toml, value)) + "]"
    if isinstance(value, date):
        return value.isoformat()
    return json.dumps(value).replace("NaN", "nan").replace("Infinity", "inf")


def seed(target: str, name: str, part: int = 0) -> bytes:
    """One file of a sound input."""
    return (targets.SEEDS / target / name).read_bytes().split(targets.BREAK)[part]


def parsed(target: str, name: str) -> dict[str, Any]:
    """The tables of a sound input."""
    return tomllib.loads(seed(target, name).decode())


cells = st.one_of(texts, numbers.map(str))


@st.composite
def spoilt_table(draw: st.DrawFn, content: bytes) -> bytes:
    """A table with some cells replaced, in some encoding, perhaps cut short."""
    rows = [line.split(",") for line in content.decode().split("\n")]
    for _ in range(draw(st.integers(1, 3))):
        row = draw(st.integers(0, len(rows) - 1))
        column = draw(st.integers(0, len(rows[row]) - 1))
        cell = draw(cells)
        rows[row][column] = draw(
            st.sampled_from([cell, '"' + cell.replace('"', '""') + '"', f"{rows[row][column]},{cell}"])
        )
    text = draw(st.sampled_from(["\n", "\r\n", "\r"])).join(",".join(row) for row in rows)
    encoded = text.encode(draw(st.sampled_from(["utf-8", "utf-8-sig", "utf-16", "latin-1"])), errors="replace")
    return encoded[: draw(st.integers(0, len(encoded)))] if draw(st.booleans()) else encoded


@pytest.mark.parametrize("name", ["sound", "sound-rich"])
@MANY
@given(data=st.data())
def test_study_files(name: str, data: st.DataObject) -> None:
    """Wrong types, absurd numbers, strange texts, missing and unknown keys in a study file."""
    content = data.draw(spoilt(parsed("study", name)))
    targets.study(toml(content) + targets.BREAK + seed("study", name, 1))


@MANY
@given(data=st.data())
def test_tables(base: targets.Base, data: st.DataObject) -> None:
    """Cells of all kinds in all encodings, in the table of a study and row by row."""
    rows = data.draw(spoilt_table(seed("study", "sound-rich", 1)))
    targets.study(seed("study", "sound-rich") + targets.BREAK + rows)
    targets.table(rows)


@pytest.mark.parametrize("name", ["sound-grc1", "sound-cmu"])
@MANY
@given(data=st.data())
def test_soil_tests(name: str, data: st.DataObject) -> None:
    """Soil-test files and their tables."""
    content = data.draw(spoilt(parsed("soiltest", name)))
    targets.soiltest(toml(content) + targets.BREAK + data.draw(spoilt_table(seed("soiltest", name, 1))))
    targets.soiltest(toml(content) + targets.BREAK + seed("soiltest", name, 1))


@pytest.mark.parametrize("name", ["sound", "wheel"])
@MANY
@given(data=st.data())
def test_rovers_and_wheels(base: targets.Base, name: str, data: st.DataObject) -> None:
    """Files of rovers and of single wheels."""
    targets.rover(toml(data.draw(spoilt(parsed("rover", name)))))


@FEW
@given(data=st.data())
def test_records_of_results(base: targets.Base, data: st.DataObject) -> None:
    """The record of a result folder."""
    record = json.loads((base.folder / "run.json").read_text(encoding="utf-8"))
    content = data.draw(spoilt(record))
    targets.result(b"\0" + json.dumps(content, default=str).encode())


@pytest.mark.parametrize("number", [pytest.param(i, marks=[pytest.mark.slow] if i > 2 else []) for i in range(1, 7)])
@FEW
@given(data=st.data())
def test_tables_of_results(base: targets.Base, number: int, data: st.DataObject) -> None:
    """The tables and the study of a result folder."""
    content = (base.folder / targets.RESULT_FILES[number]).read_bytes()
    targets.result(bytes([number]) + data.draw(spoilt_table(content)))


@FEW
@given(edits=st.lists(st.tuples(st.integers(0, 2**18), st.integers(0, 255)), min_size=1, max_size=40))
def test_draws_of_results(base: targets.Base, edits: list[tuple[int, int]]) -> None:
    """Draws with other bytes in their places, or cut short."""
    targets.draws(b"".join(at.to_bytes(3, "big") + bytes([to]) for at, to in edits))


@MANY
@given(kind=st.integers(0, 5), data=st.data())
def test_stores(base: targets.Base, kind: int, data: st.DataObject) -> None:
    """Checkpoints, tasks and streams."""
    sound = {0: "sound-begun", 3: "sound-tasks", 4: "sound-stream"}
    if kind in sound:
        content = json.loads((targets.SEEDS / "store" / sound[kind]).read_bytes()[1:])
        targets.store(bytes([kind]) + json.dumps(data.draw(spoilt(content)), default=str).encode())
    else:
        start = (targets.SEEDS / "store" / "sound-segment").read_bytes()
        edits = data.draw(st.binary(max_size=40))
        targets.store(bytes([kind]) + targets.edited(start[1:], edits) if edits else start)


SEEDS = [(target, path) for target in targets.TARGETS for path in targets.seeds(target)]


@pytest.mark.parametrize(("target", "path"), SEEDS, ids=[f"{t}-{p.name}" for t, p in SEEDS])
def test_seeds(base: targets.Base, target: str, path: Path) -> None:
    """Every input that once failed, and the sound ones, which work."""
    targets.TARGETS[target](path.read_bytes())


@pytest.mark.parametrize("target", targets.TARGETS)
def test_targets_notice(base: targets.Base, target: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that lets an error of another library through, or writes beside its folder, is noticed."""
    doors = {
        "study": "load_study", "table": "read_table", "soiltest": "load_soil_test", "rover": "read_rover",
        "result": "read_result", "draws": "read_tree", "store": "read_tasks",
    }  # fmt: skip

    def broken(*args: object, **options: object) -> None:
        raise NameError("a bug")

    def straying(path: Path, *args: object, **options: object) -> None:
        (path if path.is_dir() else path.parent).parent.joinpath("stray").touch()

    (sound, *_) = targets.seeds(target)
    for replacement, found in ((broken, NameError), (straying, Exception)):
        with monkeypatch.context() as patch:
            patch.setattr(targets, doors[target], replacement)
            with pytest.raises(found):
                targets.TARGETS[target](sound.read_bytes())
