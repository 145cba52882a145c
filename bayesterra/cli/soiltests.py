"""The command for conventional soil tests: soiltest."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayesterra.cli.common import Seed, app, hushed


@app.command()
def soiltest(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="A soil-test file, or a folder that holds soiltest.toml.")
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="New folder; by default <name>-result.")
    ] = None,
    seed: Seed = 1,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an older result of that name.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", callback=hushed, help="No progress, only the result.")
    ] = False,
) -> None:
    """Plate sinkage or annular shear tests: their posterior beside least squares, and a report."""
    from bayesterra.listing.soiltests import print_soil_test
    from bayesterra.soiltesting import soil_test_into

    name = file.resolve().name if file.is_dir() or file.stem != "soiltest" else file.resolve().parent.name
    folder = out or Path(f"{name.removesuffix('.toml')}-result")
    found = soil_test_into(file, folder, seed=seed, overwrite=overwrite, quiet=quiet)
    print_soil_test(found, folder / "report.html")
    raise typer.Exit(0 if found.converged else 3)
