"""One word for each parameter, from all that was measured about it, and where the methods disagree.

===========================  ===========================================================================
structurally not determined  no data of this design can tell it
determined                   its variance shrinks to a tenth or less of the cut prior's, away from its bounds
coupled                      not on its own, but in combination with others that are not known either
one-sided                    one end is its prior's bound, or the data exclude one side only
weakly                       its variance shrinks by ``WEAK`` or more
moved                        hardly narrowed, but its law is another one than the cut prior: they disagree
repeats its prior            none of these
===========================  ===========================================================================
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray, IntArray

DETERMINED = 0.9
"""Contraction from which a parameter or direction counts as determined: sd below a third of the prior's."""
WEAK = 0.3
"""Contraction below which a parameter repeats its prior, unless it is coupled or one-sided."""
COUPLED = 0.8
"""Absolute correlation from which two parameters, neither of them determined, are coupled."""
COUPLED_TO_ALL = 0.9
"""Multiple correlation, of normal scores, from which a parameter is coupled to several others together."""
EXCLUDED = 0.1
"""Share of the cut prior outside the 95 % interval of a profile from which one side is excluded."""
SOME = 0.1
"""Divergence from the prior (nats) that a parameter which repeats its prior should not exceed."""
SHIFT = 0.5
"""Shift of the mean, in standard deviations of the cut prior, from which a parameter has moved."""
MOVED = 0.5 * SHIFT**2
"""Divergence from the cut prior (nats) from which it has moved too: that of a normal law so shifted."""
STRUCTURAL = "structurally not determined"
WORDS = ("determined", "one-sided", "weakly", "coupled", "moved", "repeats its prior", STRUCTURAL)


@dataclass(frozen=True)
class Evidence:
    """What was measured about a parameter; what was not measured keeps its default.

    Attributes
    ----------
    contraction : 1 − posterior variance over the cut prior's, on the scale of the prior's law.
    tie : the strongest correlation with another parameter that is not determined.
    multiple : correlation of its normal score with the best combination of those of all such parameters.
    given_others : contraction were these others known, as for normal laws.
    bound : bound of its prior that it leans on, one of ``contraction.BOUNDS``.
    structural : whether data of this design could determine it.
    profile : class of the likelihood's profile, one of ``profiles.CLASSES``.
    excluded : share of the cut prior outside the profile's 95 % interval.
    cloned : word of data cloning.
    divergence : from the cut prior, nats.
    shift : of the mean from the cut prior's, in its standard deviations, on the scale of the prior's law.
    """

    contraction: float
    tie: float = 0.0
    multiple: float = 0.0
    given_others: float = 1.0
    bound: str = "none"
    structural: bool = True
    profile: str = ""
    excluded: float = np.nan
    cloned: str = ""
    divergence: float = np.nan
    shift: float = 0.0


def word(found: Evidence) -> str:
    """The verdict, one of ``WORDS``."""
    if not found.structural:
        return STRUCTURAL
    if found.contraction >= DETERMINED and found.bound == "none":
        return "determined"
    tied = abs(found.tie) >= COUPLED or found.multiple >= COUPLED_TO_ALL
    if tied and found.given_others >= WEAK:  # what only the prior ties is no finding
        return "coupled"
    if _one_sided(found):
        return "one-sided"
    if found.contraction >= WEAK:
        return "weakly"
    moved = abs(found.shift) >= SHIFT or found.divergence >= MOVED
    return "moved" if moved else "repeats its prior"


def _one_sided(found: Evidence) -> bool:
    if found.contraction >= DETERMINED:
        return True
    if found.profile:
        return found.profile == "one-sided" and found.excluded >= EXCLUDED
    return found.bound in ("lower", "upper") and found.contraction >= WEAK


def disagreements(found: Evidence, verdict: str) -> tuple[str, ...]:
    """What speaks against a verdict, in words."""
    return tuple(_against(found, verdict))


def _against(found: Evidence, verdict: str) -> Iterator[str]:
    known, unknown = verdict == "determined", verdict in ("repeats its prior", STRUCTURAL)
    if known and found.profile not in ("", "two-sided"):
        yield f"the likelihood's profile is {found.profile}"
    if known and found.cloned == "not estimable":
        yield "more of the same data would not narrow it"
    if verdict == STRUCTURAL and found.profile == "two-sided":
        yield "the likelihood's profile is two-sided within the prior's range"
    if verdict == "repeats its prior" and found.profile == "two-sided" and found.excluded >= EXCLUDED:
        yield f"the likelihood alone excludes {100 * found.excluded:.0f} % of its prior"
    if unknown and found.cloned == "estimable":
        yield "more of the same data would narrow it"
    if verdict == "repeats its prior" and found.divergence >= SOME:
        yield f"its law differs from the prior's by {found.divergence:.2f} nats"


def multiple_correlation(correlation: FloatArray) -> FloatArray:
    """Correlation (d,) of every variable with the best combination of all others, from a matrix (d, d)."""
    if len(correlation) == 1:
        return np.zeros(1)
    steadied = correlation + 1e-12 * np.eye(len(correlation))
    return np.asarray(np.sqrt(np.clip(1.0 - 1.0 / np.diagonal(np.linalg.inv(steadied)), 0.0, 1.0)))


@dataclass(frozen=True)
class Correlated:
    """Correlations of the posterior's draws, and those of normal scores after and before the data, (d, d)."""

    plain: FloatArray
    scores: FloatArray
    prior_scores: FloatArray


def tied_to(contraction: FloatArray, bounds: Sequence[str], correlation: FloatArray) -> IntArray:
    """For each parameter (d,) the other, not determined, that it is tied to most; itself where there is none.

    Parameters
    ----------
    bounds : of the prior that the parameters lean on, as in :class:`Evidence`.
    correlation : of the posterior's draws (d, d).
    """
    strength = np.abs(correlation) * _unknown(contraction, bounds)
    np.fill_diagonal(strength, 1e-300)
    return np.asarray(strength.argmax(axis=1))


def _unknown(contraction: FloatArray, bounds: Sequence[str]) -> BoolArray:
    """Whether the data leave each parameter (d,) open; one that leans on its prior's end is held by that."""
    return np.asarray((contraction < DETERMINED) | (np.array(bounds) != "none"))


def ties(contraction: FloatArray, bounds: Sequence[str], found: Correlated) -> dict[str, FloatArray]:
    """How each parameter hangs together with the others that are not determined.

    A parameter that is determined leaves its partner's uncertainty with the partner, so it ties nothing. One
    that leans on a bound of its prior (``bounds``, as in :class:`Evidence`) is held there by the prior alone.

    Returns
    -------
    ``tie``, ``multiple`` and ``given_others`` of :class:`Evidence`, (d,) each.
    """
    numbers, unknown = np.arange(len(contraction)), _unknown(contraction, bounds)
    parts = [_tied(int(i), np.flatnonzero(unknown | (numbers == i)), found) for i in numbers]
    tie, multiple, before = np.array(parts).T
    left = (1.0 - multiple**2) / np.maximum(1.0 - before**2, 1e-12)
    return {"tie": tie, "multiple": multiple, "given_others": 1.0 - (1.0 - contraction) * left}


def _tied(own: int, chosen: IntArray, found: Correlated) -> tuple[float, float, float]:
    """Strongest and multiple correlation with the other chosen parameters, and the latter before the data."""
    others = chosen[chosen != own]
    if not len(others):
        return 0.0, 0.0, 0.0
    block, place = np.ix_(chosen, chosen), int(np.flatnonzero(chosen == own)[0])
    pairs = found.plain[own, others]
    after, before = (
        multiple_correlation(matrix[block])[place] for matrix in (found.scores, found.prior_scores)
    )
    return float(pairs[np.abs(pairs).argmax()]), float(after), float(before)
