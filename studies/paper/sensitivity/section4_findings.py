"""A row of the index: a statement of the paper's Section 4, what it is read as, and what M1 gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from sensitivity.groups import REFERENCE

FIT = dict(zip(("z", "F_DP", "M_DR"), np.array(REFERENCE.printed_errors) * 100, strict=True))
"""The printed error of G1 against the measurements, percent: what the paper itself takes for a fit."""


@dataclass(frozen=True)
class Finding:
    """A row of the index.

    Attributes
    ----------
    place : table or figure.
    statement : what the paper says, shortened.
    reading : what it is read as, where it gives no number.
    ours : what M1 gives.
    holds : whether it does.
    """

    place: str
    statement: str
    reading: str
    ours: str
    holds: bool
