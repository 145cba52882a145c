"""The command for rows that come in one by one: follow."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from bayesterra.cli.common import Seed, app, hushed


@app.command()
def follow(
    what: Annotated[
        Path,
        typer.Argument(
            metavar="STUDY|DIR",
            help="A study (its own measurements are not used), a result folder to go on from, or a stream.",
        ),
    ],
    data: Annotated[
        Path, typer.Option(metavar="FILE", help="CSV of rows, read one by one; - is standard input.")
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="New folder for tables, figure and state; else none.")
    ] = None,
    seed: Seed = 1,
    particles: Annotated[
        int | None, typer.Option(metavar="N", help="Parameter sets that stand for the posterior.")
    ] = None,
    false_alarms: Annotated[
        float | None,
        typer.Option(
            metavar="P",
            help="False alarms of a changed soil per row, at most, averaged over the prior; default 0.0001.",
        ),
    ] = None,
    restart: Annotated[
        bool, typer.Option("--restart", help="After an alarm begin anew where the soil changed.")
    ] = False,
    slip_reference: Annotated[
        str | None,
        typer.Option(
            metavar="RADIUS", help="Radius behind the slips: rim, tip or shearing; else the study's."
        ),
    ] = None,
    sinkage_reference: Annotated[
        str | None, typer.Option(metavar="PART", help="Zero of the sinkages: rim or tip; else the study's.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an older stream of that name.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", callback=hushed, help="No line per row, only alarms and the end.")
    ] = False,
) -> None:
    """Update a posterior row by row as a rover drives, and say when the soil has changed."""
    from bayesterra import following
    from bayesterra.opening import opened_for_stream
    from bayesterra.ticker import print_end, print_row

    found = following.follow(
        opened_for_stream(what),
        sys.stdin if str(data) == "-" else data,
        out=out,
        restart=restart,
        overwrite=overwrite,
        show=lambda seen: print_row(seen, quiet=quiet),
        seed=seed,
        particles=particles,
        false_alarms=false_alarms,
        slip_reference=slip_reference,
        sinkage_reference=sinkage_reference,
    )
    print_end(found, out)
