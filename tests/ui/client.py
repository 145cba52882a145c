"""A page at work on a port of its own, and requests as a browser, or somebody else, makes them."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from http.client import HTTPConnection
from pathlib import Path
from threading import Thread
from time import monotonic, sleep
from urllib.parse import urlencode

import uvicorn

from bayesterra.ui.application import Site, application
from bayesterra.ui.folder import Folder
from bayesterra.ui.guard import Address


@dataclass(frozen=True)
class Answer:
    """What a server said."""

    status: int
    text: str
    headers: Mapping[str, str]

    @property
    def location(self) -> str:
        """Where it sends the reader."""
        return self.headers.get("location", "")


@dataclass
class Client:
    """A reader of the page, by default one who has its token."""

    address: Address
    site: Site
    headers: dict[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        host = f"127.0.0.1:{self.address.port}"
        self.headers = {
            "Host": host,
            "Origin": f"http://{host}",
            "Cookie": f"{self.address.cookie}={self.address.token}",
        }

    def send(self, method: str, path: str, body: bytes = b"", **headers: str | None) -> Answer:
        """Answer to a request; headers in place of the usual ones, None for none."""
        given = {name.replace("_", "-"): value for name, value in headers.items()}
        merged = {name: value for name, value in {**self.headers, **given}.items() if value is not None}
        connection = HTTPConnection("127.0.0.1", self.address.port, timeout=60)
        connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
        if body and "Content-Length" not in merged and "Transfer-Encoding" not in merged:
            merged["Content-Length"] = str(len(body))
        for name, value in merged.items():
            connection.putheader(name, value)
        connection.endheaders()
        with suppress(BrokenPipeError, ConnectionResetError):  # it may not read to the end
            connection.send(body)
        answer = connection.getresponse()
        text = answer.read().decode(errors="replace")
        connection.close()
        return Answer(answer.status, text, {name.lower(): value for name, value in answer.getheaders()})

    def get(self, path: str, **headers: str | None) -> Answer:
        """A page."""
        return self.send("GET", path, b"", **headers)

    def post(self, path: str, form: Mapping[str, str] | None = None, **headers: str | None) -> Answer:
        """Answer to a form."""
        body = urlencode(form or {}).encode()
        return self.send("POST", path, body, Content_Type="application/x-www-form-urlencoded", **headers)

    def upload(self, path: str, name: str, content: bytes, form: Mapping[str, str] | None = None) -> Answer:
        """Answer to a form with a file."""
        mark = secrets.token_hex(8)
        parts = [
            f'--{mark}\r\nContent-Disposition: form-data; name="{k}"\r\n\r\n{v}\r\n'.encode()
            for k, v in (form or {}).items()
        ]
        head = f'--{mark}\r\nContent-Disposition: form-data; name="file"; filename="{name}"\r\n\r\n'.encode()
        body = b"".join(parts) + head + content + f"\r\n--{mark}--\r\n".encode()
        return self.send("POST", path, body, Content_Type=f"multipart/form-data; boundary={mark}")

    def draft(self, table: bytes, name: str = "measurements.csv") -> str:
        """Address of a new draft."""
        answer = self.upload("/tables", name, table)
        assert answer.status == 303, answer.text
        return answer.location


@contextmanager
def served(folder: Path) -> Iterator[Client]:
    """A page of a folder at work, for a reader who has its token."""
    sock = uvicorn.Config("none", host="127.0.0.1", port=0, log_level="critical").bind_socket()
    address = Address(port=int(sock.getsockname()[1]))
    app, site = application(Folder(folder), address)
    server = uvicorn.Server(uvicorn.Config(app, log_level="critical", ws="none", lifespan="on"))
    thread = Thread(target=server.run, kwargs={"sockets": [sock]})
    thread.start()
    until = monotonic() + 30
    while not server.started and monotonic() < until:
        sleep(0.01)
    try:
        yield Client(address, site)
    finally:
        server.should_exit = True
        thread.join(60)
