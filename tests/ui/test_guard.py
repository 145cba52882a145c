"""Hostile requests: nothing of them gets through."""

from __future__ import annotations

import pytest

from bayesterra.ui.guard import MOST_BODY, Address
from tests.ui.client import Client


@pytest.mark.parametrize(
    ("changed", "status"),
    [
        ({"Cookie": None}, 403),
        ({"Cookie": "bayesterra_1=x"}, 403),
        ({"Host": "evil.example"}, 421),
        ({"Host": "localhost:1"}, 421),
        ({"Host": "127.0.0.1.evil.example"}, 421),
        ({"Origin": "http://evil.example"}, 403),
        ({"Origin": "null"}, 403),
        ({"Origin": None, "Sec_Fetch_Site": "cross-site", "Sec_Fetch_Mode": "no-cors"}, 403),
        ({"Origin": None}, 200),
        ({}, 200),
    ],
)
def test_who_may_read(client: Client, changed: dict[str, str | None], status: int) -> None:
    """Those with the token, by the name of this machine, from no other page."""
    assert client.get("/", **changed).status == status


@pytest.mark.parametrize("origin", [None, "null", "http://evil.example", "http://127.0.0.1:1", "https://127.0.0.1"])
def test_changes_say_whose_they_are(client: Client, origin: str | None) -> None:
    """A form without the origin of this page changes nothing."""
    answer = client.post("/jobs", {"verb": "run", "subject": "hit-wh32"}, Origin=origin)
    assert answer.status == 403
    assert client.site.queue.jobs == ()


def test_the_token_is_handed_out_once_and_as_a_strict_cookie(client: Client) -> None:
    """The address of the terminal leads to the page; a wrong token does not, nor a token in a form."""
    answer = client.get(f"/?token={client.address.token}", Cookie=None, Origin=None)
    assert answer.status == 303
    assert answer.location == "/"
    cookie = answer.headers["set-cookie"].lower()
    assert "httponly" in cookie
    assert "samesite=strict" in cookie
    assert client.get("/?token=wrong", Cookie=None, Origin=None).status == 403
    assert client.post(f"/jobs?token={client.address.token}", Cookie=None).status == 403


def test_pages_forbid_scripts_of_others(client: Client) -> None:
    """No script inside a page, no frame of another, no type that is guessed."""
    headers = client.get("/").headers
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "script-src 'self';" in policy
    assert "unsafe" not in policy
    assert headers["x-content-type-options"] == "nosniff"


def test_a_body_that_says_to_be_large_is_not_read(client: Client) -> None:
    """A gigabyte is refused before its first byte."""
    answer = client.send(
        "POST", "/tables", b"x", Content_Length=str(2**30), Content_Type="multipart/form-data; boundary=a"
    )
    assert answer.status == 413
    assert "more than 20 MB" in answer.text


def test_a_body_that_does_not_say_its_length_ends_where_it_is_too_large(client: Client) -> None:
    """In pieces as well, and nothing of it stays."""
    piece = b'--a\r\nContent-Disposition: form-data; name="file"; filename="x.csv"\r\n\r\n' + b"1" * 2**20
    chunk = f"{len(piece):x}\r\n".encode() + piece + b"\r\n"
    body = chunk + (f"{2**20:x}\r\n".encode() + b"1" * 2**20 + b"\r\n") * (MOST_BODY // 2**20 + 1)
    answer = client.send(
        "POST", "/tables", body, Transfer_Encoding="chunked", Content_Type="multipart/form-data; boundary=a"
    )
    assert answer.status == 413
    assert not (client.site.folder.hidden / "drafts").exists()


def test_names_of_a_page_that_others_may_reach() -> None:
    """Listening to the network, numbers and its own name are taken, and no name that somebody may point here."""
    open_address = Address("0.0.0.0", 8000)  # noqa: S104 (nothing listens)
    assert open_address.is_ours("192.168.1.7:8000")
    assert not open_address.is_ours("rebinding.example:8000")
    assert not Address(port=8000).is_ours("192.168.1.7:8000")
    assert not Address(port=8000).is_ours("127.0.0.1:8000/@evil.example")
