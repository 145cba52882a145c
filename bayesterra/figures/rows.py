"""The rows of a result's tables by parameter, with their types."""

from __future__ import annotations

from dataclasses import dataclass, fields

import pandas as pd

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
        )
        for name, row in _records(result.identifiability)
    }


def _records(table: pd.DataFrame) -> list[tuple[str, dict[str, float | str]]]:
    return [(str(row["parameter"]), {str(k): v for k, v in row.items()}) for row in table.to_dict("records")]
