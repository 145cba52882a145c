"""Sampling coordinates that straighten no ridge: the parameters as they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.sampling.coordinates import Coordinates


@dataclass(frozen=True)
class Plain:
    """Parameters that are their own coordinates; see :class:`bayesterra.sampling.coordinates.Block`."""

    def from_physical(self, x: FloatArray) -> FloatArray:
        """The same."""
        return x

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same, and the log Jacobian 0."""
        return u, np.zeros(len(u))


def plain_coordinates(names: Sequence[str]) -> Coordinates:
    """Physical parameters as they are."""
    return Coordinates(((tuple(range(len(names))), Plain()),))
