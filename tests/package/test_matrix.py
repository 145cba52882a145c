"""Every command on every kind of study: it works, or it says why it cannot, in one of a few ways."""

import re
from pathlib import Path

import pytest

from tests.support.matrix import COMMANDS, FACTORS, Kind, cells, kinds, lawless, quick, refused_kinds, title

PERMITTED = {"follow": ("knows no sweeps, along which",)}
"""What a command may be refused with, where it has a law."""
NO_LAW = "needs Gaussian noise"
"""Why a study is refused whose pair of levels has none."""


def judged(kind: Kind, folder: Path, commands: tuple[str, ...]) -> None:
    """Assert that commands work on a kind of study, or are refused as they may be."""
    with quick():
        found = dict(cells(kind, folder, commands))
    for command, cell in found.items():
        if cell.word == "works":
            continue
        assert cell.word != "traceback", f"{title(kind)} | {command}: {cell.said}"
        if cell.word == "refused":
            permitted = any(re.search(reason, cell.said) for reason in PERMITTED.get(command, ()))
            assert permitted, f"{title(kind)} | {command}: {cell.said}"


def test_every_pair_of_levels_is_there() -> None:
    """Of any two factors, in one of the studies or among those without a law."""
    everything = [*kinds(), *refused_kinds()]
    for one, first in FACTORS.items():
        for other, second in FACTORS.items():
            pairs = {(kind[one], kind[other]) for kind in everything}
            wanted = {(a, b) for a in first for b in second if one != other or a == b}
            assert wanted <= pairs
    assert not any(lawless(kind) for kind in kinds())


@pytest.mark.parametrize("kind", refused_kinds(), ids=title)
def test_studies_without_a_law_are_refused_with_the_reason(kind: Kind, tmp_path: Path) -> None:
    """By every command alike, in one line that names the table and the channel."""
    with quick():
        for command, cell in cells(kind, tmp_path, ("check", "run", "simulate")):
            assert cell.word == "refused", command
            assert re.search(NO_LAW, cell.said), cell.said


@pytest.mark.parametrize("kind", kinds(), ids=title)
def test_kinds_of_study_are_read_and_simulated(kind: Kind, tmp_path: Path) -> None:
    """Commands that take no samples."""
    judged(kind, tmp_path, ("check", "simulate"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", kinds(), ids=title)
def test_every_command_on_every_kind_of_study(kind: Kind, tmp_path: Path) -> None:
    """None ends in a traceback."""
    judged(kind, tmp_path, tuple(COMMANDS))
