"""The index of the paper: remade from the studies' statements and compared with its page."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pandas as pd
import paper_statements
import pytest

STUDIES = Path(__file__).parents[2] / "studies"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The script of the index as a module."""
    return study_script("paper")


def test_the_page_is_remade(script: ModuleType) -> None:
    """The README is what the stored statements give."""
    text = (STUDIES / "paper" / "README.md").read_text(encoding="utf-8")
    assert script.page(text) == text


def test_every_statement_of_the_list_has_its_row(script: ModuleType) -> None:
    """Each has a verdict; one that differs has a class and a reason, one outside says why; nothing is counted twice."""
    tables = script.found()
    found = script.entries(tables)
    assert len(found) > 100
    for each in found:
        if each.verdict == "outside":
            assert each.note
        elif each.verdict == "differs":
            assert each.note in script.CLASSES
            assert each.row["ours"]
    rest = script.own_checks(tables, found)
    used = {(each.study, text) for each in found if len(each.rows) for text in each.rows["statement"]}
    assert len(used) + sum(map(len, rest.values())) == sum(map(len, tables.values()))
    places = " ".join(each.where for each in found)
    for number in range(1, 18):
        assert f"Table {number}" in places


def test_a_statement_without_its_row_or_class_is_refused(script: ModuleType) -> None:
    """The list names the study and the beginning that is missing; what differs must say to what it is due."""
    head = ["where", "says", "study", "statement", "class"]
    table = pd.DataFrame([["Table 1", "a thing", "", "", "", "differs", ""]], columns=list(paper_statements.COLUMNS))
    missing = pd.DataFrame([["Table 1", "x", "s", "another", ""]], columns=head)
    with pytest.raises(ValueError, match=r"^'s' has no statement that begins with 'another'$"):
        script.entries({"s": table}, missing)
    blank = pd.DataFrame([["Table 1", "x", "s", "a th", ""]], columns=head)
    with pytest.raises(ValueError, match=r"^'x' differs: 'class' must be one of print, data, sentence, hardware$"):
        script.entries({"s": table}, blank)


def test_the_worst_row_counts(script: ModuleType) -> None:
    """Of several rows of one statement the one that differs is shown."""
    rows = [["T", f"a{i}", "", f"{i}", "", word, ""] for i, word in enumerate(("reproduced", "differs"))]
    listed = pd.DataFrame([["T", "x", "s", "a0;a1", "data"]], columns=["where", "says", "study", "statement", "class"])
    entry = script.entries({"s": pd.DataFrame(rows, columns=list(paper_statements.COLUMNS))}, listed)[0]
    assert (entry.verdict, entry.row["ours"]) == ("differs", "1")


def test_statements_of_another_form_are_refused(script: ModuleType, tmp_path: Path) -> None:
    """Wrong columns and unknown verdicts are named with the file."""
    folder = tmp_path / "some-study"
    folder.mkdir()
    head = ",".join(paper_statements.COLUMNS)
    (folder / script.FILE).write_text("where,what\nTable 1,x\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"^'some-study/statements.csv' must have the columns table_or_figure, "):
        script.read(folder)
    (folder / script.FILE).write_text(f"{head}\nTable 1,a,b,c,,perhaps,\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"'verdict' must be one of .* \(got 'perhaps'\)$"):
        script.found(tmp_path)
