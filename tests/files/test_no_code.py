"""Nothing that is read from disk can run code: what the source calls, and with which options."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SOURCES = sorted({*(ROOT / "bayesterra").rglob("*.py")} | {*(ROOT / "models").rglob("*.py")})

RUNS_CODE = {"pickle", "_pickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "yaml", "code"}
"""Modules whose readers build what a file tells them to."""
IN_TRANSIT = {"bayesterra/runtime/engines.py": {"pickle", "cloudpickle"}}
"""Tasks on their way to workers that we or the user started; they never stand on a disk."""
CALLS = {
    "eval", "exec", "compile", "__import__", "runpy", "system", "popen", "Popen", "import_module",
    "AnyReader", "get_types_from_msg", "get_types_from_idl",  # code from the definitions that a bag brings along
}  # fmt: skip
HARMLESS = {
    "re.compile",
    "platform.system",
    "import_module",  # in bayesterra/__init__.py of our own modules; in study/own.py where a user allows it
}
READERS = {
    "read_pickle", "read_hdf", "read_excel", "read_html", "read_xml", "read_sql", "read_json", "read_table",
    "read_parquet", "read_feather", "fromfile", "genfromtxt", "loadtxt", "memmap", "load_extension", "eval_",
    "enable_load_extension", "open_dataset", "open_mfdataset", "open_zarr", "load_dataset", "from_netcdf",
}  # fmt: skip
"""Readers that guess a format, or whose format can hold more than numbers and texts."""
DOORS = {
    "read_csv": {"bayesterra/runtime/tables.py"},
    "to_csv": {"bayesterra/runtime/tables.py"},
    "open_datatree": {"bayesterra/runtime/netcdf.py"},
    "File": {"bayesterra/runtime/netcdf.py"},
    "connect": {"bayesterra/runtime/tasks.py"},
    **{name: {"bayesterra/runtime/recordings.py"} for name in ("loadmat", "whosmat", "ParquetFile", "Reader")},
    # our own sources, for their digest; files of a result, for theirs
    "read_bytes": {"bayesterra/study/canonical.py", "models/kernels/cache.py", "bayesterra/runtime/reading.py"},
    "read_text": {"bayesterra/runtime/tasks.py"},  # the system's table of mounts
}
"""Methods and, of libraries, functions that open files, each in one place only."""
FUNCTIONS = {"loadmat", "whosmat", "ParquetFile", "Reader"}
OWN = dict.fromkeys(("read_json", "read_text", "read_bytes"), "runtime.reading")
OWN["read_table"] = "study.observations"
"""Readers of our own by these names."""


@cache
def tree(path: Path) -> ast.Module:
    """The syntax of a source file."""
    return ast.parse(path.read_text(encoding="utf-8"))


def calls(path: Path) -> list[tuple[str, ast.Call, bool]]:
    """Name, call and whether it is that of a method, of every call in a source file."""
    found = []
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name | ast.Attribute):
            method = isinstance(node.func, ast.Attribute)
            name = node.func.attr if isinstance(node.func, ast.Attribute) else node.func.id
            found.append((name, node, method))
    return found


def imports(path: Path) -> set[str]:
    """Modules and names that a source file imports."""
    found: set[str] = set()
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module.split(".")[0], *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found


def test_no_source_runs_what_it_reads() -> None:
    """No pickle, no eval, no reader that guesses; files are opened behind few doors."""
    wrong = [problem for path in SOURCES for problem in problems(path)]
    assert wrong == []
    assert any(name == "import_module" for name, _, _ in calls(ROOT / "bayesterra" / "__init__.py"))


def problems(path: Path) -> list[str]:
    """What a source file must not do."""
    here, imported = path.relative_to(ROOT).as_posix(), imports(path)
    found = [f"{here}: imports {name}" for name in imported & RUNS_CODE - IN_TRANSIT.get(here, set())]
    for name, call, method in calls(path):
        whole = ast.unparse(call.func)
        own = (
            f"bayesterra.{OWN.get(name)}.{name}" in imported
            or here == f"bayesterra/{OWN.get(name, '').replace('.', '/')}.py"
        )
        runs = name in CALLS and whole not in HARMLESS
        guesses = name in READERS and (method or not own)
        elsewhere = (method or name in FUNCTIONS) and here not in DOORS.get(name, {here})
        if runs or guesses or elsewhere:
            found.append(f"{here}:{call.lineno}: {whole}")
    return found


@pytest.mark.parametrize(
    "line",
    [
        "import pickle",
        "eval(text)",
        "pd.read_pickle(path)",
        "path.read_text()",
        "xr.open_dataset(p)",
        "h5py.File(p)",
        "loadmat(p)",
        "pd.read_parquet(p)",
        "rosbag1.Reader(p)",
        "AnyReader([p])",
    ],
)
def test_a_line_that_could_is_noticed(line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In any source file."""
    (tmp_path / "bayesterra").mkdir()
    (tmp_path / "bayesterra" / "other.py").write_text(line, encoding="utf-8")
    monkeypatch.setattr(f"{__name__}.ROOT", tmp_path)
    assert problems(tmp_path / "bayesterra" / "other.py")


def test_libraries_are_asked_for_data_only() -> None:
    """NumPy without pickles; xarray with one engine, which knows none; SQLite without extensions."""
    loads = [
        (path, call)
        for path in SOURCES
        for name, call, method in calls(path)
        if method and name == "load" and ast.unparse(call.func) == "np.load"
    ]
    assert [path.name for path, _ in loads] == ["checkpoints.py"]
    assert all("allow_pickle=False" in ast.unparse(call) for _, call in loads)
    (opening,) = [
        call for name, call, _ in calls(ROOT / "bayesterra" / "runtime" / "netcdf.py") if name == "open_datatree"
    ]
    assert "engine='h5netcdf'" in ast.unparse(opening)


def test_an_object_in_an_array_is_refused(tmp_path: Path) -> None:
    """A segment with a pickled array in it counts as damaged, and what is in it does not run."""
    from hashlib import sha256
    from io import BytesIO

    import numpy as np

    from bayesterra.runtime.checkpoints import Checkpoints

    mark = tmp_path / "ran"

    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return (Path.touch, (mark,))  # type: ignore[return-value]

    packed = BytesIO()
    np.savez(packed, x=np.array([Trap()], dtype=object))
    content = b'{"run": "x", "segment": "s"}\n' + packed.getvalue()
    (tmp_path / "s.segment").write_bytes(sha256(content).hexdigest().encode() + b"\n" + content)
    assert Checkpoints(tmp_path, "x").load("s") is None
    assert not mark.exists()
    packed.seek(0)
    with np.load(packed, allow_pickle=True) as arrays:  # the trap is a trap
        arrays["x"]
    assert mark.exists()
