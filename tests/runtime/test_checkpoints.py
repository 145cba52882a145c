"""Segments on disk: read back exactly, recognised when damaged, refused when of another run."""

import json
from dataclasses import dataclass
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from typing_extensions import TypeAliasType

from bayesterra.arrays import FloatArray
from bayesterra.errors import ResultError
from bayesterra.runtime.checkpoints import Checkpoints, difference, pack, unpack
from bayesterra.runtime.ownership import BEGUN
from bayesterra.runtime.reading import read_bytes
from bayesterra.study.canonical import identity, source_digest, write_study
from bayesterra.study.result import Result
from bayesterra.study.study import Study, load_study

KNOWN = {"seed": 1, "model": "M1", "sinkage {} in row 3": "5 mm", "prior of phi": {"dist": "norm"}}


def opened(folder: Path, **changes: Any) -> Checkpoints:
    """Checkpoints of the run that ``KNOWN`` describes, or of another one."""
    work = folder / "out.part" / "checkpoint"
    work.mkdir(parents=True, exist_ok=True)
    return Checkpoints.opened(work, {**KNOWN, **changes})


def saved(folder: Path) -> Path:
    """A folder with one segment; returns the segment."""
    run = opened(folder)
    run.save("round-0001", {"chain": np.linspace(0, 1, 60).reshape(3, 20), "steps": np.array(3)})
    return run.folder / "round-0001.segment"


def test_a_segment_reads_back_exactly(tmp_path: Path) -> None:
    """Arrays keep type, shape and every bit; names that were not saved are not there."""
    arrays = {"a": np.array([[0.1, np.nan], [-0.0, np.inf]]), "b": np.array(7), "c": np.zeros((0, 3), np.uint32)}
    opened(tmp_path).save("one", arrays)
    run = opened(tmp_path)
    back = run.load("one")
    assert back is not None
    for name, array in arrays.items():
        assert (back[name].dtype, back[name].shape) == (array.dtype, array.shape)
        assert back[name].tobytes() == array.tobytes()
    assert run.holds("one")
    assert not run.holds("two")
    assert run.load("two") is None
    assert run.notes == ("going on from 1 saved segment",)
    assert opened(tmp_path / "new").notes == ()


def test_every_damage_is_found(tmp_path: Path) -> None:
    """Cut anywhere or with any bit flipped, a segment is set aside with a note, never read."""
    path, rng = saved(tmp_path), np.random.default_rng(1)
    whole = path.read_bytes()
    cuts = [whole[:n] for n in (0, 1, 64, 65, 66, len(whole) - 1, *rng.integers(len(whole), size=30))]
    flips = []
    for place in (0, 64, 65, *rng.integers(len(whole), size=60)):
        flipped = bytearray(whole)
        flipped[place] ^= 1 << int(rng.integers(8))
        flips.append(bytes(flipped))
    for damaged in [*cuts, *flips, whole + b"x", b"\0" * len(whole)]:
        path.write_bytes(damaged)
        run = opened(tmp_path)
        assert run.notes == ("the saved segment 'round-0001.segment' is damaged and is made again",)
        assert run.load("round-0001") is None
        assert not path.exists()


@pytest.mark.parametrize("name", ["round-0001.segment", BEGUN])
def test_a_folder_in_place_of_a_file_is_named_and_left(tmp_path: Path, name: str) -> None:
    """Nobody's folder is removed; the message says which one."""
    path = saved(tmp_path).with_name(name)
    path.unlink()
    path.mkdir()
    with pytest.raises(ResultError, match=rf"{name}' is not a file: move it away"):
        opened(tmp_path)
    assert path.is_dir()


def test_what_was_not_finished_is_not_there(tmp_path: Path) -> None:
    """A segment that was being written when its process died is nothing."""
    path = saved(tmp_path)
    path.rename(path.with_name(path.name + ".new"))
    run = opened(tmp_path)
    assert run.notes == ()
    assert not run.holds("round-0001")


def test_another_run_is_refused_in_plain_words(tmp_path: Path) -> None:
    """The message says what the run was begun with and what to do; the segments stay."""
    path = saved(tmp_path)
    for changes, message in (
        ({"seed": 2}, r"out\.part' was begun with seed 1, not 2; add --overwrite in place of --resume"),
        ({"sinkage {} in row 3": "6 mm"}, "was begun with sinkage 5 mm in row 3, not 6 mm;"),
        ({"prior of phi": {"dist": "norm", "loc": 0.5123456789, "scale": 0.1}}, "with another prior of phi;"),
        ({"prior of c": 3.0}, r"was begun without prior of c 3\.0;"),
    ):
        with pytest.raises(ResultError, match=message):
            opened(tmp_path, **changes)
    assert path.exists()


def test_segments_know_their_run(tmp_path: Path) -> None:
    """When the description of the run is lost, segments of another run are still refused, their own used."""
    path = saved(tmp_path)
    for ruin in ((path.parent / BEGUN).unlink, lambda: (path.parent / BEGUN).write_text("{}")):
        ruin()
        with pytest.raises(ResultError, match="was begun with another study, seed or version"):
            opened(tmp_path, seed=2)
        assert opened(tmp_path).load("round-0001") is not None
    flipped = (path.parent / BEGUN).read_text(encoding="utf-8").replace('"seed": 1', '"seed": 3')
    (path.parent / BEGUN).write_text(flipped, encoding="utf-8")
    assert opened(tmp_path).load("round-0001") is not None


def test_a_segment_under_another_name_is_refused(tmp_path: Path) -> None:
    """A round that is renamed to another one does not pass for it."""
    path = saved(tmp_path)
    path.rename(path.with_name("round-0002.segment"))
    with pytest.raises(ResultError, match="add --overwrite in place of --resume"):
        opened(tmp_path)


def test_nothing_that_is_read_can_run(tmp_path: Path) -> None:
    """Even with the right checksum a pickled object is not unpacked."""
    run, arrays = opened(tmp_path), BytesIO()
    np.savez(arrays, a=np.array([{}], dtype=object))
    content = json.dumps({"run": run.run, "segment": "one"}).encode() + b"\n" + arrays.getvalue()
    checksum = sha256(content).hexdigest().encode()
    (run.folder / "one.segment").write_bytes(checksum + b"\n" + content)
    assert run.load("one") is None


Numbers = TypeAliasType("Numbers", NDArray[np.float64])  # what NumPy 2.5 calls arrays on Python 3.12 and above


@dataclass(frozen=True)
class Kept:
    """Something to save."""

    draws: FloatArray
    named: Numbers
    count: int
    seconds: float
    widths: tuple[float, ...]
    more: FloatArray | None = None


@pytest.mark.parametrize("more", [None, np.eye(2)])
def test_what_is_packed_is_unpacked(more: FloatArray | None) -> None:
    """Arrays come back as arrays and numbers as numbers, whatever a version of NumPy calls its arrays."""
    kept = Kept(np.linspace(0, 1, 5), np.arange(6.0).reshape(2, 3), 3, 0.25, (1.0, 2.5), more)
    back = unpack(Kept, pack(kept))
    for name in ("draws", "named", "more"):
        np.testing.assert_array_equal(getattr(back, name), getattr(kept, name))
    assert (back.count, back.seconds, back.widths) == (3, 0.25, (1.0, 2.5))
    assert isinstance(back.count, int)


@pytest.fixture
def study(small_result: Result) -> Study:
    """The HIT study."""
    return small_result.study


def told(before: Study, after: Study, seeds: tuple[int, int] = (1, 1)) -> str:
    """What the message says of two runs."""
    one, other = (json.loads(json.dumps(identity(s, n))) for s, n in zip((before, after), seeds, strict=True))
    assert one != other
    return difference(one, other)


def test_differences_of_studies_are_named(study: Study, tmp_path: Path) -> None:
    """Seed, settings, readings, noise and priors are told apart by name, in the user's units."""
    sinkage = study.observations.values["sinkage"].copy()
    old = sinkage[2]
    sinkage[2] += 1e-3
    assert told(study, study, (1, 2)) == "was begun with seed 1, not 2"
    assert told(study, study.with_data({"sinkage": sinkage})).startswith(f"was begun with sinkage {1e3 * old:.4g}")
    assert "mm in row 3, not" in told(study, study.with_data({"sinkage": sinkage}))
    write_study(study, tmp_path)
    text = (tmp_path / "study.toml").read_text(encoding="utf-8")
    for line, new, message in (
        ('model = "M1"', 'model = "M3"', "with model M1, not M3"),
        ("target_ess = 400", "target_ess = 500", "with target_ess 400, not 500"),
        ('sinkage = "1 mm"', 'sinkage = "2 mm"', "with noise of sinkage 1 mm, not 2 mm"),
        ('width = "165 mm"', 'width = "166 mm"', "with width 165 mm of wheel Wh32, not 166 mm"),
        ("transition_slips = [0.1, 0.5]", "transition_slips = [0.1, 0.4]",
         "with [model_options] transition_slips [0.1, 0.5], not [0.1, 0.4]"),
    ):  # fmt: skip
        assert line in text
        (tmp_path / "study.toml").write_text(text.replace(line, new, 1), encoding="utf-8")
        assert message in told(study, load_study(tmp_path))
    table = tmp_path / "measurements.csv"
    lines = table.read_text(encoding="utf-8").splitlines()
    table.write_text("\n".join(lines[:-1]) + "\n", encoding="utf-8")
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    rows = len(study.observations)
    assert told(study, load_study(tmp_path)) == f"was begun with {rows} rows of measurements, not {rows - 1}"


def test_texts_and_paths_do_not_matter(study: Study, tmp_path: Path) -> None:
    """A study that is written, retitled and read again is the same run."""
    write_study(study, tmp_path)
    file = tmp_path / "study.toml"
    file.write_text(file.read_text(encoding="utf-8").replace(study.title, "Another title"), encoding="utf-8")
    assert identity(load_study(tmp_path), 1) == identity(study, 1)


def test_the_code_is_part_of_a_run(study: Study, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other sources or another release are another run; the digest covers models and all layers."""
    before = identity(study, 1)
    monkeypatch.setattr("bayesterra.study.canonical.source_digest", lambda: "0" * 64)
    assert difference(before, identity(study, 1)) == "was begun with another build of bayesterra"
    monkeypatch.setattr("bayesterra.study.canonical.version", lambda name: "9.9")
    assert "not 9.9" in difference(before, identity(study, 1))
    assert before["build of bayesterra"] == source_digest()


def test_a_piece_that_may_not_be_read_is_no_damaged_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Another user's segment stays where it is; a line names it and says what to do."""
    run = opened(tmp_path)
    run.save("one", {"a": np.zeros(3)})

    def forbidden(path: Path, most: int) -> bytes:
        if path.name == "one.segment":
            raise PermissionError(13, "Permission denied")
        return read_bytes(path, most)

    monkeypatch.setattr("bayesterra.runtime.checkpoints.read_bytes", forbidden)
    message = r"one\.segment' cannot be read \(Permission denied\): ask its owner for leave to read it"
    with pytest.raises(ResultError, match=message):
        opened(tmp_path)
    assert (run.folder / "one.segment").is_file()


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On opening and on saving, in one line; what was saved before stays."""

    def full(path: Path, content: object) -> None:
        raise OSError(28, "No space left on device", str(path))

    work = opened(tmp_path)
    work.save("one", {"a": np.arange(3)})
    monkeypatch.setattr("bayesterra.runtime.checkpoints.write_bytes", full)
    monkeypatch.setattr("bayesterra.runtime.checkpoints.write_text", full)
    with pytest.raises(ResultError, match=r"checkpoint' cannot be written: No space left on device"):
        work.save("two", {"a": np.arange(3)})
    with pytest.raises(ResultError, match=r"begun\.json' cannot be read or written: No space left on device"):
        opened(tmp_path / "new")
    assert work.holds("one")
    assert not work.holds("two")
