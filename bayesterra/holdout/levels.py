"""Groups of rows that are left out together."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from numbers import Integral
from typing import TypeAlias

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.errors import StudyError
from bayesterra.messages import did_you_mean
from bayesterra.study import Study

TOLERANCE = 0.03
"""Slips nearer than this count as one level."""
WAYS = ("slip", "wheel", "row")

By: TypeAlias = str | Sequence[object]
"""How rows are grouped: see :func:`levels`."""


@dataclass(frozen=True)
class Level:
    """Rows that are left out together.

    Attributes
    ----------
    name : for tables and figures.
    left : (m,) which rows of the study's table these are; rows in use only.
    """

    name: str
    left: BoolArray


def clusters(values: FloatArray, tolerance: float) -> IntArray:
    """Number of the cluster of each value (m,), ascending; a gap wider than ``tolerance`` parts two.

    >>> clusters(np.array([0.5, 0.02, 0.51, 0.0]), 0.03).tolist()
    [1, 0, 1, 0]
    """
    order = np.argsort(values, kind="stable")
    numbers = np.zeros(len(values), dtype=np.int64)
    numbers[order[1:]] = np.cumsum(np.diff(values[order]) > tolerance)
    return numbers


def levels(study: Study, by: By = "slip", tolerance: float = TOLERANCE) -> tuple[Level, ...]:
    """Group the rows in use.

    Parameters
    ----------
    by : ``slip`` (slips nearer than ``tolerance``, each to the next, are one level), ``wheel`` or ``row``; or
        groups of row numbers, ``[[1, 2], [3]]``, of which only these are left out; or one label for every row
        of the study's table.
    tolerance : for ``slip``.

    Raises
    ------
    StudyError : an unknown grouping, row numbers that are not in use or named twice, or nothing to fit to
        once a level is left out.
    """
    if not tolerance >= 0:
        raise StudyError(f"'tolerance' must not be negative (got {tolerance:g})")
    found = _named(study, by, tolerance) if isinstance(by, str) else _listed(study, by)
    use = study.observations.use
    found = [level for level in found if level.left.any()]
    if len(found) < 2 and (not found or found[0].left.sum() == use.sum()):
        what = f"levels of '{by}'" if isinstance(by, str) else "groups of rows"
        wide = f" at tolerance {tolerance:g}" if by == "slip" else ""
        raise StudyError(f"to leave one out there must be two or more {what} (got {len(found)}{wide})")
    return tuple(found)


def _named(study: Study, by: str, tolerance: float) -> list[Level]:
    rows = study.observations
    if by == "wheel":
        return _labelled(study, rows.wheel)
    if by == "row":
        return _labelled(study, [f"row {row}" for row in rows.rows])
    if by != "slip":
        raise StudyError(
            f"'by' must be {', '.join(WAYS)} or groups of rows (got '{by}'){did_you_mean(by, WAYS)}"
        )
    used = np.flatnonzero(rows.use)
    number = np.full(len(rows), -1)
    number[used] = clusters(rows.slip[used], tolerance)
    parts = [number == k for k in range(number.max() + 1)]
    return [Level(f"slip {rows.slip[part].mean():.3f}", part) for part in parts]


def _labelled(study: Study, labels: Sequence[object]) -> list[Level]:
    use = study.observations.use
    texts = np.array([str(label) for label in labels], dtype=object)
    return [Level(text, np.asarray((texts == text) & use)) for text in dict.fromkeys(texts)]


def _listed(study: Study, by: Sequence[object]) -> list[Level]:
    """Groups of row numbers, or labels."""
    rows = study.observations
    if not any(isinstance(entry, list | tuple | np.ndarray) for entry in by):
        if len(by) != len(rows):
            raise StudyError(f"'by' must have one label for each of {len(rows)} rows (got {len(by)})")
        return _labelled(study, list(by))
    known = {row: i for i, row in enumerate(rows.rows) if rows.use[i]}
    found, seen = [], set[int]()
    for group in by:
        numbers = list(group) if isinstance(group, list | tuple | np.ndarray) else [group]
        left = np.zeros(len(rows), dtype=np.bool_)
        for number in numbers:
            if not isinstance(number, Integral) or int(number) not in known:
                raise StudyError(f"'by' must hold numbers of rows in use (got {number!r})")
            if int(number) in seen:
                raise StudyError(f"'by' must name a row once (row {number} is named twice)")
            seen.add(int(number))
            left[known[int(number)]] = True
        found.append(Level("row " + ", ".join(str(number) for number in numbers), left))
    return found
