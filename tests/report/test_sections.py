"""Words of the pages: every sentence that a page asks for stands in its template, with the arguments that it gets."""

import ast
import re
from pathlib import Path

import pytest
from jinja2.runtime import Macro
from markupsafe import Markup

import bayesterra
from bayesterra.report import sections
from bayesterra.report.sections import Prose

PACKAGE = Path(bayesterra.__file__).parent
PROSE = PACKAGE / "report" / "templates" / "prose"
PAGES = sorted(path.stem for path in PROSE.glob("*.html"))


def calls(page: str) -> list[tuple[str, int, bool]]:
    """Name, number of arguments, and whether there are more of them, of all calls for the words of a page."""
    asked = []
    for path in PACKAGE.rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        lender = re.search(r"^from ([\w.]+) import .*\bsay\b", source, re.MULTILINE)
        if lender:
            source = Path(PACKAGE.parent, *lender[1].split(".")).with_suffix(".py").read_text(encoding="utf-8")
        if f'say = Prose("{page}")' not in source:
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in ("say", "say.plain", "say.table"):
                name, *values = node.args
                values = values[1:] if ast.unparse(node.func) == "say.table" else values  # without its rows
                assert isinstance(name, ast.Constant), path
                starred = any(isinstance(value, ast.Starred) for value in values)
                asked.append((str(name.value), len(values) - starred, starred))
    return asked


@pytest.mark.parametrize("page", PAGES)
def test_pages_and_their_words_agree(page: str) -> None:
    """No page asks for a sentence that is not there, or with other arguments; none stands there in vain."""
    template = sections._environment().get_template(f"prose/{page}.html")
    macros = {name: macro for name, macro in vars(template.module).items() if isinstance(macro, Macro)}
    asked = calls(page)
    for name, count, more in asked:
        assert name in macros, name
        expected = len(macros[name].arguments)
        assert (count < expected) if more else (count == expected), name
    source = (PROSE / f"{page}.html").read_text(encoding="utf-8")
    unused = {name for name in macros if source.count(f"{name}(") == 1} - {name for name, *_ in asked}
    assert not unused


def test_words_are_escaped() -> None:
    """What is not marked as HTML is text; lines of the template are one line of the page."""
    said = Prose("prior")("support", "a < b", Markup("<b>5 %</b>"))
    assert said == ("of the stated prior has an answer at every row. Most is cut because a &lt; b (<b>5 %</b>).")
