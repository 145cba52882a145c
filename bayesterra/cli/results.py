"""Commands that go on from finished results: predict, compare."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from bayesterra.cli.common import Wheels, app

if TYPE_CHECKING:
    from bayesterra.results import Result


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
    rover: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A file of a four-wheeled rover, driven instead.")
    ] = None,
    slope: Annotated[
        list[str] | None,
        typer.Option(metavar="A,A", help="With --rover: slopes in degrees; by default 0,5,10,15."),
    ] = None,
    tow: Annotated[
        list[str] | None,
        typer.Option(metavar="T,T", help='With --rover: tow forces, e.g. "0 N,35 N"; by default none.'),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="New folder; by default <result>-prediction.")
    ] = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an older prediction of that name.")
    ] = False,
) -> None:
    """Predict sinkage, pull, torque and efficiency for new slips, loads and wheels, or drive a rover."""
    from bayesterra.workflow import load_single

    check_options(rover, {"--slip": slip, "--load": load, "--wheel": wheel}, {"--slope": slope, "--tow": tow})
    loaded = load_single(result)
    if rover is not None:
        _drive(loaded, rover, slope or (), tow or (), out or _default(result, "rover"), overwrite)
        return
    from bayesterra import followup
    from bayesterra.listing.forecasts import print_forecast

    cases = followup.forecast(
        loaded,
        slips=followup.slips_of(slip or ()),
        loads=load or (),
        wheels=wheel or (),
        slip_reference=slip_reference,
    )
    folder = out or _default(result, "prediction")
    followup.predict_into(folder, cases, overwrite=overwrite)
    print_forecast([at or curve for curve, at in cases], folder)


def _default(result: Path, what: str) -> Path:
    return Path(f"{result.resolve().name.removesuffix('-result')}-{what}")


def _drive(
    loaded: Result, rover: Path, slope: Sequence[str], tow: Sequence[str], folder: Path, overwrite: bool
) -> None:
    """Drive a rover and write what comes of it."""
    from bayesterra import roving
    from bayesterra.listing.rovers import print_outlook

    sheet = roving.predict_rover(loaded, rover, slopes=roving.slopes_of(slope), tows=roving.tows_of(tow))
    sheet.save(folder, overwrite=overwrite)
    print_outlook(sheet, folder)


def check_options(
    rover: Path | None, of_wheels: Mapping[str, object], of_rovers: Mapping[str, object]
) -> None:
    """Refuse options of wheels beside those of a rover."""
    from bayesterra.errors import StudyError

    wrong = [name for name, value in (of_wheels if rover else of_rovers).items() if value]
    if wrong and rover:
        raise StudyError(
            f"'{wrong[0]}' does not go with '--rover': a rover's loads and slips follow from its slope"
        )
    if wrong:
        raise StudyError(f"'{wrong[0]}' needs '--rover FILE'")


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
    from bayesterra.listing.comparisons import print_comparison

    comparison = compare_folders(results, out, load=load, wheel=wheel, overwrite=overwrite)
    print_comparison(comparison, out)
