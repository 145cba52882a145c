"""Which cases of a long repeat are tried on every change, and which before a release only."""

import os
from collections.abc import Sequence
from typing import TypeVar
from zlib import crc32

Case = TypeVar("Case")
ALL = "BAYESTERRA_ALL" in os.environ
"""Whether every case of every repeat is tried, which takes an hour more."""


def some(cases: Sequence[Case], most: int) -> list[Case]:
    """The cases; unless all are asked for, ``most`` of them, evenly spread, the first among them."""
    return list(cases) if ALL else [cases[i * len(cases) // most] for i in range(min(most, len(cases)))]


def within(name: str, share: str) -> bool:
    """Whether a test is in a share of all, ``2/4`` for the second of four; ValueError for one that is none."""
    number, shares = map(int, share.split("/"))
    if not 1 <= number <= shares:
        raise ValueError(f"the share must be like 2/4 (got {share})")
    return crc32(name.encode()) % shares == number - 1
