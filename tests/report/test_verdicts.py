"""Verdicts: signs, lines of a terminal, and the sentence that may be quoted."""

import pytest
from markupsafe import Markup

from bayesterra.report.verdicts import SIGNS, Verdict, quotable, sampling_verdict, unknown_verdict

GOOD = Verdict("Fit", "fits", "good", "30 % of the tables look as strange.")
CARE = Verdict("Prediction", "too narrow", "doubtful", "Left-out slips.", "intervals are too narrow")
BAD = Verdict("Fit", "does not fit", "bad", "Pull bends.", "the model does not fit: pull bends")
NOTE = Verdict("Soil", "0 of 2 determined", "note", "c and φ are known only in combination.")


@pytest.mark.parametrize(
    ("verdicts", "sentence"),
    [
        ([GOOD, NOTE], "These intervals hold for wheel A; other loads were not tested."),
        ([GOOD, CARE, NOTE], "Use with care, for wheel A: intervals are too narrow."),
        ([CARE, BAD], "Do not use: the model does not fit: pull bends; intervals are too narrow."),
        ([Verdict("Fit", "doubtful", "doubtful", "")], "Use with care, for wheel A: doubtful."),
    ],
)
def test_the_worst_comes_first(verdicts: list[Verdict], sentence: str) -> None:
    """What forbids the use, then what is doubtful; a note forbids nothing."""
    assert quotable(verdicts, "wheel A", ["other loads were not tested"]) == sentence


def test_a_line_warns_where_the_verdict_is_bad() -> None:
    """And only there; marks are no part of it."""
    assert (GOOD.line.text, GOOD.line.tone) == ("Fit: fits. 30 % of the tables look as strange.", "")
    assert (BAD.line.text, BAD.line.tone) == ("warning: Fit: does not fit. Pull bends.", "bad")
    marked = Verdict("Fit", "fits", "good", Markup("<b>p</b> 0.3"))
    assert marked.line.text == "Fit: fits. p 0.3"


def test_a_sentence_is_set_with_its_symbols_and_escaped() -> None:
    """Plain text is set as in the literature; markup stays as it is."""
    assert str(NOTE.html).startswith("<i>c</i> and <i>φ</i> are")
    assert str(Verdict("Fit", "", "good", "a < b").html) == "a &lt; b"
    assert str(Verdict("Fit", "", "good", Markup("<b>p</b>")).html) == "<b>p</b>"
    assert [verdict.sign for verdict in (GOOD, CARE, BAD, NOTE)] == list(SIGNS.values())


def test_a_record_gives_a_verdict_back() -> None:
    """All that it says."""
    assert Verdict(**CARE.record()) == CARE
    assert unknown_verdict("Fit", "why").claim == "fit is not known"


def test_the_sampling_names_what_failed() -> None:
    """With its figures and thresholds; R-hat that is not known is a dash."""
    check = {"name": "R-hat", "value": 1.2, "threshold": 1.01, "passed": False, "advice": "run longer"}
    verdict = {"converged": False, "ess": 80.0, "r_hat": None, "checks": [check]}
    found = sampling_verdict({"verdict": verdict, "settings": {"ensembles": 4}})
    assert (found.word, found.grade) == ("not converged", "bad")
    assert found.sentence == "R-hat –, 80 effective draws of 4 ensembles. Failed: R-hat."
    assert (found.figures, found.thresholds) == ({"R-hat": 1.2}, {"R-hat": 1.01})
    settled = {**verdict, "converged": True, "r_hat": 1.001}
    sound = sampling_verdict({"verdict": settled, "settings": {"ensembles": 4}})
    assert (sound.word, sound.grade) == ("converged", "good")
    assert (sound.figures, sound.thresholds) == ({"R-hat": 1.2}, {"R-hat": 1.01})
