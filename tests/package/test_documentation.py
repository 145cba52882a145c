"""Documentation: its code runs, its links lead somewhere, every key stands in it, every equation names its paper.

A comment before a block of code says more: ``<!-- file: NAME -->`` writes it, ``<!-- slow -->`` leaves it to the slow
tests (as a page's first line: the whole page), ``<!-- not run: REASON -->`` leaves it out.
"""

import json
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from types import ModuleType
from typing import Any
from urllib.parse import unquote, urlsplit

import pytest
from scripts import loaded

import bayesterra as bt
from bayesterra.study import entries, groups, schema
from tests.support.choice import ALL
from tests.support.shared import Shared

ROOT = Path(__file__).parents[2]
DOCS, STUDIES = ROOT / "docs", ROOT / "studies"
PAGES = sorted([ROOT / "README.md", *(page for page in DOCS.rglob("*.md") if DOCS / "studies" not in page.parents)])
RUN = ("sh", "python", "toml")
_REMARK = r"(?:^ *<!-- (?P<remark>[^\n]*?) -->\n)?"
_FENCE = re.compile(
    _REMARK + r"^(?P<indent> *)(?P<ticks>`{3,})(?P<kind>[^\n]*)\n(?P<code>.*?)^ *(?P=ticks)$", re.M | re.S
)
_EQUATION = re.compile(r"(?<![\w)])\((\d{1,2})[a-c]?\)")
"""Number of an equation as it is written in a text: 42 in brackets."""
SITE = os.environ.get("BAYESTERRA_SITE", "")
built = pytest.mark.skipif(not SITE, reason="the site is built by .ci/run, which names it in BAYESTERRA_SITE")


def page_name(page: Path) -> str:
    """Path of a page in the repository."""
    return page.relative_to(ROOT).as_posix()


@dataclass(frozen=True)
class Block:
    """A block of code of a page, and the comment before it."""

    kind: str
    code: str
    remark: str
    slow: bool

    @property
    def file(self) -> str:
        """Name of the file that it is; "" for others."""
        return self.remark.removeprefix("file: ") if self.remark.startswith("file: ") else ""


def blocks(page: Path) -> list[Block]:
    """All blocks of a page that are code or a file, but for those that say why they are not run."""
    text = page.read_text(encoding="utf-8")
    whole = text.startswith("<!-- slow -->")
    found = []
    for match in _FENCE.finditer(text):
        indent, remark = len(match["indent"]), match["remark"] or ""
        code = "".join(line[indent:] for line in match["code"].splitlines(keepends=True))
        if remark.startswith("not run"):
            assert len(remark.removeprefix("not run:")) > 10, f"{page}: say why it is not run"
        elif match["kind"] in RUN or remark.startswith("file: "):
            found.append(Block(match["kind"], code, remark, whole or remark == "slow"))
    return found


def fragment(code: str) -> None:
    """A part of a study file, checked within a whole one."""
    tables = tomllib.loads((STUDIES / "hit-wh32" / "study.toml").read_text(encoding="utf-8"))
    schema.checked({**tables, **tomllib.loads(code)}, bare=False)


def run_blocks(chosen: list[Block], folder: Path) -> None:
    """Blocks of one page, one after the other in a folder of their own."""
    (folder / "studies").symlink_to(STUDIES)
    names: dict[str, Any] = {}
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    for block in chosen:
        if block.file:
            (folder / block.file).write_text(block.code, encoding="utf-8")
        elif block.kind == "toml":
            fragment(block.code)
        elif block.kind == "python":
            exec(compile(block.code, "a block of Python", "exec"), names)  # noqa: S102
        else:
            command = ["bash", "-euo", "pipefail", "-c", block.code]
            done = subprocess.run(command, cwd=folder, env={**os.environ, "PATH": path}, capture_output=True, text=True)
            assert done.returncode == 0, f"{block.code}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"


def test_every_block_is_run_or_says_why_not() -> None:
    """Nothing falls between the comments; what is not run is little."""
    texts = {page: page.read_text(encoding="utf-8") for page in PAGES}
    fences = {page: len(re.findall(rf"^ *```(?:{'|'.join(RUN)})$", text, re.M)) for page, text in texts.items()}
    left = {page: text.count("<!-- not run: ") for page, text in texts.items()}
    assert fences == {page: left[page] + sum(block.kind in RUN for block in blocks(page)) for page in PAGES}
    assert sum(left.values()) <= 10


QUICK = [page for page in PAGES if any(not block.slow for block in blocks(page))]
SLOW = [page for page in PAGES if any(block.slow for block in blocks(page))]


@pytest.mark.parametrize("page", QUICK, ids=page_name)
def test_code_of_a_page_runs(page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """All that takes no time."""
    monkeypatch.chdir(tmp_path)
    run_blocks([block for block in blocks(page) if not block.slow], tmp_path)


@pytest.fixture
def wh32(shared: Shared, tmp_path: Path) -> Path:
    """Folder that holds the result of the README's first command."""
    name = "hit-wh32-result"

    def fill(folder: Path) -> None:
        bt.run(bt.load_study(STUDIES / "hit-wh32"), seed=1).save(folder / name)

    return shared.folder_of("documentation", fill, tmp_path / "work")


WHOLE = [page for page in SLOW if page.stem == "first-study" or ALL]
"""Slow pages that are run: the first of them always, all others, a quarter of an hour, where the variable is set."""


@pytest.mark.slow
@pytest.mark.parametrize("page", WHOLE, ids=page_name)
def test_slow_code_of_a_page_runs(page: Path, monkeypatch: pytest.MonkeyPatch, wh32: Path) -> None:
    """The whole page, where its commands take a while; the result of the README's first command is there."""
    monkeypatch.chdir(wh32)
    run_blocks(blocks(page), wh32)


def test_a_block_that_fails_is_seen(tmp_path: Path) -> None:
    """Each kind of code, and the word of a command that is not there."""
    for kind, code in (("python", "1 / 0"), ("sh", "bayesterra no-such-command"), ("toml", "modell = 'M1'")):
        (folder := tmp_path / kind).mkdir()
        with pytest.raises((ZeroDivisionError, AssertionError, bt.StudyError)):
            run_blocks([Block(kind, code, "", slow=False)], folder)


@pytest.fixture(scope="module")
def keys() -> ModuleType:
    """The extension that makes the reference of the study file."""
    pytest.importorskip("sphinx")
    return loaded(DOCS / "extensions" / "study_keys.py")


def _schema_keys() -> Iterator[str]:
    content: Mapping[str, Any] = json.loads(schema.json_schema())
    for table in (content, *content["$defs"].values()):
        yield from table["properties"]


def test_every_key_of_the_study_file_is_described(keys: ModuleType) -> None:
    """Of the schema, and of the tables that have readers of their own; each key with its meaning."""
    rows = [row for _, _, table, _ in keys.tables() for row in table]
    described = {name for row in rows for name in re.findall(r"[\w.]+", row[0])}
    own = {*groups._KEYS, *entries._TAKEN, *entries._LIMITS, *entries._SHIFTS}
    own |= {"sd", "fraction", "floor", "estimate", "dof", "resolution", "length", "kernel", "memory", "period"}
    own |= {"set", "from", "correlation", "mixture", "mean", "spread", "dist"}
    assert not {*_schema_keys(), *own} - described
    assert not [row for row in rows if len(row[3]) < 8]


def test_units_and_defaults_are_those_of_the_schema(keys: ModuleType) -> None:
    """One of each kind."""
    rows = {row[0]: row for _, _, table, _ in keys.tables() for row in table}
    assert rows["``radius``"][1:3] == ("text with a unit of m", "required")
    assert rows["``load_range``"][1] == "text with a unit of N"
    assert rows["``pressure_range``"][1] == "text with a unit of Pa"
    assert rows["``target_ess``"][1:3] == ("whole number, at least 100, at most 10 000 000", "``4000``")
    assert '``"tip"``' in rows["``slip_reference``"][1]


def test_every_command_has_a_page() -> None:
    """With its options, which the command line itself prints, and a place in the list."""
    from typer.main import get_command

    from bayesterra.cli import app

    folder = DOCS / "how-to" / "commands"
    listed = (folder / "index.md").read_text(encoding="utf-8")
    for command in getattr(get_command(app), "commands"):  # noqa: B009
        assert f"{{command-help}} {command}" in (folder / f"{command}.md").read_text(encoding="utf-8")
        assert f"]({command}.md)" in listed


def test_every_public_name_has_its_place() -> None:
    """In the reference of Python."""
    text = (DOCS / "reference" / "python.md").read_text(encoding="utf-8")
    named = set(re.findall(r"auto(?:function|class|exception):: bayesterra\.(\w+)$", text, re.M))
    assert named >= set(bt.__all__)


def without_paper(text: str) -> list[str]:
    """Paragraphs with the number of an equation and no author of it."""
    plain = re.sub(r"^ *(`{3,}).*?^ *\1$", "", text, flags=re.M | re.S)
    return [part for part in re.split(r"\n\s*\n|\n(?=[|:])", plain) if _EQUATION.search(part) and "Ding" not in part]


@pytest.mark.parametrize("page", PAGES, ids=page_name)
def test_every_equation_names_its_paper(page: Path) -> None:
    """In the same paragraph or row of a table."""
    assert not without_paper(page.read_text(encoding="utf-8"))


def test_an_equation_without_its_paper_is_seen() -> None:
    """And one beside it that has it is not."""
    assert without_paper("By (14).\n\nDing et al. 2015, (14).\n\n| a | by (42b) |") == ["By (14).", "| a | by (42b) |"]


class Html(HTMLParser):
    """Links, anchors and paragraphs of a page of the site."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.links: list[str] = []
        self.anchors: set[str] = set()
        self.paragraphs: list[str] = []
        self._open = False
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note where a tag leads to and what leads to it."""
        named = dict(attrs)
        self.anchors |= {value for key in ("id", "name") if (value := named.get(key))}
        self.links += [value for key in ("href", "src") if (value := named.get(key))]
        if tag == "p":
            self.paragraphs.append("")
        self._open = self._open or tag == "p"

    def handle_endtag(self, tag: str) -> None:
        """A paragraph ends."""
        self._open = self._open and tag != "p"

    def handle_data(self, data: str) -> None:
        """Text of a paragraph."""
        if self._open:
            self.paragraphs[-1] += data


@pytest.fixture(scope="module")
def site() -> dict[Path, Html]:
    """Pages of the built site."""
    folder = Path(SITE).resolve()
    return {page: Html(page.read_text(encoding="utf-8")) for page in folder.rglob("*.html")}


def broken(pages: Mapping[Path, Html]) -> list[str]:
    """Links within the site that lead nowhere."""
    wrong = []
    for page, content in pages.items():
        for link in content.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc or link.startswith("data:"):
                continue
            target = (page.parent / unquote(parts.path)).resolve() if parts.path else page
            missing = not target.exists()
            lost = target in pages and parts.fragment and unquote(parts.fragment) not in pages[target].anchors
            if missing or (lost and parts.fragment != "top"):
                wrong.append(f"{page.name}: {link}")
    return wrong


@built
def test_links_within_the_site_lead_somewhere(site: dict[Path, Html]) -> None:
    """Pages, anchors, pictures and downloads."""
    assert sum(len(page.links) for page in site.values()) > 2000
    assert not broken(site)


def test_a_link_that_leads_nowhere_is_seen(tmp_path: Path) -> None:
    """To a page and to an anchor."""
    page = tmp_path / "page.html"
    page.touch()
    pages = {page: Html('<a href="other.html"></a><a href="#here" id="here"></a><a href="#there"></a>')}
    assert broken(pages) == ["page.html: other.html", "page.html: #there"]


@built
def test_pages_of_the_site_name_the_paper_of_every_equation(site: dict[Path, Html]) -> None:
    """What is made from docstrings and from the schema, too; pages of studies say it once, at their end."""
    for page, content in site.items():
        if "studies" in page.parts:
            numbered = any(_EQUATION.search(text) for text in content.paragraphs)
            assert not numbered or any("Ding" in text for text in content.paragraphs), page
        else:
            assert not [text for text in content.paragraphs if _EQUATION.search(text) and "Ding" not in text], page


@built
def test_every_study_has_its_page(site: dict[Path, Html]) -> None:
    """And the notebook was executed: it has the posterior beside the truth."""
    made = {page.relative_to(Path(SITE).resolve()).as_posix() for page in site}
    for readme in STUDIES.rglob("README.md"):
        assert readme.relative_to(ROOT).with_suffix(".html").as_posix() in made
    notebook = next(page for page in site if page.name == "one-wheel.html")
    assert "hdi90_lo" in notebook.read_text(encoding="utf-8")
