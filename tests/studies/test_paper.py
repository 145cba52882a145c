"""The index of the paper: remade from the studies' statements and compared with its page."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

STUDIES = Path(__file__).parents[2] / "studies"
HELD = (
    *(f"Table {n}" for n in (4, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)),
    *(f"Fig. {n}" for n in (5, 6, 7, 8, 9, 10, 11, 12, 16, 17, 18)),
)


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The script of the index as a module."""
    return study_script("paper")


def test_the_page_is_remade(script: ModuleType) -> None:
    """The README is what the stored statements give."""
    text = (STUDIES / "paper" / "README.md").read_text(encoding="utf-8")
    assert script.page(text) == text


def test_every_table_has_its_line_with_numbers(script: ModuleType) -> None:
    """Every table and figure of the studies is there, with a verdict, and a reason where it differs."""
    index = {line.place: line for line in script.lines(script.found()) if line.study.startswith("paper/")}
    assert set(HELD) <= set(index)
    for place in HELD:
        cells = dict(
            zip(
                ("where", "what", "printed", "ours", "difference", "verdict", "why"), index[place].cells(), strict=False
            )
        )
        assert cells["what"]
        assert cells["ours"]
        assert cells["verdict"].startswith("**differs**" if len(index[place].off) else "reproduced")
        assert bool(cells["why"]) == bool(len(index[place].off))


def test_nothing_is_missing(script: ModuleType) -> None:
    """Every table and figure that the index is to hold has a statement in some study."""
    text = (STUDIES / "paper" / "README.md").read_text(encoding="utf-8")
    assert "Nothing is missing." in text
    assert set(script.WANTED) <= {line.place for line in script.lines(script.found())}


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("Fig. 5(b, c)", ["Fig. 5"]),
        ("Table 6, Fig. 7", ["Table 6", "Fig. 7"]),
        ("Tables 11–13", ["Table 11", "Table 12", "Table 13"]),
        ("Figs 20, 21", ["Fig. 20", "Fig. 21"]),
        ("Section 8, (42)", ["Eq. (42)"]),
        ("Section 4.1", ["Section 4.1"]),
        ("the rest", ["the rest"]),
    ],
)
def test_places_are_told_from_text(script: ModuleType, text: str, names: list[str]) -> None:
    """Tables and figures come out in one spelling, whatever a study writes."""
    assert script.places(text) == names


def test_statements_of_another_form_are_refused(script: ModuleType, tmp_path: Path) -> None:
    """Wrong columns and unknown verdicts are named with the file."""
    folder = tmp_path / "some-study"
    folder.mkdir()
    head = ",".join(script.COLUMNS)
    (folder / script.FILE).write_text("where,what\nTable 1,x\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"^'some-study/statements.csv' must have the columns table_or_figure, "):
        script.read(folder)
    (folder / script.FILE).write_text(f"{head}\nTable 1,a,b,c,,perhaps,\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"'verdict' must be one of .* \(got 'perhaps'\)$"):
        script.found(tmp_path)
    (folder / script.FILE).write_text(f"{head}\nTable 1,a,b,c,,differs,d\n", encoding="utf-8")
    assert script.lines(script.found(tmp_path))[0].cells()[:7] == [
        "Table 1", "", "a: b", "c", "", "**differs**, 0 of 1", "d",
    ]  # fmt: skip
