"""The paper's parameter groups, coordinates that stay within a group, and combinations in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import ndtr, ndtri

from bayesterra.arrays import FloatArray
from bayesterra.coordinates import Bearing, Block, Contact, Coordinates, Moduli, coordinates
from bayesterra.diagnostics import rank_scores
from bayesterra.parameters import MODULI, PARAMETERS
from bayesterra.posteriors import Posterior

GROUPS = ("P_I", "P_II", "P_III", "load effect")
"""Bearing, shearing, contact angles; the load effect of M2L."""
KNOTS = 65
"""Points at which the normal score of a law is taken from its draws; straight lines in between."""
TAIL = 10
"""Pieces, about one unit of the score, whose slope goes on beyond the last knot. That of one piece hangs
on the gap between two draws, which may be no gap at all."""


def group_columns(names: Sequence[str]) -> dict[str, list[int]]:
    """Columns of the free parameters of each group; k_c and k_φ stand in the place of K_s, in P_I."""
    of = {name: "P_I" if name in MODULI else PARAMETERS[name].group for name in names}
    columns = {group: [i for i, name in enumerate(names) if of[name] == group] for group in GROUPS}
    return {group: held for group, held in columns.items() if held}


def within_groups(posterior: Posterior) -> Coordinates:
    """The sampling coordinates, but none that mixes groups: the stress is taken at θm = θ1/2 throughout.

    They straighten the ridges within a group and leave the dependence between groups as it is.
    """
    blocks: list[tuple[tuple[int, ...], Block]] = []
    for columns, block in coordinates(posterior).blocks:
        contact = block.inner if isinstance(block, Moduli) else block
        if not isinstance(contact, Contact):
            blocks.append((columns, block))
            continue
        bearing: Block = Bearing(contact.stress)
        if isinstance(block, Moduli):
            bearing = Moduli(block.score, block.width, bearing)
        blocks += [(columns[:-2], bearing), (columns[-2:], contact.angles)]
    return Coordinates(tuple(blocks))


def spaced(draws: FloatArray, most: int) -> FloatArray:
    """At most this number of draws (n, d), evenly spaced."""
    return draws[:: max(1, -(-len(draws) // most))]


def ranked(draws: FloatArray) -> FloatArray:
    """Normal scores of every column's ranks (n, d)."""
    return np.column_stack([rank_scores(column) for column in draws.T])


def scores_under(reference: FloatArray, draws: FloatArray) -> FloatArray:
    """Normal scores (n, d) of draws under the marginal laws of ``reference`` (m, d), column by column.

    Scores do not depend on the unit or scale, such as K_s or log K_s, that a parameter is stated in.
    """
    farthest = ndtri(1.0 - 2.0 / len(reference))
    scores = np.linspace(-farthest, farthest, KNOTS)
    knots = np.quantile(reference, ndtr(scores), axis=0)
    return np.column_stack([_broken_line(draws[:, i], knots[:, i], scores) for i in range(draws.shape[1])])


def _broken_line(x: FloatArray, knots: FloatArray, values: FloatArray) -> FloatArray:
    """Linear interpolation, continued beyond both ends along the chord of the outermost ``TAIL`` pieces."""
    knots, first = np.unique(knots, return_index=True)
    values = values[first]
    inner = min(TAIL, len(knots) - 1)
    below = (values[inner] - values[0]) / (knots[inner] - knots[0])
    above = (values[-1] - values[-1 - inner]) / (knots[-1] - knots[-1 - inner])
    beyond = below * np.minimum(x - knots[0], 0.0) + above * np.maximum(x - knots[-1], 0.0)
    return np.asarray(np.interp(x, knots, values) + beyond)


def in_words(names: Sequence[str], weights: FloatArray, least: float = 0.1) -> str:
    """A combination of parameters as text, such as ``K_s + 0.62 n0 − 0.35 n1``.

    The heaviest parameter comes first and has the weight 1; weights below ``least`` of it are left out.
    """
    order = np.argsort(-np.abs(weights), kind="stable")
    relative = weights / weights[order[0]]
    terms = [_term(names[i], float(relative[i])) for i in order[1:] if abs(relative[i]) >= least]
    return " ".join([PARAMETERS[names[order[0]]].symbol, *terms])


def _term(name: str, weight: float) -> str:
    sign = "−" if weight < 0 else "+"
    size = f"{abs(weight):.2g}"
    return f"{sign} {PARAMETERS[name].symbol}" if size == "1" else f"{sign} {size} {PARAMETERS[name].symbol}"
