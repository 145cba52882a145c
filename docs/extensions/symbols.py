"""Symbols, units and names of everything that is estimated or measured, from the package: ``{symbols} soil``."""

from collections.abc import Iterable
from typing import Any, ClassVar

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

from bayesterra.parameters import CHANNELS, DERIVED, EFFICIENCY, PARAMETERS, PRIOR_PARAMETERS, Channel

_SETS: dict[str, Iterable[Channel]] = {
    "soil": [PARAMETERS[name] for name in PRIOR_PARAMETERS],
    "sizes": [each for name, each in PARAMETERS.items() if name not in PRIOR_PARAMETERS],
    "channels": [*CHANNELS.values(), EFFICIENCY],
    "derived": DERIVED.values(),
}


def markdown(which: str) -> str:
    """Table of one set as Markdown."""
    rows = [
        f"| ${each.latex}$ | `{each.name}` | {each.unit.replace('-', '–')} | {each.description} |"
        for each in _SETS[which]
    ]
    return "\n".join(["| symbol | name | unit | meaning |", "|---|---|---|---|", *rows, ""])


class Symbols(SphinxDirective):
    """Table of symbols in place of the directive."""

    required_arguments = 1
    option_spec: ClassVar = {}

    def run(self) -> list[nodes.Node]:
        """Parse the table where the directive stands."""
        return self.parse_text_to_nodes(markdown(self.arguments[0]))


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the directive."""
    app.add_directive("symbols", Symbols)
    return {"parallel_read_safe": True}
