"""The console that everything is printed to: text is text there, wherever it comes from."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.text import Text

from bayesterra.errors import printable
from bayesterra.failures import sentences


class PlainConsole(Console):
    """A console that knows no markup and no emoji codes, and lets no control character through."""

    def __init__(self, *, stderr: bool = False) -> None:
        super().__init__(stderr=stderr, markup=False, emoji=False, highlight=False)

    def render_str(self, text: str, **options: Any) -> Text:
        """Text of a sentence or of a cell: brackets are units, and what does not show is spelled out."""
        options |= {"markup": False, "emoji": False}
        return super().render_str("\n".join(map(_harmless, text.split("\n"))), **options)


def print_failures(console: Console, record: Mapping[str, Any]) -> None:
    """Say what could not be computed; nothing where all could."""
    if text := sentences(record):
        console.print(
            f"{text} run.json says where it failed: please report it.", highlight=False, soft_wrap=True
        )


def _harmless(line: str) -> str:
    """A line with its spaces as they are."""
    return "".join(part if part.isspace() else printable(part) for part in re.split(r"( +)", line))
