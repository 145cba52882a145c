"""The sentence that opens an identifiability analysis, for all kinds of counts."""

import pandas as pd
import pytest

from bayesterra.identifiability.analysis import in_a_sentence, soil_verdict
from bayesterra.parameters import PARAMETERS
from bayesterra.report.symbols import in_symbols
from bayesterra.study.result import shown

PRIOR, NONE = "repeats its prior", "structurally not determined"


def said(counts: dict[str, tuple[int, int]], **words: str) -> str:
    """The sentence for (determined, directions) by scope and verdicts by parameter."""
    rows = [{"scope": scope, "determined": a, "directions": b} for scope, (a, b) in counts.items()]
    return in_a_sentence(rows, words, lambda name: PARAMETERS[name].symbol)


def test_the_sentence_of_a_wheel_test() -> None:
    """What stands on its own, what is fixed in combination, what repeats its prior, what no data can tell."""
    counts = {"all": (4, 8), "P_I": (2, 3), "P_II": (2, 3), "P_III": (0, 2)}
    opening = "These data determine no parameter on its own and fix 4 of 8 independent combinations"
    assert said(counts, Ks="weakly", phi="one-sided") == f"{opening}."
    assert said(counts, c="coupled") == f"{opening}; c is known only in combination."
    assert said(counts, c="coupled", phi="coupled") == f"{opening}; c and φ are known only in combination."
    opening = opening.replace("no parameter", "n0")
    assert said(counts, Ks=PRIOR, n0="determined") == f"{opening}; K_s repeats its prior."
    opening = opening.replace("n0 on its own", "n0 and K on their own")
    assert said(counts, n0="determined", K="determined") == f"{opening}."
    assert said(counts, Ks=PRIOR, c=PRIOR, K=PRIOR).endswith("; K_s, c and K repeat their priors.")
    assert said(counts, kc=NONE, Ks=PRIOR).endswith(
        "; K_s repeats its prior; no data of this design can determine k_c."
    )


def test_two_that_are_one_combination_are_said_to_be() -> None:
    """More parameters determined than combinations fixed: they are not independent."""
    assert said({"all": (1, 2)}, n0="determined", K="determined") == (
        "These data determine n0 and K on their own and fix 1 of 2 independent combinations; those determined"
        " are not independent of each other."
    )


def test_nothing_fixed_is_said() -> None:
    """None of one, none of several."""
    opening = "These data determine no parameter on its own and fix none of"
    assert said({"all": (0, 5), "P_I": (0, 3)}) == f"{opening} 5 independent combinations."
    assert said({"all": (0, 1)}, c="moved") == (f"{opening} 1 independent combination; c moved away from its prior.")
    assert said({"P_I": (0, 1)}, c=PRIOR) == f"{opening} 1 independent combination; c repeats its prior."


def test_the_card_of_the_soil_says_the_same() -> None:
    """Its counts are those of the table and of the sentence; a conflict with the prior is doubtful."""
    table = pd.DataFrame({"parameter": ["phi", "K"], "verdict": ["determined", "coupled"]})
    row = {"scope": "all", "view": "marginal", "directions": 2, "determined": 1}
    found = soil_verdict(table, {"groups": [row, {**row, "view": "conditional"}]})
    assert (found.word, found.grade, found.claim) == ("1 of 2 determined", "note", "")
    assert found.figures == {"determined": 1, "of": 2, "fixed": 1}
    assert found.sentence == (
        "These data determine φ on its own and fix 1 of 2 independent combinations; K is known only in combination."
    )
    assert soil_verdict(table.assign(verdict="determined"), {"of": 2, "determined": 2}).grade == "good"
    at_odds = soil_verdict(table, {"groups": [row]}, conflict=True)
    assert (at_odds.grade, at_odds.claim) == ("doubtful", "prior and readings contradict each other")


@pytest.mark.parametrize(
    ("text", "html"),
    [
        ("k_c + 0.165 k_φ (kPa/m^N)", "<i>k</i><sub>c</sub> + 0.165 <i>k</i><sub>φ</sub> (kPa/m<sup>N</sup>)"),
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
