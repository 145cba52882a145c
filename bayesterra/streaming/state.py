"""A stream on disk: study and rows as any study has them, and one checked segment with the particles."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bayesterra.arrays import FloatArray
from bayesterra.checkpoints import Checkpoints, Identity, digest
from bayesterra.checksums import check_sums
from bayesterra.errors import ResultError
from bayesterra.folders import SEGMENT, write_text
from bayesterra.reading import damage, read_json
from bayesterra.sampling.journal import pack, unpack
from bayesterra.streaming.changes import Candidates
from bayesterra.streaming.cloud import Cloud
from bayesterra.streaming.updates import Alarm
from bayesterra.study import STUDY_FILE, Study
from bayesterra.writing import write_study

MARK = "stream.json"
"""File by which folders of this kind are known."""
STATE = "state"


@dataclass(frozen=True)
class State:
    """All that a stream holds besides its study and its rows; its size does not grow with the rows.

    Attributes
    ----------
    cloud : the particles.
    before : draws of the prior (k, d).
    candidates : rows at which the soil may have changed.
    basis : number of rows behind the coordinates of the candidates; 0 before there are any.
    log_evidence, variance : of all rows; variance settled at resamplings.
    alarm : if there was one.
    """

    cloud: Cloud
    before: FloatArray
    candidates: Candidates
    basis: int
    log_evidence: float
    variance: float
    alarm: Alarm | None


def write_state(
    folder: Path, study: Study, state: State, identity: Identity, record: Mapping[str, Any]
) -> None:
    """Write study, state and record into an existing folder."""
    write_study(study, folder)
    (folder / STATE).mkdir()
    Checkpoints.opened(folder / STATE, identity).save(STATE, pack(state))
    write_text(folder / MARK, json.dumps(record, indent=1, ensure_ascii=False) + "\n")


def read_record(folder: Path) -> dict[str, Any]:
    """The record of a saved stream.

    Raises
    ------
    ResultError : there is none, or it is damaged.
    """
    if not (folder / MARK).is_file():
        raise ResultError(f"'{folder}' is not the folder of a stream: it has no {MARK}")
    check_sums(folder, MARK, STUDY_FILE, "measurements.csv")
    with damage(ResultError, folder / MARK):
        return dict(read_json(folder / MARK))


def read_state(folder: Path, identity: Identity) -> State:
    """The state of a saved stream.

    Raises
    ------
    ResultError : it is missing or damaged, or belongs to another study or other rows.
    """
    try:
        segment = Checkpoints(folder / STATE, digest(identity)).load(STATE)
    except ResultError as error:
        text = f"'{folder}' is damaged: its particles belong to another study or other rows"
        raise ResultError(text) from error
    if segment is None:
        raise ResultError(f"'{folder}' is damaged: the particles cannot be read ({STATE}/{STATE}{SEGMENT})")
    with damage(ResultError, folder):
        return unpack(State, segment)
