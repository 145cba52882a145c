"""The architecture that the folder listing shows is the one that the code has."""

import ast
import pkgutil
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterable
from functools import cache
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from bayesterra.study.result import AnalysisResult

ROOT = Path(__file__).parent.parent
SOURCES = sorted({*(ROOT / "bayesterra").rglob("*.py")} - {*(ROOT / "bayesterra" / "models").rglob("*.py")})
MODELS = sorted((ROOT / "models").rglob("*.py"))

ONLY_IN = {
    "emcee": {"sampling/ensemble.py"},
    "arviz_stats": {"stats/diagnostics.py"},
    "arviz": set(),
    "h5netcdf": {"runtime/netcdf.py"},
    "h5py": {"runtime/netcdf.py"},
    "pint": {"study/units.py"},
    "pyarrow": {"runtime/recordings.py"},
    "rosbags": {"runtime/recordings.py"},
    "distributed": {"runtime/engines.py"},
    "dask": {"runtime/engines.py"},
    "cloudpickle": {"runtime/engines.py"},
    "jinja2": {"report/sections.py"},
    "dynesty": {"sampling/evidence.py"},
    "typer": {"cli.py", "__main__.py"},
    "starlette": {"ui/"},
    "uvicorn": {"ui/"},
}
"""Outside libraries that one part of the package only may import."""


@cache
def imported(path: Path) -> frozenset[str]:
    """Top-level names that a source file imports, wherever in the file."""
    nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
    plain = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    return frozenset(plain | {node.module for node in nodes if isinstance(node, ast.ImportFrom) and node.module})


@pytest.mark.parametrize("library", ONLY_IN)
def test_outside_libraries_are_imported_in_one_place(library: str) -> None:
    """A library with a seam of its own is imported behind that seam only."""
    users = {
        path.relative_to(ROOT / "bayesterra").as_posix()
        for path in SOURCES
        if any(name.split(".")[0] == library for name in imported(path))
    }
    strays = {user for user in users if not any(user.startswith(allowed) for allowed in ONLY_IN[library])}
    assert not strays


def is_page(name: str) -> bool:
    """True where a module of this name draws."""
    return name in ("page", "figures") or name.endswith("_page")


@pytest.mark.parametrize("library", ["matplotlib", "corner"])
def test_only_pages_draw(library: str) -> None:
    """Plots are made in files called page, figures or so, which are loaded where something is drawn."""
    users = [path for path in SOURCES if any(name.split(".")[0] == library for name in imported(path))]
    assert users
    assert [path for path in users if not is_page(path.stem)] == []


def test_pages_are_loaded_only_where_something_is_drawn() -> None:
    """Whoever is no page imports one inside the function that needs it, or for its types alone."""
    strays = []
    for path in (path for path in SOURCES if not is_page(path.stem)):
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("bayesterra."):
                names = [str(node.module).rpartition(".")[2], *(alias.name for alias in node.names)]
                strays += [(path.name, name) for name in names if is_page(name)]
    assert strays == []


BEFORE_IT_IS_NEEDED: dict[str, set[str]] = {
    "bayesterra.run": {
        *("matplotlib", "corner", "rich", "jinja2", "typer", "arviz_stats", "distributed"),
        *(
            "bayesterra.analysis.page",
            "bayesterra.report.blocks",
            "bayesterra.report.sections",
            "bayesterra.analysis.soil_tests_page",
        ),
        *("bayesterra.follow", "bayesterra.prediction.rover", "bayesterra.design"),
    },
    "import bayesterra.analysis.figures as figures; figures._hist2d()": {"arviz", "arviz_stats", "dask"},
}
"""What a process does, one after the other, and what it has not imported then."""


def modules(code: str, *options: str) -> list[set[str]]:
    """What a new process has imported wherever its code says so."""
    program = f"import sys\ndef say(): print(*sys.modules)\n{code}"
    command = [sys.executable, *options, "-c", program]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    return [set(line.split()) for line in done.stdout.splitlines()]


def test_the_package_alone_imports_next_to_nothing() -> None:
    """Not even what the names of the package need."""
    (found,) = modules("import bayesterra; say()", "-S")
    assert "bayesterra" in found
    assert {"numpy", "typing", "importlib.metadata"} & found == set()


def test_nothing_is_imported_before_it_is_needed() -> None:
    """A name of the package brings what it runs, and no page, plot or other room."""
    code = "".join(f"{step}; say()\n" for step in BEFORE_IT_IS_NEEDED)
    for found, absent in zip(modules(f"import bayesterra\n{code}"), BEFORE_IT_IS_NEEDED.values(), strict=True):
        assert "bayesterra" in found
        assert absent & found == set()


def test_models_know_no_statistics() -> None:
    """The models import nothing of the package but each other."""
    names = set[str]().union(*(imported(path) for path in MODELS))
    assert {name for name in names if name.startswith("bayesterra")} == {
        name for name in names if name.startswith("bayesterra.models")
    }


def test_listed_packages_are_the_folders_that_exist() -> None:
    """The packages of pyproject.toml are the folders with Python files, no more and no fewer."""
    listed = set(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"])
    folders = {path.parent.relative_to(ROOT).as_posix().replace("/", ".") for path in SOURCES}
    assert listed == folders | {"bayesterra.models", "bayesterra.models.kernels"}


def test_models_are_not_importable_under_another_name() -> None:
    """The folder models/ has one import name, so no class exists twice."""
    done = subprocess.run([sys.executable, "-c", "import models"], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode != 0
    assert "bayesterra.models" in done.stderr


def test_public_names_exist_and_do_not_clash_with_modules() -> None:
    """Every public name resolves, and no module shadows one."""
    import bayesterra

    for name in bayesterra.__all__:
        assert getattr(bayesterra, name) is not None
    modules = {path.stem for path in (ROOT / "bayesterra").iterdir()}
    assert not modules & set(bayesterra.__all__)


def test_every_result_has_functions_that_show_it() -> None:
    """What a class of results names as its view has an overview, and a page where there is one."""
    for path in SOURCES:
        if "AnalysisResult" in path.read_text(encoding="utf-8"):
            import_module(".".join(path.relative_to(ROOT).with_suffix("").parts))
    kinds = [kind for kind in derived(AnalysisResult.__subclasses__()) if kind.VIEW]
    assert {"RunResult", "FollowedStream", "PooledResult"} < {kind.__name__ for kind in kinds}
    for kind in kinds:
        for word in ("overview", *(["page"] if kind.PAGE else [])):
            assert callable(pkgutil.resolve_name(f"{kind.VIEW}_{word}"))


def derived(kinds: Iterable[type[AnalysisResult]]) -> list[type[AnalysisResult]]:
    """Classes, and all that derive from them."""
    return [each for kind in kinds for each in (kind, *derived(kind.__subclasses__()))]


REFERENCE = re.compile(r":(?:mod|class|func|meth|attr|data|exc):`([^`]+)`")


def leads_somewhere(name: str, module: ModuleType) -> bool:
    """True where a name of a docstring is one of the package, of its module, or of a class there."""
    if name.startswith("bayesterra"):
        try:
            return pkgutil.resolve_name(name) is not None
        except (ImportError, AttributeError):
            return False
    first, *rest = name.split(".")
    classes = [value for value in vars(module).values() if isinstance(value, type)]
    holders = classes if not hasattr(module, first) else [module]
    return any(_has(holder, [first, *rest]) for holder in holders)


def _has(holder: object, path: list[str]) -> bool:
    """True where attributes, fields of dataclasses included, lead to the end of a path."""
    for name in path:
        if name in getattr(holder, "__dataclass_fields__", {}):
            return True
        if not hasattr(holder, name):
            return False
        holder = getattr(holder, name)
    return True


@pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_references_of_docstrings_lead_somewhere(path: Path) -> None:
    """What a docstring points to is there, by the name that it gives."""
    references = REFERENCE.findall(path.read_text(encoding="utf-8"))
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    module = import_module(name)
    lost = [one for one in references if not leads_somewhere(" ".join(one.split()), module)]
    assert lost == []


def test_help_comes_without_the_heavy_libraries() -> None:
    """The command line starts in a blink: help imports none of the large libraries."""
    code = (
        "import sys; from typer.testing import CliRunner; from bayesterra.cli import app;"
        "assert CliRunner().invoke(app, ['--help']).exit_code == 0;"
        "heavy = {'numpy', 'scipy', 'numba', 'pandas', 'matplotlib', 'emcee', 'xarray'};"
        "print(sorted(heavy & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_tests_stand_where_their_subjects_do() -> None:
    """In a folder named after a room every test file names a file of that room, as itself or with more."""
    strays = []
    for path in sorted((ROOT / "tests").glob("*/test_*.py")):
        room = ROOT / "bayesterra" / path.parent.name
        subjects = [source.stem for source in room.rglob("*.py")] if room.is_dir() else []
        name = path.stem.removeprefix("test_")
        if subjects and not any(name == one or name.startswith(f"{one}_") for one in subjects):
            strays.append(path.relative_to(ROOT).as_posix())
    assert strays == []
