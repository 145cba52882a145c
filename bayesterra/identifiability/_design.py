"""What a study measures where, and which of it can be the reason that parameters stay unseen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.identifiability.sensitivities import read_where
from bayesterra.parameters import CHANNELS, MODULI
from bayesterra.posteriors import Posterior


@dataclass(frozen=True)
class Design:
    """Rows and channels of a study.

    Attributes
    ----------
    rows : number of rows in the fit.
    slips, widths, given : distinct slips, wheel widths (m), and loads (N; none where latent) or sinkages (m).
    channels, missing : outcomes of the drive that are read, and that are not.
    readings : number of readings that differ in more than their error, less one per latent load.
    """

    rows: int
    slips: FloatArray
    widths: FloatArray
    given: FloatArray
    channels: tuple[str, ...]
    missing: tuple[str, ...]
    readings: int

    def reasons(self, parameters: Sequence[str], free: int | None = None) -> list[str]:
        """What in the design may be why directions among ``parameters`` are not seen.

        ``free`` is the number of parameters to be found, where too few readings may be the reason.
        """
        found = []
        if {"n1", "c2"} & set(parameters) and len(self.slips) == 1:
            found.append(f"all rows have the slip {self.slips[0]:.3g}")
        if set(MODULI) <= set(parameters) and len(self.widths) == 1:
            found.append(f"all wheels are {1e3 * self.widths[0]:.3g} mm wide")
        load_driven = "normal_force" not in (*self.channels, *self.missing)
        if {"cDP", "cM"} & set(parameters) and load_driven and len(self.given) == 1:
            found.append(f"all rows have the load {self.given[0]:.3g} N")
        if free is not None and self.readings < free:
            found.append(f"{_counted(self.readings, 'different reading')} for {free} parameters")
        return found

    def __str__(self) -> str:
        """Name rows, slips, widths and channels in a line."""
        read = ", ".join(CHANNELS[name].description for name in self.channels)
        ends = f"{self.slips[0]:.3g}" + (f" to {self.slips[-1]:.3g}" if len(self.slips) > 1 else "")
        rows, slips = _counted(self.rows, "row"), _counted(len(self.slips), "slip")
        return f"{rows} at {slips} ({ends}), {_counted(len(self.widths), 'wheel width')}; {read}"


def _counted(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"


def design_of(posterior: Posterior) -> Design:
    """The design of a study."""
    likelihood = posterior.likelihood
    forward, conditions = likelihood.forward, likelihood.forward.conditions
    latent = forward.drive == "both"
    columns = [conditions.slip, conditions.radius, conditions.width, conditions.lug_height]
    columns.append(np.zeros(len(conditions.slip)) if latent else forward.given)
    _, first = np.unique(np.round(np.column_stack(columns), 9), axis=0, return_index=True)
    each = read_where(posterior, likelihood.channels)[first].sum(axis=1)
    return Design(
        rows=len(conditions.slip),
        slips=np.unique(np.round(conditions.slip, 9)),
        widths=np.unique(np.round(conditions.width, 9)),
        given=np.empty(0) if latent else np.unique(forward.given),
        channels=likelihood.channels,
        missing=tuple(name for name in forward.outcomes if name not in likelihood.channels),
        readings=int(np.maximum(each - latent, 0).sum()),
    )
