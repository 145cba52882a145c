"""Sections of the package's docstrings as lists: ``name : meaning`` under Parameters, Attributes and Raises."""

import re
from typing import Any

from sphinx.application import Sphinx

_ENTRY = re.compile(r"(?P<names>\*{0,2}[\w.]+(?:, \*{0,2}[\w.]+)*) : (?P<words>.*)")


def _sections(lines: list[str]) -> list[str]:
    """Lines of a docstring, its underlined headings as bold lines and their entries as items of a list."""
    made: list[str] = []
    inside = False
    for number, line in enumerate(lines):
        following = lines[number + 1] if number + 1 < len(lines) else ""
        if following and set(following) == {"-"} and line.strip():
            made += [f"**{line.strip()}**", ""]
            inside = True
        elif line and set(line) == {"-"} and inside:
            continue
        elif inside and (entry := _ENTRY.fullmatch(line)):
            made.append(f"* ``{entry['names']}``: {entry['words']}")
        elif inside and line.startswith("    ") and line.strip():
            made.append(f"  {line.strip()}")
        else:
            made.append(line)
    return made


def _process(app: Sphinx, what: str, name: str, of: object, options: object, lines: list[str]) -> None:
    lines[:] = [re.sub(r"(``.*?``)|\|", lambda bar: bar[1] or r"\|", line) for line in _sections(lines)]


def setup(app: Sphinx) -> dict[str, Any]:
    """Let autodoc hand every docstring over."""
    app.connect("autodoc-process-docstring", _process)
    return {"parallel_read_safe": True}
