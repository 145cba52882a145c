"""The watch for a change of soil: candidates from row to row, and the alarm."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from bayesterra.coordinates import coordinates
from bayesterra.likelihood import Likelihood
from bayesterra.posteriors import Posterior
from bayesterra.streaming.changes import FIRST, Basis, Candidates
from bayesterra.streaming.cloud import Cloud
from bayesterra.streaming.updates import Alarm

EVIDENCE = 0.9
"""Share of the evidence between the first and the last row that an alarm names."""


class Watch:
    """Looks for a change of soil until it finds one.

    Parameters
    ----------
    rate : false alarms per row, at most, on average over the prior; None does not look.
    d : number of parameters.
    known : posterior of the first so many rows, by their number; gives the coordinates of the candidates.
    """

    def __init__(self, rate: float | None, d: int, known: Callable[[int], Posterior]) -> None:
        self.rate, self._known = rate, known
        self.candidates = Candidates.none(d)
        self.alarm: Alarm | None = None
        self.basis = 0
        self._based: Basis | None = None

    def see(
        self, number: int, rows: int, before: Cloud, row: Likelihood, log_predictive: float
    ) -> Alarm | None:
        """Take in a row; an alarm where it first seems that the soil has changed.

        Parameters
        ----------
        number, rows : of the row, and of all rows of this soil.
        before : cloud of the rows before it.
        log_predictive : log density of its readings if the soil is the same, among soils that have an answer.
        """
        if self.rate is None or self.alarm is not None or rows < FIRST:
            return None
        # coordinates that suit the rows so far, looked for anew whenever these have doubled
        basis = self.based(1 << ((rows - 1).bit_length() - 1))
        candidates = basis.opened(self.candidates, number, before)
        self.candidates = basis.followed(candidates, row, log_predictive).pruned()
        if self.candidates.log_statistic >= -np.log(self.rate):
            self.alarm = alarm_of(number, self.candidates, self.rate)
        return self.alarm

    def based(self, rows: int) -> Basis:
        """Coordinates after so many rows; candidates are carried over to them."""
        if self._based is None or self.basis != rows:
            posterior = self._known(rows)
            found = Basis(posterior, coordinates(posterior))
            if self._based is not None:
                self.candidates = self._based.rebased(self.candidates, found)
            self.basis, self._based = rows, found
        return self._based

    def go_on(self, candidates: Candidates, basis: int, alarm: Alarm | None) -> None:
        """Stand where another watch stood."""
        if basis:
            self.based(basis)
        self.candidates, self.alarm = candidates, alarm


def alarm_of(number: int, candidates: Candidates, rate: float) -> Alarm:
    """The alarm that candidates raise at a row."""
    order = np.argsort(-candidates.shares, kind="stable")
    enough = 1 + int((np.cumsum(candidates.shares[order]) < EVIDENCE).sum())
    likely = candidates.since[order[:enough]]
    return Alarm(
        row=number,
        since=int(likely[0]),
        first=int(likely.min()),
        last=int(likely.max()),
        log_statistic=candidates.log_statistic,
        rate=rate,
    )
