"""Commands that go on from finished results: predict, compare."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayesterra.cli.common import Wheels, app


@app.command()
def predict(
    result: Annotated[Path, typer.Argument(metavar="DIR", help="A result folder that 'run' wrote.")],
    slip: Annotated[
        list[str] | None, typer.Option(metavar="S,S", help="Slips, e.g. 0.1,0.3; by default the driven ones.")
    ] = None,
    load: Annotated[
        list[str] | None,
        typer.Option(
            metavar="W", help='Vertical load, e.g. "80 N"; may be repeated. By default the study\'s.'
        ),
    ] = None,
    wheel: Wheels = None,
    slip_reference: Annotated[
        str, typer.Option(metavar="RADIUS", help="Radius behind the slips: rim, tip or shearing.")
    ] = "shearing",
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="New folder; by default <result>-prediction.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an older prediction of that name.")
    ] = False,
) -> None:
    """Predict sinkage, pull, torque and efficiency for new slips, loads and wheels."""
    from bayesterra.workflow import load_single

    loaded = load_single(result)
    from bayesterra import followup
    from bayesterra.listing import print_forecast

    cases = followup.forecast(
        loaded,
        slips=followup.slips_of(slip or ()),
        loads=load or (),
        wheels=wheel or (),
        slip_reference=slip_reference,
    )
    folder = out or Path(f"{result.resolve().name.removesuffix('-result')}-prediction")
    followup.predict_into(folder, cases, overwrite=overwrite)
    print_forecast([at or curve for curve, at in cases], folder)


@app.command()
def compare(
    results: Annotated[list[Path], typer.Argument(metavar="DIR DIR...", help="Two to six result folders.")],
    out: Annotated[
        Path, typer.Option(metavar="FOLDER", help="New folder for the page and its tables.")
    ] = Path("comparison"),
    load: Annotated[
        str | None, typer.Option(metavar="W", help="Load that all predict; by default the first result's.")
    ] = None,
    wheel: Annotated[
        str | None, typer.Option(metavar="NAME|FILE", help="Wheel that all drive; by default each its own.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an older comparison of that name.")
    ] = False,
) -> None:
    """Set results side by side: two models, two priors, two drives."""
    from bayesterra.followup import compare_folders
    from bayesterra.listing import print_comparison

    comparison = compare_folders(results, out, load=load, wheel=wheel, overwrite=overwrite)
    print_comparison(comparison, out)
