"""The drive of a study: what is known of a row beside its slip, and what is an outcome.

``load``      slip and load given; sinkage, drawbar pull and moment are outcomes (the testbed's causality).
``sinkage``   slip and sinkage given; normal force, drawbar pull and moment are outcomes (the paper's way).
``both``      slip given; the load is latent and all four readings are outcomes
              (:mod:`bayesterra.likelihood.likelihood`).
"""

from enum import StrEnum
from typing import Self

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.parameters import OUTCOMES
from bayesterra.study.observations import Observations


class Drive(StrEnum):
    """Drive of a study; its text is that of study files and records.

    Attributes
    ----------
    idle : channels beside slip that are no readings: what is conditioned on, and what may stand for it.
    kept : channels whose readings somebody knows who plans a row: the load's, or what stands for it.
    needed : columns of which a table, or with a latent load every row, must hold one.
    sentence : what is given and what is an outcome, for pages.
    level : what curves over slip are drawn at.
    plan : all that stays known of a row whose readings are left out.
    """

    idle: tuple[str, ...]
    kept: tuple[str, ...]
    needed: str
    sentence: str
    level: str
    plan: str

    LOAD = (
        "load",
        ("load", "normal_force"),
        (),
        "'load [N]' or 'normal_force [N]'",
        "Slip and load are given; sinkage, drawbar pull and moment are outcomes.",
        "the median load of the readings",
        "slip, wheel and load",
    )
    SINKAGE = (
        "sinkage",
        ("sinkage",),
        ("sinkage",),
        "'sinkage [mm]'",
        "Slip and sinkage are given; normal force, drawbar pull and moment are outcomes.",
        "the measured sinkages, joined by straight lines",
        "slip, wheel and sinkage",
    )
    BOTH = (
        "both",
        ("load",),
        ("normal_force",),
        "'sinkage' or 'normal_force'",
        "Slip is given; the load of a row is unknown, and sinkage, normal force, drawbar pull and moment are outcomes.",
        "the median normal force of the readings",
        "slip, wheel and the reading of the normal force, from which each draw’s load is inferred",
    )

    def __new__(
        cls, text: str, idle: tuple[str, ...] = (), kept: tuple[str, ...] = (), needed: str = "", *sentences: str
    ) -> Self:
        """Text by which study files name it, and its facts."""
        member = str.__new__(cls, text)
        member._value_ = text
        member.idle, member.kept, member.needed = idle, kept, needed
        member.sentence, member.level, member.plan = sentences
        return member

    @property
    def by_sinkage(self) -> bool:
        """True where the sinkage is given, and not the load."""
        return self is Drive.SINKAGE

    @property
    def latent_load(self) -> bool:
        """True where the load of a row is known by its readings only."""
        return self is Drive.BOTH

    @property
    def reads_force(self) -> bool:
        """True where the normal force is an outcome, and so what a load in the table is a reading of."""
        return self is not Drive.LOAD

    @property
    def outcomes(self) -> tuple[str, ...]:
        """Channels that are outcomes, in the order of :data:`bayesterra.parameters.OUTCOMES`."""
        return tuple(name for name in OUTCOMES if name not in self.idle)

    @property
    def with_load(self) -> "Drive":
        """The same where every load is known."""
        return Drive.LOAD if self.latent_load else self

    def conditioned(self, rows: Observations) -> dict[str, FloatArray]:
        """Columns (m,) that are conditioned on beside slip, by channel; NaN where they are empty."""
        columns = {"load": rows.load, **rows.values}
        return {} if self.latent_load else {str(self): columns.get(self, np.full(len(rows), np.nan))}

    def given(self, rows: Observations) -> FloatArray:
        """Sinkage (m) or load (N) of every row (m,) that the model is given; a latent load as best known."""
        return rows.values["sinkage"] if self.by_sinkage else rows.known_loads
