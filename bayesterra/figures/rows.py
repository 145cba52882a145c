"""The rows of a result's tables by parameter, with their types."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
import pandas as pd

from bayesterra.identifiability import COUPLED
from bayesterra.results import Result


@dataclass(frozen=True)
class Row:
    """A row of the summary, field units."""

    mode: float
    mean: float
    median: float
    sd: float
    hdi90_lo: float
    hdi90_hi: float
    mcse_mean: float
    mcse_median: float
    mcse_sd: float
    ess_bulk: float
    ess_tail: float
    r_hat: float
    prior_mean: float
    prior_sd: float

    @property
    def hdi(self) -> tuple[float, float]:
        """The ends of the 90 % highest-density interval."""
        return self.hdi90_lo, self.hdi90_hi


@dataclass(frozen=True)
class Found:
    """A row of the identifiability table."""

    verdict: str
    contraction: float
    partner: str
    correlation: float
    bound: str
    tied_to: str
    tie: float
    multiple: float
    shift: float = float("nan")

    @property
    def coupled_with(self) -> str:
        """The one parameter that a coupled one hangs on; empty if it takes several, or it is not coupled."""
        return self.tied_to if self.verdict == "coupled" and abs(self.tie) >= COUPLED else ""


def summary_rows(result: Result) -> dict[str, Row]:
    """Rows of the summary by parameter or derived quantity, in its order."""
    names = [field.name for field in fields(Row)]
    return {name: Row(**{key: float(row[key]) for key in names}) for name, row in _records(result.summary)}


def found_rows(result: Result) -> dict[str, Found]:
    """Rows of the identifiability table by parameter, in its order."""
    return {
        name: Found(
            str(row["verdict"]),
            float(row["contraction"]),
            str(row["partner"]),
            float(row["correlation"]),
            str(row["bound"]),
            # folders of versions that did not have these columns coupled with any parameter
            str(row.get("tied_to", row["partner"])),
            float(row.get("tie", row["correlation"])),
            float(row.get("multiple", np.nan)),
            float(row.get("shift", np.nan)),
        )
        for name, row in _records(result.identifiability)
    }


def _records(table: pd.DataFrame) -> list[tuple[str, dict[str, float | str]]]:
    return [(str(row["parameter"]), {str(k): v for k, v in row.items()}) for row in table.to_dict("records")]
