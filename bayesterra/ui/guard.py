"""Guard before the page: host, origin, token and size of what is sent; headers of what is answered."""

from __future__ import annotations

import secrets
from collections.abc import Collection
from dataclasses import dataclass, field
from ipaddress import ip_address
from socket import gethostname
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders, QueryParams
from starlette.exceptions import HTTPException
from starlette.requests import cookie_parser
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

MOST_BODY = 20 * 2**20
"""Bytes, at most, of a request."""
LOOPBACK = ("127.0.0.1", "localhost", "::1")
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self';"
    " frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'self'"
)
"""What pages may load and do: only what this server gives, and no script or style inside a page."""
REPORT_POLICY = (
    "sandbox allow-same-origin allow-popups; default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:;"
    " form-action 'none'; base-uri 'none'; frame-ancestors 'self'"
)
"""The same of pages that a result folder holds: no script at all, whatever stands in them."""
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "SAMEORIGIN",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Content-Security-Policy": POLICY,
    "Cache-Control": "no-store",
}
READING = ("GET", "HEAD")


@dataclass(frozen=True)
class Address:
    """Place where the page listens, and the token without which it answers nobody."""

    host: str = LOOPBACK[0]
    port: int = 8000
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24), repr=False)

    @property
    def url(self) -> str:
        """Address for the browser, with the token."""
        host = LOOPBACK[0] if self.host in ("0.0.0.0", "::") else self.host  # noqa: S104 (compared, not bound)
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/?token={self.token}"

    @property
    def local(self) -> bool:
        """True where only this machine reaches it."""
        return self.host in LOOPBACK

    @property
    def cookie(self) -> str:
        """Name of the cookie; browsers keep cookies by host, not by port."""
        return f"bayesterra_{self.port}"

    def is_ours(self, host: str) -> bool:
        """True where a header ``Host`` names this place: a name that others may point here is none of ours."""
        try:
            parts = urlsplit(f"//{host}")
            name, port = (parts.hostname or "").lower(), parts.port or 80
        except ValueError:
            return False
        if port != self.port or parts.path or "@" in host:
            return False
        if name in (LOOPBACK if self.local else (*LOOPBACK, self.host, gethostname().lower())):
            return True
        return not self.local and _is_number(name)


def _is_number(host: str) -> bool:
    try:
        return bool(ip_address(host))
    except ValueError:
        return False


class Guard:
    """A server behind checks that every request has to pass before anything of it is read."""

    def __init__(self, app: ASGIApp, *, address: Address, most: int = MOST_BODY) -> None:
        self._app, self._address, self._most = app, address, most

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it."""
        if scope["type"] == "lifespan":
            return await self._app(scope, receive, send)
        if scope["type"] != "http":
            return await send({"type": "websocket.close", "code": 1008})
        headers = Headers(scope=scope)
        answer = self._answer(scope, headers)
        if answer is not None:
            return await answer(scope, receive, _with_headers(send))
        await self._app(scope, self._bounded(receive, headers.get("content-length", "0")), _with_headers(send))
        return None

    def _answer(self, scope: Scope, headers: Headers) -> Response | None:
        """A refusal, or the answer that hands out the cookie; None where the request passes."""
        address, token = self._address, self._address.token
        hosts = headers.getlist("host")
        if len(hosts) != 1 or not address.is_ours(hosts[0]):
            return _refusal(421, "This page is not known by that name. Open the address that the terminal shows.")
        if _is_foreign(headers, hosts[0], scope["method"]):
            return _refusal(403, "Requests of other pages are refused.")
        asked = QueryParams(scope["query_string"]).get("token")
        if asked is not None and scope["method"] in READING:
            if not _same(asked, token):
                return _refusal(
                    403, "The token in the address is not the one of this server: it is new at every start."
                )
            response = RedirectResponse(scope["path"] or "/", 303)
            response.set_cookie(address.cookie, token, httponly=True, samesite="strict", path="/")
            return response
        cookies = [cookie_parser(each) for each in headers.getlist("cookie")]
        if not any(_same(each.get(address.cookie, ""), token) for each in cookies):
            return _refusal(403, "Open the address that the terminal shows: it has a token at its end.")
        return None

    def _bounded(self, receive: Receive, length: str) -> Receive:
        """The body as it comes in: nothing of one that says to be too large, and of others what may be sent."""
        size = 0
        too_large = HTTPException(413, f"That is more than {self._most // 2**20} MB: it was not read.")

        async def bounded() -> Message:
            nonlocal size
            if not length.isdecimal() or int(length) > self._most:
                raise too_large
            message = await receive()
            size += len(message.get("body", b""))
            if size > self._most:
                raise too_large
            return message

        return bounded


def _same(given: str, token: str) -> bool:
    return secrets.compare_digest(given.encode(), token.encode())


def _is_foreign(headers: Headers, host: str, method: str) -> bool:
    """True for requests that a page of another origin makes, and for changes that do not say whose they are."""
    origins = headers.getlist("origin")
    if any(origin != f"http://{host}" for origin in origins):
        return True
    if method not in READING:
        return not origins
    site, mode = headers.get("sec-fetch-site", "none"), headers.get("sec-fetch-mode", "navigate")
    return site not in ("none", "same-origin") and mode != "navigate"


def _refusal(status: int, text: str) -> Response:
    return PlainTextResponse(f"{text}\n", status, headers={"Connection": "close"})


def _with_headers(send: Send, kept: Collection[str] = ("Content-Security-Policy", "Cache-Control")) -> Send:
    """Answers with the headers of all; those ``kept`` that an answer brings along stay."""

    async def sent(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in HEADERS.items():
                if name not in kept or name not in headers:
                    headers[name] = value
        await send(message)

    return sent
