"""Pages of the studies, made of their READMEs when the site is built, and the gallery: ``{study-gallery}``."""

import re
import shutil
from os.path import relpath
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

HERE = Path(__file__).parents[1]
STUDIES = HERE.parent / "studies"
PAGES = HERE / "studies"
_LINK = re.compile(r"(?P<image>!?)\[(?P<text>[^\[\]]*)\]\((?P<target>[^()\s#]+)\)")
_EQUATION = re.compile(r"(?<![\w)])\((\d{1,2})[a-c]?\)")
_ROW = re.compile(
    r"^\| (?:· )?\[(?P<name>[^\]]+)\]\((?P<folder>[^)]+)\) \| (?P<question>.*?) \| (?P<answer>.*) \|$", re.M
)


def _linked(readme: Path, found: re.Match[str], page: Path) -> str:
    """A link of a README for its page: folders to their pages, files as downloads, the rest as text."""
    target = (readme.parent / found["target"]).resolve()
    if "://" in found["target"]:
        return found[0]
    if target.is_dir() and (target / "README.md").exists():
        target = target / "README.md"
    if not target.is_file() or not target.is_relative_to(STUDIES):
        return found["text"]
    copy = PAGES / target.relative_to(STUDIES)
    if target.name != "README.md":
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(target, copy)
    return f"{found['image']}[{found['text']}]({relpath(copy, page.parent)})"


def write_pages(app: Sphinx) -> None:
    """Write the page of every study; one that has not changed keeps its time, so that nothing is read again."""
    readmes = sorted(STUDIES.rglob("README.md"))
    for readme in readmes:
        page = PAGES / readme.relative_to(STUDIES)
        page.parent.mkdir(parents=True, exist_ok=True)
        text = _LINK.sub(lambda found: _linked(readme, found, page), readme.read_text(encoding="utf-8"))  # noqa: B023
        if _EQUATION.search(text):
            theory = relpath(HERE / "theory" / "models.md", page.parent)
            text += f"\n---\n\nNumbers of equations are those of Ding et al. (2015); [all of them]({theory}).\n"
        if readme.parent == STUDIES:
            others = "\n".join(str(each.relative_to(STUDIES).with_suffix("")) for each in readmes if each != readme)
            text += f"\n```{{toctree}}\n:hidden:\n\n{others}\n```\n"
        if not page.exists() or page.read_text(encoding="utf-8") != text:
            page.write_text(text, encoding="utf-8")


def gallery() -> str:
    """The gallery as Markdown: a card for each study of the index, with its first picture where it has one."""
    cards = []
    for row in _ROW.finditer((STUDIES / "README.md").read_text(encoding="utf-8")):
        readme = STUDIES / row["folder"] / "README.md"
        linked = re.findall(r"!\[([^\]]*)\]\(([^)]+\.png)\)", readme.read_text(encoding="utf-8"))
        pictures = linked + [(row["question"], each.name) for each in sorted(readme.parent.glob("*.png"))]
        first = next((pair for pair in pictures if (readme.parent / pair[1]).is_file()), None)
        if first:
            shutil.copyfile(readme.parent / first[1], PAGES / row["folder"] / Path(first[1]).name)
        picture = f"![{first[0]}](studies/{row['folder']}/{Path(first[1]).name})" if first else ""
        question = _EQUATION.sub(r"\g<0> of Ding et al. 2015", row["question"])
        words = f"**[{question}](studies/{row['folder']}/README.md)**\n\n{row['answer']}."
        cards.append(f":::{{container}} card\n{picture}\n\n{words}\n:::\n")
    return "::::{container} gallery\n" + "\n".join(cards) + "::::\n"


class StudyGallery(SphinxDirective):
    """Cards of all studies in place of the directive."""

    def run(self) -> list[nodes.Node]:
        """Parse the cards where the directive stands."""
        self.env.note_dependency(str(STUDIES / "README.md"))
        return self.parse_text_to_nodes(gallery())


def setup(app: Sphinx) -> dict[str, Any]:
    """Write the pages before Sphinx looks for them."""
    app.connect("builder-inited", write_pages)
    app.add_directive("study-gallery", StudyGallery)
    return {"parallel_read_safe": True}
