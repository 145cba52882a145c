"""Every command on every kind of study: it works, or it says why it cannot, in one of a few ways."""

import re
from pathlib import Path

import pytest

from tests.support.choice import ALL, some
from tests.support.matrix import COMMANDS, FACTORS, Cell, Kind, cells, kinds, quick, title
from tests.support.vocabulary import says_one_thing

PERMITTED = {"follow": ("knows no sweeps, along which",)}
"""What a command may be refused with."""
CHOSEN = [kind for kind in some(kinds(), 5) if ALL or (kind["noise"], kind["errors"]) != ("own", "discrepancy")]
"""Kinds on which every command is run: a law of one's own beside a discrepancy takes minutes."""
DEAR = ("calibrate", "holdout")
"""Commands that sample again and again: of groups, which takes minutes, where BAYESTERRA_ALL is set."""


def judged(kind: Kind, folder: Path, commands: tuple[str, ...]) -> dict[str, Cell]:
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
    return found


def test_every_pair_of_levels_is_there() -> None:
    """Of any two factors, in one of the studies."""
    for one, first in FACTORS.items():
        for other, second in FACTORS.items():
            pairs = {(kind[one], kind[other]) for kind in kinds()}
            wanted = {(a, b) for a in first for b in second if one != other or a == b}
            assert wanted <= pairs


@pytest.mark.parametrize("kind", kinds(), ids=title)
def test_kinds_of_study_are_read_and_simulated(kind: Kind, tmp_path: Path) -> None:
    """Commands that take no samples."""
    judged(kind, tmp_path, ("check", "simulate"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", CHOSEN, ids=title)
def test_every_command_on_every_kind_of_study(kind: Kind, tmp_path: Path) -> None:
    """None ends in a traceback; card, sentence, tables, files and terminal of a run say one thing."""
    left = DEAR if kind["groups"] != "none" and not ALL else ()
    found = judged(kind, tmp_path, tuple(command for command in COMMANDS if command not in left))
    assert found["run"].word == "works"
    says_one_thing(kind, tmp_path / "result", found["run"].printed)
