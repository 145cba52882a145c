"""Tables of a README that are made from stored files, each between two comments."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence


def markdown(head: Sequence[str], rows: Iterable[Sequence[object]], align: str = "") -> str:
    """A Markdown table; r in ``align`` is a column of numbers."""
    rule = ["---:" if letter == "r" else "---" for letter in align.ljust(len(head), "|")[: len(head)]]
    lines = [[str(cell) for cell in row] for row in (head, rule, *rows)]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def filled(text: str, blocks: Mapping[str, str]) -> str:
    """A README with what stands between ``<!-- name -->`` and ``<!-- end -->`` replaced."""
    for name, block in blocks.items():
        before, opened, rest = text.partition(f"<!-- {name} -->\n")
        _, closed, after = rest.partition("<!-- end -->")
        if not (opened and closed):
            raise ValueError(f"the README must hold the comments of the table '{name}'")
        text = f"{before}{opened}{block}\n{closed}{after}"
    return text


def minus(text: str) -> str:
    """Minus signs in place of hyphens before numbers."""
    return re.sub(r"(?<=[ (\[])-(?=\d)", "−", text)


def mark(word: str) -> str:
    """The verdict on a statement as it stands in a README."""
    return f"**{word}**" if word == "differs" else word
