"""What an identifiability analysis found, in one sentence."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from bayesterra.identifiability.information import ALL
from bayesterra.identifiability.verdicts import STRUCTURAL

GROUP_WORDS = {"P_I": "bearing", "P_II": "shearing", "P_III": "contact-angle", "load effect": "load-effect"}
NUMBERS = ("none", "one", "two", "three", "four", "five", "six", "seven", "eight", "nine")


def in_a_sentence(
    counts: Sequence[Mapping[str, Any]], verdicts: Mapping[str, str], symbol: Callable[[str], str]
) -> str:
    """How many directions of each group are fixed, and which parameters the data leave as they were.

    Parameters
    ----------
    counts : scope (a group, or ``all``), directions and determined, of each scope.
    verdicts : by parameter.
    symbol : how to write a parameter.
    """
    groups = [row for row in counts if row["scope"] != ALL] or list(counts)
    fixed = [
        _fixed(GROUP_WORDS.get(row["scope"], ""), row["determined"], row["directions"]) for row in groups
    ]
    parts = [listed(fixed) if any(row["determined"] for row in groups) else "no direction at all"]
    if names := [symbol(name) for name, word in verdicts.items() if word == "repeats its prior"]:
        parts.append(f"{listed(names)} {'repeats its prior' if len(names) == 1 else 'repeat their priors'}")
    if names := [symbol(name) for name, word in verdicts.items() if word == "moved"]:
        parts.append(f"{listed(names)} moved away from {'its prior' if len(names) == 1 else 'their priors'}")
    if names := [symbol(name) for name, word in verdicts.items() if word == STRUCTURAL]:
        parts.append(f"no data of this design can determine {listed(names)}")
    return f"These data fix {'; '.join(parts)}."


def listed(parts: Sequence[str]) -> str:
    """As in a sentence: a, b and c."""
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def _fixed(kind: str, determined: int, of: int) -> str:
    """Such as ``two of the three bearing directions``."""
    if of == 1:
        words = ("the one" if determined else "no", kind, "parameter")
    elif determined == of:
        words = ("both" if of == 2 else f"all {NUMBERS[of]}", kind, "directions")
    else:
        words = (f"{NUMBERS[determined]} of the {NUMBERS[of]}", kind, "directions")
    return " ".join(word for word in words if word)
