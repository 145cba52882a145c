"""One word for each parameter, from all that was measured about it, and where the methods disagree.

===========================  ===========================================================================
structurally not determined  no data of this design can tell it
determined                   its variance shrinks to a tenth or less of the cut prior's
one-sided                    that, but one end is its prior's bound; or the data exclude one side only
coupled                      not on its own, but in combination with others
weakly                       its variance shrinks by ``WEAK`` or more
repeats its prior            none of these
===========================  ===========================================================================
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from bayesterra.arrays import FloatArray

DETERMINED = 0.9
"""Contraction from which a parameter or direction counts as determined: sd below a third of the prior's."""
WEAK = 0.3
"""Contraction below which a parameter repeats its prior, unless it is coupled or one-sided."""
COUPLED = 0.8
"""Absolute correlation from which two parameters are coupled."""
COUPLED_TO_ALL = 0.9
"""Multiple correlation, of normal scores, from which a parameter is coupled to all others together."""
EXCLUDED = 0.1
"""Share of the cut prior outside the 95 % interval of a profile from which one side is excluded."""
SOME = 0.1
"""Divergence from the prior (nats) that a parameter which repeats its prior should not exceed."""
STRUCTURAL = "structurally not determined"
WORDS = ("determined", "one-sided", "weakly", "coupled", "repeats its prior", STRUCTURAL)


@dataclass(frozen=True)
class Evidence:
    """What was measured about a parameter; what was not measured keeps its default.

    Attributes
    ----------
    contraction : 1 − posterior variance over the cut prior's.
    correlation : the strongest with another parameter.
    multiple : correlation of its normal score with the best combination of all others' scores.
    given_others : contraction were all others known, as for normal laws; see :func:`given_others`.
    bound : bound of its prior that it leans on, one of ``contraction.BOUNDS``.
    structural : whether data of this design could determine it.
    profile : class of the likelihood's profile, one of ``profiles.CLASSES``.
    excluded : share of the cut prior outside the profile's 95 % interval.
    cloned : word of data cloning.
    divergence : from the cut prior, nats.
    """

    contraction: float
    correlation: float = 0.0
    multiple: float = 0.0
    given_others: float = 1.0
    bound: str = "none"
    structural: bool = True
    profile: str = ""
    excluded: float = np.nan
    cloned: str = ""
    divergence: float = np.nan


def word(found: Evidence) -> str:
    """The verdict, one of ``WORDS``."""
    if not found.structural:
        return STRUCTURAL
    if found.contraction >= DETERMINED:
        return "determined" if found.bound == "none" else "one-sided"
    tied = abs(found.correlation) >= COUPLED or found.multiple >= COUPLED_TO_ALL
    if tied and found.given_others >= WEAK:  # what only the prior ties is no finding
        return "coupled"
    if _one_sided(found):
        return "one-sided"
    return "weakly" if found.contraction >= WEAK else "repeats its prior"


def _one_sided(found: Evidence) -> bool:
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


def given_others(contraction: FloatArray, multiple: FloatArray, prior_multiple: FloatArray) -> FloatArray:
    """Contraction (d,) were all other parameters known: of what the others leave open of each."""
    left = (1.0 - multiple**2) / np.maximum(1.0 - prior_multiple**2, 1e-12)
    return np.asarray(1.0 - (1.0 - contraction) * left)
