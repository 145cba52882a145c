"""Start of the command line: exit codes, and errors as one line that begins with ``error:``."""

import gc
import os
import re
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from types import FrameType

import typer

from bayesterra.cli import app
from bayesterra.errors import BayesterraError

# Click's base class of usage errors; newer typers bring their own click, so it is reached through typer.
_UsageProblem: type[Exception] = typer.BadParameter.__mro__[2]

ALLOW_CODE = "--allow-code"
BUG, BAD_INPUT, INTERRUPTED = 1, 2, 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; without arguments it shows the help."""
    if arguments is None:  # a process of its own: cycles among the many objects of libraries are looked for less often
        gc.set_threshold(100_000, 20, 100)
    arguments = list(sys.argv[1:] if arguments is None else arguments) or ["--help"]
    if ALLOW_CODE in arguments:  # of all commands, wherever it stands
        arguments = [ALLOW_CODE, *(each for each in arguments if each != ALLOW_CODE)]
    asked: list[int] = []
    try:
        with _signals_as_interruption(asked):
            code = app(args=arguments, prog_name="bayesterra", standalone_mode=False)
    except BayesterraError as error:
        return _report(str(error), BAD_INPUT)
    except _UsageProblem as error:
        return _report(_usage(error), BAD_INPUT)
    except OSError as error:
        return _report(f"{error.strerror or error}: {error.filename or ''}".rstrip(": "), BAD_INPUT)
    except MemoryError:
        return _report("there is not enough memory for this", BAD_INPUT)
    except KeyboardInterrupt:
        code = INTERRUPTED
    except typer.Abort as abort:  # Click makes one of every EOFError, which no key has caused here
        if isinstance(abort.__cause__, EOFError):
            return _report(_bug(abort.__cause__), BUG)
        code = INTERRUPTED
    except Exception as error:  # whatever it is, nobody should have to read a traceback
        if not asked:  # else compiled code of a library has made an error of the interruption
            return _report(_bug(error), BUG)
        code = INTERRUPTED
    if code == INTERRUPTED:  # some typers turn Ctrl-C into this code themselves
        return _report("interrupted", INTERRUPTED)
    return code if isinstance(code, int) else 0


@contextmanager
def _signals_as_interruption(asked: list[int]) -> Iterator[None]:
    """Take SIGTERM, by which clusters and shutdowns announce the end, as Ctrl-C, and note signals in ``asked``."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    taken = [signal.SIGTERM]
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not where the shell has it ignored
        taken.append(signal.SIGINT)

    def interrupt(sign: int, frame: FrameType | None) -> None:
        asked.append(sign)
        _interrupt(sign, frame)

    def lost(error: "sys.UnraisableHookArgs") -> None:
        """Interrupt once more where it was raised in a place that can raise nothing, as a callback of compiled code."""
        if asked and issubclass(error.exc_type, KeyboardInterrupt):
            again.append(threading.Timer(0.01, os.kill, (os.getpid(), asked[-1])))
            again[-1].start()
        else:
            told(error)

    again, told, sys.unraisablehook = list[threading.Timer](), sys.unraisablehook, lost
    before = [signal.signal(sign, interrupt) for sign in taken]
    try:
        yield
    finally:
        for timer in again:  # whoever called goes on
            timer.cancel()
        for sign, handler in zip(taken, before, strict=True):
            signal.signal(sign, handler)
        sys.unraisablehook = told


def _interrupt(sign: int, frame: FrameType | None) -> None:
    """Raise KeyboardInterrupt, but end by the signal while something is imported: that may swallow errors."""
    importing = frame
    while importing is not None:
        if importing.f_code.co_filename == "<frozen importlib._bootstrap>":
            signal.signal(sign, signal.SIG_DFL)
            os.kill(os.getpid(), sign)
        importing = importing.f_back
    raise KeyboardInterrupt


def _report(message: str, code: int) -> int:
    from bayesterra.errors import in_short, printable

    typer.echo(f"error: {in_short(printable(message))}", err=True)
    return code


def _bug(error: BaseException) -> str:
    """Message for an error that is ours, with all about it in a file of its own."""
    import traceback

    bug = f"this is a bug in bayesterra ({type(error).__name__}): please report it with"
    text = "".join(traceback.format_exception(error))
    for folder in (None, "."):  # the one for temporary files may be full
        with suppress(OSError):
            return f"{bug} {_log(text, folder)}"
    calls = traceback.extract_tb(error.__traceback__)[-3:]
    place = ", ".join(f"{call.filename}:{call.lineno}" for call in reversed(calls))
    return f"{bug} this line, as no log can be written: {error} (at {place})"


def _log(text: str, folder: str | None) -> str:
    """Write a text to a new file, whole or not at all; its path."""
    from tempfile import mkstemp

    handle, path = mkstemp(prefix="bayesterra-", suffix=".log", dir=folder)
    try:
        with os.fdopen(handle, "w", encoding="utf-8", errors="backslashreplace") as log:
            log.write(text)
    except OSError:
        os.unlink(path)
        raise
    return path


def _usage(error: Exception) -> str:
    """Click's message, with the nearest command or option where it names an unknown one."""
    format_message = getattr(error, "format_message", error.__str__)
    message = re.sub(r"\(Possible options: (.*)\)", r"(did you mean \1?)", str(format_message()))
    message = re.sub(r"(No such option: \S+) Did you mean (.*)\?$", r"\1 (did you mean \2?)", message)
    unknown = re.match(r"No such command '(.*?)'\.?$", message)
    if unknown is None:
        return message
    from bayesterra.errors import did_you_mean

    commands = [command.callback.__name__ for command in app.registered_commands if command.callback]
    return f"No such command '{unknown[1]}'{did_you_mean(unknown[1], commands)}"


if __name__ == "__main__":
    sys.exit(main())
