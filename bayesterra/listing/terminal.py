"""The console that tables are printed to."""

from rich.console import Console


def plain_console() -> Console:
    """Brackets are units here, not markup."""
    return Console(markup=False)
