"""Server of the page: where it listens, what it prints, and how it ends."""

from __future__ import annotations

import os
import sys
import webbrowser
from contextlib import suppress
from pathlib import Path

import uvicorn

from bayesterra.errors import BayesterraError, ResultError, StudyError
from bayesterra.report.terminal import PlainConsole
from bayesterra.runtime.ownership import locked
from bayesterra.ui.application import application
from bayesterra.ui.folder import Folder
from bayesterra.ui.guard import LOOPBACK, Address


def serve(root: Path, *, port: int = 0, host: str = LOOPBACK[0], browser: bool = True) -> None:
    """Serve the page of a folder until it is interrupted.

    Parameters
    ----------
    port : 0 for one that is free.
    host : address to listen on; one that is not this machine's own lets others in, which is said.
    browser : open it, where there is a screen.

    Raises
    ------
    StudyError : no such folder, or it cannot be listened there.
    ResultError : another page works in the folder.
    """
    folder = Folder(root)
    try:
        folder.hidden.mkdir(exist_ok=True)
        with locked(folder.hidden / "lock", f"'{folder.hidden}'") as ours:
            ours.sign()
            _serve(folder, port=port, host=host, browser=browser)
    except BayesterraError as error:
        if isinstance(error, ResultError) and "another run" in str(error):
            raise ResultError(f"another page works in '{folder.root}': use that one, or end it first") from error
        raise
    except OSError as error:
        raise StudyError(f"'{folder.root}' cannot be written: {error.strerror or error}") from error


def _serve(folder: Folder, *, port: int, host: str, browser: bool) -> None:
    console = PlainConsole()
    try:
        sock = uvicorn.Config(_nothing, host=host, port=port, log_level="critical").bind_socket()
    except SystemExit:  # of uvicorn, which has only logged why
        raise StudyError(f"nothing can listen on {host}, port {port}: give another --port, or none") from None
    with sock:
        sock.listen(128)  # the address that is printed answers at once
        address = Address(host, int(sock.getsockname()[1]))
        app, _ = application(folder, address)
        if not address.local:
            console.print(
                f"Warning: everyone who reaches {host} and knows the token can use this page, and what is sent is"
                " not encrypted. Give the address to nobody, or go through ssh.", soft_wrap=True,
            )  # fmt: skip
        console.print(f"Page of {folder.root}: {address.url}", soft_wrap=True)
        console.print("Ctrl-C ends it. A run at work is put down, and goes on with the next start.", soft_wrap=True)
        sys.stdout.flush()  # whoever reads it through a pipe waits for the address
        if browser and _has_screen():
            webbrowser.open(address.url)
        config = uvicorn.Config(
            app, log_level="warning", ws="none", lifespan="on", server_header=False, access_log=False,
            timeout_graceful_shutdown=5, h11_max_incomplete_event_size=65536,
        )  # fmt: skip
        with suppress(KeyboardInterrupt):
            uvicorn.Server(config).run(sockets=[sock])


async def _nothing(*_: object) -> None:
    """An application that answers nothing: only its place is asked for."""


def _has_screen() -> bool:
    return sys.platform in ("darwin", "win32") or any(name in os.environ for name in ("DISPLAY", "WAYLAND_DISPLAY"))
