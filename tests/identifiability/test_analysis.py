"""The sentence that opens an identifiability analysis, for all kinds of counts."""

import pytest

from bayesterra.identifiability.analysis import in_a_sentence
from bayesterra.parameters import PARAMETERS
from bayesterra.report.symbols import in_symbols
from bayesterra.study.result import shown

PRIOR, NONE = "repeats its prior", "structurally not determined"


def said(counts: dict[str, tuple[int, int]], **words: str) -> str:
    """The sentence for (determined, directions) by scope and verdicts by parameter."""
    rows = [{"scope": scope, "determined": a, "directions": b} for scope, (a, b) in counts.items()]
    return in_a_sentence(rows, words, lambda name: PARAMETERS[name].symbol)


@pytest.mark.parametrize(
    ("determined", "of", "words"),
    [
        (0, 1, "no bearing parameter"),
        (1, 1, "the one bearing parameter"),
        (0, 2, "none of the two bearing directions"),
        (1, 2, "one of the two bearing directions"),
        (2, 2, "both bearing directions"),
        (0, 3, "none of the three bearing directions"),
        (2, 3, "two of the three bearing directions"),
        (3, 3, "all three bearing directions"),
        (3, 4, "three of the four bearing directions"),
        (4, 4, "all four bearing directions"),
    ],
)
def test_every_count_of_a_group_has_its_words(determined: int, of: int, words: str) -> None:
    """Kc and kphi make four bearing directions; a group may have a single parameter, or none determined."""
    counts = {"all": (determined + 1, of + 1), "P_I": (determined, of), "P_II": (1, 1)}
    assert said(counts, n0="determined") == f"These data fix {words} and the one shearing parameter."


def test_the_sentence_of_a_wheel_test() -> None:
    """Groups, then what repeats its prior, then what the design cannot tell."""
    counts = {"all": (4, 8), "P_I": (2, 3), "P_II": (2, 3), "P_III": (0, 2)}
    opening = (
        "These data fix two of the three bearing directions, two of the three shearing directions and none of"
        " the two contact-angle directions"
    )
    assert said(counts, Ks="weakly", c="coupled", phi="one-sided") == f"{opening}."
    assert said(counts, Ks=PRIOR, n0="determined") == f"{opening}; K_s repeats its prior."
    assert said(counts, Ks=PRIOR, c=PRIOR, K=PRIOR).endswith("; K_s, c and K repeat their priors.")
    assert said(counts, kc=NONE, Ks=PRIOR).endswith(
        "; K_s repeats its prior; no data of this design can determine k_c."
    )


def test_without_a_group_all_directions_are_counted() -> None:
    """Estimated noise and the sinkage offset belong to no group."""
    assert said({"all": (1, 1)}) == "These data fix the one parameter."
    assert said({"all": (1, 2)}) == "These data fix one of the two directions."
    assert said({"all": (2, 2)}) == "These data fix both directions."


def test_nothing_fixed_is_said_once() -> None:
    """Groups without a determined direction are not enumerated."""
    assert said({"all": (0, 5), "P_I": (0, 3), "P_II": (0, 2)}) == "These data fix no direction at all."
    assert (
        said({"all": (0, 1)}, c="moved") == "These data fix no direction at all; c moved away from its prior."
    )
    assert said({"all": (0, 1)}, c=PRIOR) == "These data fix no direction at all; c repeats its prior."


@pytest.mark.parametrize(
    ("text", "html"),
    [
        (
            "k_c + 0.165 k_φ (kPa/m^N)",
            "<i>k</i><sub>c</sub> + 0.165 <i>k</i><sub>φ</sub> (kPa/m<sup>N</sup>)",
        ),
        ("c2 − 0.59 c1", "<i>c</i><sub>2</sub> − 0.59 <i>c</i><sub>1</sub>"),
        ("σ(F_DP) and c", "<i>σ</i>(<i>F</i><sub>DP</sub>) and <i>c</i>"),
        ("specific costs of K < 2", "specific costs of <i>K</i> &lt; 2"),
    ],
)
def test_plain_symbols_are_set_and_nothing_else(text: str, html: str) -> None:
    """Symbols become italics with subscripts, letters inside words stay, and text is escaped."""
    assert str(in_symbols(text)) == html


def test_a_verdict_is_shown_by_one_word_everywhere() -> None:
    """An adverb gets its noun; the table keeps the short word."""
    assert shown("weakly") == "weakly determined"
    assert [shown(word) for word in ("determined", "coupled", "moved")] == ["determined", "coupled", "moved"]
