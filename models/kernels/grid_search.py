"""Compiled search for the smallest sinkage that carries a load where F_N does not rise all the way to z = r.

Over the prior box F_N of M1 rises with z wherever c3 >= 0; with c3 < 0 it can start out negative. F_N of M2
and M3 can have one maximum, beyond z = 0.36 r, when theta_m is close to theta_1.
"""

import numpy as np

from bayesterra.models.kernels import lanes as at
from bayesterra.models.kernels.compiler import Lanes, called
from bayesterra.models.kernels.evaluation import M1, Kind
from bayesterra.models.kernels.solver import misfit, refine

_DEPTH = 12.0  # the grid begins this far below the radius in log z
_ROUNDS = 40
_NARROW = 1e-10


@called
def can_fall(ws: Lanes, lane: int, kind: Kind) -> bool:
    """True where F_N of a lane may be larger below z = r than at it."""
    return len(kind) != M1 or ws[at.C3 + lane] < 0.0


@called
def search_by_grid(ws: Lanes, lane: int, kind: Kind, which: int, tray: Lanes) -> None:
    """Fill `tray` with the solution of one lane, the same in all lanes; X = inf where F_N stays below the load."""
    for start in range(0, at.SIZE, at.LANES):
        for i in range(at.LANES):
            tray[start + i] = ws[start + lane]
    low, high = tray[at.TOP] - _DEPTH, tray[at.TOP]
    for _ in range(_ROUNDS):
        _lay_grid(tray, low, high)
        misfit(tray, kind, which)
        carrying = _first_carrying(tray)
        if carrying < at.LANES:
            _bracket(tray, carrying)
            refine(tray, kind, which)
            return
        peak = 0
        for i in range(1, at.LANES):
            peak = i if tray[at.F + i] > tray[at.F + peak] else peak
        low, high = tray[at.X + max(peak - 1, 0)], tray[at.X + min(peak + 1, at.LANES - 1)]
        if high - low < _NARROW:
            break
    tray[at.X] = np.inf


@called
def _lay_grid(tray: Lanes, low: float, high: float) -> None:
    for i in range(at.LANES):
        tray[at.X + i] = low + (high - low) * i / (at.LANES - 1)


@called
def _first_carrying(tray: Lanes) -> int:
    for i in range(at.LANES):
        if tray[at.F + i] >= 0.0:
            return i
    return at.LANES


@called
def _bracket(tray: Lanes, carrying: int) -> None:
    """Start all lanes between the first grid point that carries the load and the one before it."""
    high = tray[at.X + carrying]
    low = tray[at.X + carrying - 1] if carrying > 0 else high - _DEPTH
    for i in range(at.LANES):
        tray[at.LOW + i], tray[at.HIGH + i] = low, high
        tray[at.X + i] = tray[at.X_BEFORE + i] = 0.5 * (low + high)
        tray[at.SLOPE + i], tray[at.DOUBT + i], tray[at.DONE + i] = 1.0, 1.0, 0.0
