"""A result in short: the same blocks on a terminal and in a notebook."""

import pytest
from markupsafe import Markup

from bayesterra.report.blocks import Table, Text
from bayesterra.report.sections import notebook
from bayesterra.report.terminal import show

OVERVIEW = (
    Table("A <b>c</b>", "lr", ("", "no answer"), (("K_s", "1 %"), (), ("x", Markup("<b>9 % !</b>")))),
    Text("All is well."),
    Text("warning: units", "bad"),
)


def test_the_terminal_shows_text_and_warns_apart(capsys: pytest.CaptureFixture[str]) -> None:
    """Brackets are text, marks are none; rows are parted, and bad lines go to standard error."""
    show(OVERVIEW, "Report: there")
    printed = capsys.readouterr()
    assert "A <b>c</b>" in printed.out
    assert "9 % !" in printed.out
    assert "<b>9" not in printed.out
    assert printed.out.rstrip().endswith("All is well.\nReport: there")
    assert printed.err == "warning: units\n"


def test_no_column_of_text_vanishes(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Where numbers take the width of a terminal, words are broken between them and not left out."""
    monkeypatch.setenv("COLUMNS", "60")
    numbers = ("0.53 ± 0.03",) * 4
    show((Table("", "l" + "r" * 4, ("drive", *numbers), (("wheel Wh32, 80 N", *numbers), ("short",))),))
    printed = capsys.readouterr().out
    for word in ("drive", "wheel", "Wh32,", "80 N"):
        assert word in printed


def test_a_notebook_sets_symbols_and_escapes() -> None:
    """Symbols as in the literature, what comes from outside escaped, numbers to the right."""
    shown = notebook(OVERVIEW)
    assert "A &lt;b&gt;" in shown
    assert "<i>K</i><sub>s</sub>" in shown
    assert 'text-align:right;padding:2px 10px"><b>9 % !</b>' in shown
    assert shown.count("<tr>") == 3
    assert "<p>warning: units</p>" in shown
