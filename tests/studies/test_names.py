"""What scripts and pages of the studies name of the package is there: what moved is seen without a run."""

import ast
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted((ROOT / "studies").rglob("*.py"))
PAGES = sorted({ROOT / "README.md", ROOT / "CONTRIBUTING.md", *(ROOT / "studies").rglob("*.md")})


def _named(tree: ast.AST) -> Iterator[tuple[str, str]]:
    """Modules of the package that a script names, with a name in each: imported, or written as text."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] in ("bayesterra", "models"):
            yield from ((str(node.module), alias.name) for alias in node.names)
        elif isinstance(node, ast.Tuple | ast.Call):
            parts = node.elts if isinstance(node, ast.Tuple) else node.args
            texts = [each.value if isinstance(each, ast.Constant) else None for each in parts]
            match texts:
                case [str(module), str(name), *_] if (
                    re.fullmatch(r"bayesterra(\.\w+)*(:\w+)?", module) and name.isidentifier()
                ):
                    yield module, name
                case [str(path), *_] if re.fullmatch(r"bayesterra(\.\w+)+", path):
                    module, name = path.rsplit(".", 1)
                    yield module, name


def _is_there(module: str, name: str) -> bool:
    """Is this an attribute of a module, or a module in it."""
    try:
        if hasattr(resolve_name(module), name):
            return True
        import_module(f"{module}.{name}")
    except (ImportError, AttributeError):
        return False
    return True


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: str(script.relative_to(ROOT / "studies")))
def test_names_of_the_package_are_there(script: Path) -> None:
    """Of every script, whether tests run it or not."""
    named = set(_named(ast.parse(script.read_text(encoding="utf-8"))))
    assert not [pair for pair in sorted(named) if not _is_there(*pair)]


def test_a_name_that_moved_is_seen() -> None:
    """Imported, written beside its module, or patched."""
    tree = ast.parse(
        "from bayesterra.arrays import FloatArray, gone\n"
        "STAGES = {'a': ('bayesterra.arrays', 'frozen'), 'b': ('bayesterra.moved', 'frozen')}\n"
        "patch('bayesterra.arrays.old')\n"
    )
    named = set(_named(tree))
    missing = {pair for pair in named if not _is_there(*pair)}
    assert missing == {("bayesterra.arrays", "gone"), ("bayesterra.moved", "frozen"), ("bayesterra.arrays", "old")}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_files_that_a_page_names_are_there(page: Path) -> None:
    """Of every page that people read."""
    named = re.findall(r"\b(?:bayesterra|models|tests|studies)/[\w/-]+\.py\b", page.read_text(encoding="utf-8"))
    assert not [path for path in named if not (ROOT / path).exists()]


def test_a_module_that_stands_beside_its_script_has_a_name_of_its_own() -> None:
    """One process runs scripts of many folders: the second module of a name would be the first one's."""
    beside: dict[str, set[Path]] = {}
    for script in SCRIPTS:
        for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
            names = [node.module] if isinstance(node, ast.ImportFrom) else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            for name in names:
                if name and (module := script.with_name(f"{name}.py")).is_file():
                    beside.setdefault(name, set()).add(module)
    assert len(beside) > 5
    assert {name: folders for name, folders in beside.items() if len(folders) > 1} == {}
