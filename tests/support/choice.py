"""Which cases of a long repeat are tried on every change, and which before a release only."""

import os
from collections.abc import Sequence
from typing import TypeVar

Case = TypeVar("Case")
ALL = "BAYESTERRA_ALL" in os.environ
"""Whether every case of every repeat is tried, which takes an hour more."""


def some(cases: Sequence[Case], most: int) -> list[Case]:
    """The cases; unless all are asked for, ``most`` of them, evenly spread, the first among them."""
    return list(cases) if ALL else [cases[i * len(cases) // most] for i in range(min(most, len(cases)))]
