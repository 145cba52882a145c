"""Help of a command as the command line prints it, taken from there when the site is built: ``{command-help} run``."""

from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective
from typer.main import get_command
from typer.testing import CliRunner

from bayesterra.cli import app as command_line


def commands() -> list[str]:
    """Names of all commands."""
    return list(getattr(get_command(command_line), "commands", {}))


def help_of(command: str) -> str:
    """Text of ``bayesterra COMMAND --help``."""
    result = CliRunner().invoke(command_line, [command, "--help"], prog_name="bayesterra", env={"COLUMNS": "80"})
    if result.exit_code:
        raise ValueError(f"no command {command!r}: {result.output}")
    return result.output


class CommandHelp(SphinxDirective):
    """The help in place of the directive."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """A block of plain text."""
        text = help_of(self.arguments[0]).strip("\n")
        return [nodes.literal_block(text, text, language="text")]


def setup(app: Sphinx) -> dict[str, Any]:
    """Add the directive."""
    app.add_directive("command-help", CommandHelp)
    return {"parallel_read_safe": True}
