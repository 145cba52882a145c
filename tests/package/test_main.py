"""Ends of the command line: bugs, signals, and files that cannot be written."""

import ctypes
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from bayesterra import __main__ as command_line
from bayesterra.errors import BayesterraError
from tests.support.choice import some

STUDY = Path(__file__).parents[2] / "studies" / "hit-wh32" / "study.toml"


def failing(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    """Let ``check`` meet an error of ours."""

    def fail(path: Path) -> None:
        raise error

    monkeypatch.setattr("bayesterra.study.study.load_study", fail)


def line_of(capsys: pytest.CaptureFixture[str]) -> str:
    """The one line on standard error."""
    lines = [line for line in capsys.readouterr().err.splitlines() if line]
    assert len(lines) == 1
    return lines[0]


def test_an_end_of_file_is_a_bug_with_a_log(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Click takes every EOFError for an interruption; nobody has interrupted anything."""
    failing(monkeypatch, EOFError("half a file"))
    assert command_line.main(["check", str(STUDY)]) == 1
    line = line_of(capsys)
    assert line.startswith("error: this is a bug in bayesterra (EOFError): please report it with ")
    log = Path(line.rpartition(" ")[2])
    assert "EOFError: half a file" in log.read_text()
    log.unlink()


def test_an_interruption_is_still_one(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    """Ctrl-C ends with 130 and one word."""
    failing(monkeypatch, KeyboardInterrupt())
    assert command_line.main(["check", str(STUDY)]) == 130
    assert line_of(capsys) == "error: interrupted"


@pytest.mark.skipif(sys.platform == "win32", reason="signals as POSIX has them")
def test_an_interruption_that_a_library_makes_an_error_of_is_still_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Compiled code swallows what is raised in it, and raises something of its own: no bug of ours."""

    def swallowing(path: Path) -> None:
        try:
            os.kill(os.getpid(), signal.SIGTERM)
            time.sleep(1)
        except KeyboardInterrupt:
            raise ValueError("Invalid affine transformation matrix") from None

    monkeypatch.setattr("bayesterra.study.study.load_study", swallowing)
    assert command_line.main(["check", str(STUDY)]) == 130
    assert line_of(capsys) == "error: interrupted"


@pytest.mark.skipif(sys.platform == "win32", reason="signals as POSIX has them")
def test_an_interruption_of_a_place_that_can_raise_nothing_is_not_lost(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    """A callback of compiled code, as LLVM's to numba: Python would print a traceback and go on."""

    def interrupted() -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)

    def calling(path: Path) -> None:
        ctypes.CFUNCTYPE(None)(interrupted)()
        time.sleep(30)
        raise AssertionError("lost")

    monkeypatch.setattr("bayesterra.study.study.load_study", calling)
    monkeypatch.setattr(sys, "unraisablehook", hook := sys.__unraisablehook__)
    assert command_line.main(["check", str(STUDY)]) == 130
    assert capfd.readouterr().err == "error: interrupted\n"
    assert sys.unraisablehook is hook


@pytest.mark.skipif(sys.platform == "win32", reason="signals as POSIX has them")
def test_an_interruption_that_comes_too_late_does_not_reach_the_caller(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command ends before the signal is sent once more, and whoever called it goes on."""
    caught: list[int] = []

    def interrupted() -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(1)

    def calling(path: Path) -> None:
        ctypes.CFUNCTYPE(None)(interrupted)()
        raise BayesterraError("the end")

    monkeypatch.setattr("bayesterra.study.study.load_study", calling)
    before = signal.signal(signal.SIGTERM, lambda sign, frame: caught.append(sign))
    try:
        command_line.main(["check", str(STUDY)])
        time.sleep(0.05)
    finally:
        signal.signal(signal.SIGTERM, before)
    assert not caught


def test_a_bug_is_one_line_wherever_its_log_can_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A full folder for temporary files: the log is in the working directory, or all is in the line."""
    failing(monkeypatch, RuntimeError("broken"))
    monkeypatch.chdir(tmp_path)
    mkstemp = command_line._log

    def full(text: str, folder: str | None) -> str:
        if folder is None:
            raise OSError(28, "No space left on device")
        return mkstemp(text, folder)

    monkeypatch.setattr(command_line, "_log", full)
    assert command_line.main(["check", str(STUDY)]) == 1
    line = line_of(capsys)
    assert "RuntimeError: broken" in (tmp_path / Path(line.rpartition(" ")[2]).name).read_text()

    def nowhere(text: str, folder: str | None) -> str:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(command_line, "_log", nowhere)
    assert command_line.main(["check", str(STUDY)]) == 1
    line = line_of(capsys)
    assert line.startswith("error: this is a bug in bayesterra (RuntimeError): please report it with this line, as")
    assert "broken (at " in line
    assert "test_main.py:" in line


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="Linux")
def test_half_a_log_does_not_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a full disk the begun file is removed."""
    full = os.open("/dev/full", os.O_WRONLY)
    begun = tmp_path / "bayesterra-1.log"
    begun.touch()
    monkeypatch.setattr("tempfile.mkstemp", lambda **_: (full, str(begun)))
    with pytest.raises(OSError, match="No space left"):
        command_line._log("text", None)
    assert not begun.exists()


@pytest.mark.skipif(sys.platform == "win32", reason="signals as POSIX has them")
@pytest.mark.parametrize("sign", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_during_imports_ends_the_process(sign: signal.Signals, tmp_path: Path) -> None:
    """A module that swallows what is raised as it is imported does not keep the process alive."""
    (tmp_path / "page.py").write_text(
        "import sys, time\nprint('ready', flush=True)\n"
        "try:\n    time.sleep(60)\nexcept BaseException:\n    pass\nprint('swallowed', flush=True)\n"
    )
    program = (
        "import signal, sys, bayesterra.likelihood, bayesterra.__main__ as line\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"  # ignored in jobs in the background
        f"bayesterra.likelihood.__path__.insert(0, {str(tmp_path)!r})\n"  # the command imports its page from there
        f"sys.exit(line.main(['check', {str(STUDY)!r}]))\n"
    )
    command = [sys.executable, "-c", program]
    with subprocess.Popen(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"ready\n"
        process.send_signal(sign)
        assert process.stdout.read() == b""
    assert process.returncode == -sign


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals as POSIX has them")
def test_a_termination_at_any_moment_of_the_start_ends_the_process(tmp_path: Path) -> None:
    """With 130 or by the signal, whatever was being imported."""
    command = [sys.executable, "-m", "bayesterra", "check", str(STUDY)]
    started = time.monotonic()
    subprocess.run(command, check=True, capture_output=True, timeout=3000)
    span = time.monotonic() - started
    for moment in some(range(12), 6):
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
            time.sleep(span * moment / 12)
            process.terminate()
            error = process.communicate(timeout=300)[1]
        assert process.returncode in (-signal.SIGTERM, 130, 0)
        assert b"Traceback" not in error
        if process.returncode == 0:
            assert moment > 6
