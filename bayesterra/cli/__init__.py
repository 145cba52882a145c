"""The command line. It only reads options and prints; the work is done by functions that Python can call.

Imports that take long stand inside the commands, so that help and version come at once. Commands are listed
in the help in the order in which they are imported here.
"""

from bayesterra.cli import studies  # isort: skip
from bayesterra.cli import results  # isort: skip
from bayesterra.cli import analyses  # isort: skip
from bayesterra.cli import soiltests  # isort: skip
from bayesterra.cli import streams  # isort: skip
from bayesterra.cli.common import app

__all__ = ["analyses", "app", "results", "soiltests", "streams", "studies"]
