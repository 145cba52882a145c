"""The application and what its commands have in common."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Posterior distributions of the mechanical parameters of planetary soil, from wheel tests.",
    epilog="Start with [bold]bayesterra init study.toml[/bold]. Exit codes: 0 done, 2 bad input,"
    " 3 not converged, 130 interrupted, 1 a bug.",
)

StudyPath = Annotated[
    Path, typer.Argument(metavar="STUDY", help="A study file, or a folder that holds study.toml.")
]
Workers = Annotated[
    int | None, typer.Option(min=1, metavar="K", help="Worker processes; by default one per processor.")
]
Scheduler = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Dask scheduler, e.g. tcp://10.0.0.5:8786: its workers compute."),
]
Seed = Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the random numbers.")]

Wheels = Annotated[
    list[str] | None,
    typer.Option(
        "--wheel", metavar="NAME|FILE", help="A wheel of the study, or a file of one; may be repeated."
    ),
]


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"bayesterra {version('bayesterra')}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Options that need no command."""


def hushed(quiet: bool) -> bool:
    """Value of --quiet, which keeps back the notes of the package, too."""
    logging.getLogger("bayesterra").setLevel(logging.ERROR if quiet else logging.NOTSET)
    return quiet


def beside(study: Path, what: str) -> Path:
    """Default folder for what is made from a study, in the working directory."""
    folder = study if study.is_dir() else study.parent
    return Path(f"{folder.resolve().name}-{what}")
