"""What was compiled is kept on disk; where that cannot be, or went wrong, it is compiled again."""

import inspect
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Annotated, Any, get_args, get_origin, get_type_hints

import numpy as np
import pytest
import typer
from numba.core import config
from typer.main import get_command

import bayesterra
from bayesterra.cli import app, hushed
from bayesterra.models.kernels import cache as kernel_cache
from bayesterra.models.kernels.compiler import called, compiled
from bayesterra.sampling.sampler import progress_bar

ROOT = Path(bayesterra.__file__).parents[1]


def halved(x: float) -> float:
    """A function that is compiled in no time."""
    return 0.5 * x


@pytest.mark.usefixtures("cache")
def test_a_constant_is_a_number_of_its_kind() -> None:
    """Callers in compiled code with other whole numbers share one version of what they call."""

    @compiled
    def tenfold(i: int) -> int:
        return 10 * i

    @compiled
    def summed(i: int) -> int:
        return tenfold(1) + tenfold(2) + tenfold(i)

    versions: Any = tenfold
    assert summed(3) == 60
    assert [str(kind) for (kind,) in versions.signatures] == ["int64"]


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Folder of compiled functions for this test alone; nothing was said of it yet."""
    monkeypatch.setattr(config, "CACHE_DIR", str(tmp_path / "cache"))
    monkeypatch.setattr(kernel_cache, "_told", [])
    return tmp_path / "cache"


def test_what_is_only_called_has_no_code_of_its_own(cache: Path) -> None:
    """It is part of the code of its callers, on disk too; called from Python it says so."""

    @called
    def tenth(x: float) -> float:
        return 0.1 * x

    @compiled
    def hundredth(x: float) -> float:
        return tenth(tenth(x))

    assert hundredth(30.0) == 0.1 * (0.1 * 30.0)
    assert "hundredth" in entry(cache).name
    with pytest.raises(TypeError, match="'tenth' can be called from compiled code only"):
        tenth(30.0)


def hits() -> int:
    """Compile and call the function as another process would; how often the cache was of use."""
    dispatcher: Any = compiled(halved)
    assert dispatcher(3.0) == 1.5
    return sum(dispatcher.stats.cache_hits.values())


def entry(cache: Path) -> Path:
    """The one file there is."""
    (found,) = (path for path in cache.rglob("*") if not path.is_dir() or path.suffix == ".nbc")
    return found


def folder_in_place(path: Path) -> None:
    """Put a folder where the entry was."""
    path.unlink()
    path.mkdir()


def endless_link(path: Path) -> None:
    """Put a link to itself where the entry was."""
    path.unlink()
    path.symlink_to(path)


def one_bit(path: Path) -> None:
    """Turn a bit in the middle: of machine code, which would run."""
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 1
    path.write_bytes(content)


DAMAGES: dict[str, Callable[[Path], object]] = {
    "empty": lambda path: path.write_bytes(b""),
    "truncated": lambda path: path.write_bytes(path.read_bytes()[:-100]),
    "of a few bytes": lambda path: path.write_bytes(path.read_bytes()[:10]),
    "random": lambda path: path.write_bytes(np.random.default_rng(1).bytes(5000)),
    "one bit": one_bit,
    "folder": folder_in_place,
    "endless link": endless_link,
}


@pytest.mark.parametrize("kind", DAMAGES)
def test_a_damaged_entry_is_made_anew(kind: str, cache: Path) -> None:
    """It counts as absent: the result is right, and the next start finds it whole (not where a folder is)."""
    assert [hits(), hits()] == [0, 1]
    DAMAGES[kind](entry(cache))
    assert hits() == 0
    assert hits() == (0 if kind == "folder" else 1)
    assert entry(cache).is_dir() == (kind == "folder")  # and nothing else is left behind


@pytest.mark.usefixtures("cache")
def test_who_waits_is_told_what_is_compiled() -> None:
    """Once, before it is, and not when it is read from disk; the status file of a run says so."""
    names = list[str]()
    with kernel_cache.told_of_compiling(names.append):
        assert compiled(halved)(3.0) == 1.5
        assert compiled(halved)(3.0) == 1.5
    assert compiled(halved)(4) == 2.0
    assert names == ["halved"]
    stages = list[str]()
    status: Any = SimpleNamespace(note=lambda stage, *_, **__: stages.append(stage))
    with progress_bar(status, quiet=True):
        compiled(halved)(True)
    assert stages == ["compiling"]


def test_other_sources_other_code(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An entry of other sources is compiled anew, and replaced."""
    assert [hits(), hits()] == [0, 1]
    monkeypatch.setattr(kernel_cache, "_fingerprint", lambda source: "other")
    assert [hits(), hits()] == [0, 1]
    assert entry(cache).is_file()


def test_without_a_folder_it_works_and_says_so_once(
    cache: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """One note that names the way out; none with --quiet."""
    cache.write_text("a file where the folder should be", encoding="utf-8")
    assert not kernel_cache._writable(cache / "models")
    monkeypatch.setattr(kernel_cache, "_writable", lambda folder: False)
    assert [hits(), hits()] == [0, 0]
    (note,) = caplog.messages
    assert note.startswith(f"note: compiled models cannot be kept (no write access to {cache}")
    assert note.endswith("NUMBA_CACHE_DIR may name a folder that can be written")
    caplog.clear()
    kernel_cache._told.clear()
    command = typer.Context(get_command(app))
    with command:
        assert hushed(command, True)
        assert hits() == 0
    assert not caplog.messages
    kernel_cache._told.clear()
    command = typer.Context(get_command(app))
    with command:
        assert not hushed(command, False)
        assert hits() == 0
    assert len(caplog.messages) == 1  # --quiet of one command says nothing of the next


def test_a_folder_that_can_only_be_read_is_read(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An image with a warm cache needs no other."""
    assert hits() == 0
    monkeypatch.setattr(kernel_cache, "_writable", lambda folder: False)
    assert hits() == 1


def test_a_full_disk_is_no_reason_to_stop(tmp_path: Path) -> None:
    """What does not fit is not kept: one note with the file, no part of it left, the right number."""
    script = (
        "import resource\n"
        "resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n"
        f"import sys; sys.path.insert(0, {str(tmp_path)!r})\n"
        "from numbers_halved import halved\n"
        "from bayesterra.models.kernels.compiler import compiled\n"
        "print(compiled(halved)(3.0))\n"
    )
    (tmp_path / "numbers_halved.py").write_text(inspect.getsource(halved), encoding="utf-8")
    kept = tmp_path / "cache"
    environment = {
        **os.environ, "NUMBA_CACHE_DIR": str(kept), "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": str(ROOT),
    }  # fmt: skip
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "1.5\n")
    (note,) = done.stderr.splitlines()
    assert note.startswith(f"note: compiled models cannot be kept (File too large: {kept}")
    assert not [path for path in kept.rglob("*") if path.is_file()]


READ_ONLY = "mount --bind models models && mount -o remount,ro,bind models models"


def test_a_read_only_installation_runs() -> None:
    """A cache beside the sources that can only be read, and no home: nothing is compiled or said."""
    if subprocess.run(["unshare", "-m", "sh", "-c", READ_ONLY], cwd=ROOT, capture_output=True).returncode:
        pytest.skip("needs the right to mount")
    script = (
        "from numba.core.event import install_recorder\n"
        "with install_recorder('numba:compile') as recorder:\n"
        "    from bayesterra.models import warm_up; warm_up()\n"
        "print(len(recorder.buffer))\n"
    )
    environment = {**os.environ, "HOME": "/dev/null/nowhere", "PYTHONPATH": str(ROOT)}
    environment.pop("XDG_CACHE_HOME", None)
    command = ["unshare", "-m", "sh", "-c", f'{READ_ONLY} && cd / && exec "$0" -c "$1"', sys.executable, script]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "0\n", "")


@pytest.mark.slow
def test_what_compiles_and_what_reads_from_disk_give_the_same_bits(tmp_path: Path) -> None:
    """In either order of use: a worker that finds compiled code agrees with the process that made it."""
    script = (
        f"import sys; sys.path.insert(0, {str(ROOT)!r})\n"
        "import numpy as np\n"
        "from bayesterra.likelihood.posterior import posterior\n"
        "from bayesterra.identifiability.profiles import profiles\n"
        "from bayesterra.runtime.engines import in_process\n"
        "from tests.identifiability.conftest import VARIANTS\n"
        "asked = posterior(VARIANTS['unknown load']())\n"
        "places = np.column_stack([np.linspace(800, 1800, 200), np.linspace(0.5, 0.7, 200)])\n"
        "def density():\n"
        "    return asked.log_density(places).tobytes().hex()\n"
        "def traced():\n"
        "    found = profiles(asked, rng=np.random.default_rng(1), engine=in_process()).found\n"
        "    return [part.path.tobytes().hex() for kind in found.values() for part in kind]\n"
        "said = {name: globals()[name]() for name in sys.argv[1:]}\n"
        "print(sorted(said.items()))\n"
    )
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    printed = []
    for order in (("density", "traced"), ("density", "traced"), ("traced", "density")):
        command = [sys.executable, "-c", script, *order]
        done = subprocess.run(command, env=environment, capture_output=True, text=True)
        assert (done.returncode, done.stderr) == (0, "")
        printed.append(done.stdout)
    assert len(printed[0]) > 1000
    assert printed[0] == printed[1] == printed[2]


def test_every_quiet_option_keeps_notes_back() -> None:
    """Each command's --quiet hands its value on."""
    options = [
        get_args(hint)[1]
        for command in app.registered_commands
        if command.callback is not None
        for name, hint in get_type_hints(command.callback, include_extras=True).items()
        if name == "quiet" and get_origin(hint) is Annotated
    ]
    assert len(options) >= 7
    assert all(option.callback is hushed for option in options)
