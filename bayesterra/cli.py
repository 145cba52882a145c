"""The command line: options and printing only; the work is done in the rooms that each command imports.

Imports that take long stand inside the commands, so that help and version come at once.
"""

import logging
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from bayesterra.errors import printable

if TYPE_CHECKING:
    from bayesterra.study.result import AnalysisResult


app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,  # plain help comes twice as fast
    help="Posterior distributions of the mechanical parameters of planetary soil, from wheel tests.",
    epilog="Start with 'bayesterra init study.toml'. Exit codes: 0 done, 2 bad input,"
    " 3 not converged, 130 interrupted, 1 a bug.",
)


def option(metavar: str, text: str, *names: str) -> Any:
    """An option with a value, by the name of its parameter or by others."""
    return typer.Option(*names, metavar=metavar, help=text)


def argument(metavar: str, text: str) -> Any:
    """An argument that must be given."""
    return typer.Argument(metavar=metavar, help=text)


def flag(name: str, text: str) -> Any:
    """An option that is given or not."""
    return typer.Option(name, help=text)


def quieting(text: str) -> Any:
    """The option --quiet."""
    return typer.Option("--quiet", callback=hushed, help=text)


def hushed(context: typer.Context, quiet: bool) -> bool:
    """Value of --quiet, which keeps back the notes of the package, too, until the command has ended."""
    if quiet:
        notes = logging.getLogger("bayesterra")
        context.call_on_close(partial(notes.setLevel, notes.level))
        notes.setLevel(logging.ERROR)
    return quiet


StudyPath = Annotated[Path, argument("STUDY", "A study file, or a folder that holds study.toml.")]
Workers = Annotated[int | None, typer.Option(min=1, metavar="K", help="Worker processes; else one per processor.")]
Scheduler = Annotated[str | None, option("ADDRESS", "Dask scheduler, e.g. tcp://10.0.0.5:8786: its workers compute.")]
Seed = Annotated[int, typer.Option(min=0, metavar="N", help="Seed of the random numbers.")]

Texts = list[str] | None
Wheels = Annotated[Texts, option("NAME|FILE", "A wheel of the study, or a file of one; may be repeated.", "--wheel")]
Group = Annotated[str | None, option("NAME", "Group of a joint posterior; else the wheel's, or one not tested.")]
Resume = Annotated[bool, flag("--resume", "Go on with what was interrupted or killed.")]
Overwrite = Annotated[bool, flag("--overwrite", "Replace an older folder of that name, once all is done.")]
Quiet = Annotated[bool, quieting("No progress, only the result.")]


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"bayesterra {version('bayesterra')}")
        raise typer.Exit


@app.callback()
def _options(
    context: typer.Context,
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Show the version.")
    ] = False,
    allow_code: Annotated[bool, flag("--allow-code", "Run code that study files name; with every command.")] = False,
) -> None:
    """Options of all commands."""
    if allow_code:
        from bayesterra.study.own import allowing_code

        context.with_resource(allowing_code())


def show(result: "AnalysisResult", folder: Path | None, *, converged: bool = True) -> None:
    """Print a result in short, and where it is saved; exit code 3 where it has not converged."""
    from bayesterra.report import terminal

    terminal.show(result.overview(), *([result.place(folder)] if folder else []))
    if not converged:
        raise typer.Exit(3)


def beside(study: Path, what: str) -> Path:
    """Default folder for what is made from a study, in the working directory."""
    folder = study if study.is_dir() else study.parent
    return Path(f"{folder.resolve().name}-{what}")


@app.command(short_help="Sample the posterior and write a report.")
def run(
    study: StudyPath,
    out: Annotated[Path | None, option("DIR", "Result folder; by default <study folder>-result.")] = None,
    seed: Seed = 1,
    resume: Resume = False,
    overwrite: Overwrite = False,
    prior_only: Annotated[bool, flag("--prior-only", "Report on the prior; needs no readings.")] = False,
    crosscheck: Annotated[bool, flag("--crosscheck", "Repeat it by nested sampling twice (needs dynesty).")] = False,
    strict: Annotated[bool, flag("--strict", "Exit 4 where a verdict is bad: fit, prediction.")] = False,
    quiet: Quiet = False,
) -> None:
    """Sample the posterior, compare with least squares, and write a report."""
    from bayesterra.study.study import load_study

    if resume and prior_only:
        raise typer.BadParameter("goes on with sampling, and --prior-only does none", param_hint="--resume")
    # mistakes in the study are reported before the sampler's libraries are loaded
    loaded = load_study(study, prior_only=prior_only)
    from bayesterra.analysis.run import run_prior_study, run_study

    folder = out or beside(study, "result")
    if prior_only:
        show(run_prior_study(loaded, out=folder, seed=seed, overwrite=overwrite), folder)
        return
    how = {"overwrite": overwrite, "resume": resume, "quiet": quiet, "crosscheck": crosscheck}
    result = run_study(loaded, out=folder, seed=seed, **how)
    show(result, folder, converged=result.converged)
    if strict and any(verdict.grade == "bad" for verdict in result.verdicts):
        raise typer.Exit(4)


@app.command(short_help="Show what was understood of a study and its measurements.")
def check(study: StudyPath) -> None:
    """Read a study and its measurements, and show what was understood."""
    from bayesterra.likelihood.page import study_overview
    from bayesterra.report import terminal
    from bayesterra.study.study import load_study

    terminal.show(study_overview(load_study(study)))


@app.command(short_help="Identify the soil by least squares: IM1, IM2, IM3, joint.")
def fit(
    study: StudyPath,
    method: Annotated[Texts, typer.Option(help="IM1, IM2, IM3, joint; may be repeated; else all.")] = None,
    solvers: Annotated[Texts, option("NAME", "converged, lsqcurvefit (the paper's); may be repeated.")] = None,
) -> None:
    """Identify the soil by least squares: IM1, IM2, IM3 and all channels jointly; each group alone."""
    from bayesterra.least_squares.fit import fit as fit_study
    from bayesterra.least_squares.results import print_fits
    from bayesterra.study.study import load_study

    converged = True
    for group, alone in load_study(study).by_group().items():
        fits = fit_study(alone, method or None, solvers=",".join(solvers).split(",") if solvers else None)
        if group:
            typer.echo(printable(f"Group {group}, alone: least squares shares nothing"))
        print_fits(fits, alone)
        own = [fitted for fitted in fits.values() if fitted.solver == "converged"]  # an emulation ends as it ends
        converged &= all(fitted.converged for fitted in own if fitted.path)
    raise typer.Exit(0 if converged else 3)


@app.command(short_help="Make measurements with known parameters.")
def simulate(
    study: StudyPath,
    out: Annotated[Path | None, option("FOLDER", "New folder; by default <study folder>-simulated.")] = None,
    seed: Seed = 1,
    set_: Annotated[Texts, option("NAME=VALUE", 'A true value, e.g. phi="30 deg"; may be repeated.', "--set")] = None,
) -> None:
    """Make measurements with known parameters, under the conditions and noise of a study."""
    from bayesterra.analysis.simulation import truth_overview, write_simulated
    from bayesterra.report import terminal
    from bayesterra.study.study import load_study

    folder, truth = out or beside(study, "simulated"), {}
    for text in set_ or ():
        name, equals, value = text.partition("=")
        if not equals:
            raise typer.BadParameter(f'must be NAME=VALUE, e.g. phi="30 deg" (got {text!r})', param_hint="--set")
        truth[name.strip()] = value.strip()
    made = write_simulated(load_study(study), folder, seed=seed, truth=truth)
    terminal.show(truth_overview(made), f"Written: {folder} (seed {seed})")


@app.command()
def init(file: Annotated[Path, argument("FILE", "The study file to write, e.g. study.toml.")]) -> None:
    """Write a commented template of a study file."""
    from bayesterra.runtime.folders import write_new
    from bayesterra.runtime.reading import MEGABYTE, read_text

    write_new(file, read_text(Path(__file__).parent / "study" / "template.toml", MEGABYTE))
    typer.echo(printable(f"Written: {file}"))
    typer.echo(printable(f"Next: put the measurements into {file.parent / 'measurements.csv'}, fill in the"))
    typer.echo(printable(f"rest, and see whether it is understood: bayesterra check {file}"))
    typer.echo(
        "Leave the noise to be estimated, unless repeats tell it: stated too small, it makes intervals too narrow."
    )


@app.command(name="schema")
def print_schema() -> None:
    """Print the JSON schema of study files, by which editors complete and check keys."""
    from bayesterra.study.schema import json_schema

    typer.echo(json_schema())


@app.command(short_help="Predict forces for new slips, loads and wheels, or a rover.")
def predict(
    result: Annotated[Path, argument("DIR", "A result folder that 'run' wrote.")],
    slip: Annotated[Texts, option("S,S", "Slips, e.g. 0.1,0.3; by default the driven ones.")] = None,
    load: Annotated[Texts, option("W", 'Vertical load, e.g. "80 N"; may be repeated. By default the study\'s.')] = None,
    wheel: Wheels = None,
    group: Group = None,
    slip_reference: Annotated[str, option("RADIUS", "Radius behind the slips: rim, tip or shearing.")] = "shearing",
    rover: Annotated[Path | None, option("FILE", "A file of a four-wheeled rover, driven instead.")] = None,
    slope: Annotated[Texts, option("A,A", "With --rover: slopes in degrees; by default 0,5,10,15.")] = None,
    tow: Annotated[Texts, option("T,T", 'With --rover: tow forces, e.g. "0 N,35 N"; else none.')] = None,
    probability: Annotated[
        Texts, option("WHAT", 'Its probability, e.g. "drawbar_pull > 20 N", "slope > 15 deg"; may be repeated.')
    ] = None,
    out: Annotated[Path | None, option("FOLDER", "New folder; by default <result>-prediction.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Predict sinkage, pull, torque and efficiency for new slips, loads and wheels, or drive a rover."""
    from bayesterra.analysis.run import load_result
    from bayesterra.errors import StudyError
    from bayesterra.prediction import outlook, prediction

    of_wheels, of_rovers = {"--slip": slip, "--load": load, "--wheel": wheel}, {"--slope": slope, "--tow": tow}
    for name in (name for name, value in (of_wheels if rover else of_rovers).items() if value):
        if rover:
            raise StudyError(f"'{name}' does not go with '--rover': a rover's loads and slips follow from its slope")
        raise StudyError(f"'{name}' needs '--rover FILE'")
    loaded = load_result(result)
    asked: dict[str, Any] = {"group": group, "probabilities": probability or ()}
    if rover is None:
        asked |= {"slips": prediction.slips_of(slip or ()), "loads": load or (), "wheels": wheel or ()}
        made: AnalysisResult = prediction.forecast(loaded, slip_reference=slip_reference, **asked)
    else:
        asked |= {"slopes": outlook.slopes_of(slope or ()), "tows": outlook.tows_of(tow or ())}
        made = outlook.predict_rover(loaded, rover, **asked)
    what = "prediction" if rover is None else "rover"
    folder = out or Path(f"{result.resolve().name.removesuffix('-result')}-{what}")
    made.save(folder, overwrite=overwrite)
    show(made, folder)


@app.command()
def compare(
    results: Annotated[list[Path], argument("DIR DIR...", "Two to six result folders.")],
    out: Annotated[Path, option("FOLDER", "New folder for the page and its tables.")] = Path("comparison"),
    load: Annotated[str | None, option("W", "Load that all predict; by default the first result's.")] = None,
    wheel: Annotated[str | None, option("NAME|FILE", "Wheel that all drive; else each its own.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Set results side by side: two models, two priors, two tables."""
    from bayesterra.analysis.comparison import compare_folders

    show(compare_folders(results, out, load=load, wheel=wheel, overwrite=overwrite), out)


@app.command(short_help="Write a result's figures, tables, methods and references for a manuscript.")
def export(
    result: Annotated[Path, argument("DIR", "A result folder that 'run' wrote.")],
    figures: Annotated[Texts, option("F,F", "svg, pdf, png; with no option at all: svg.")] = None,
    tables: Annotated[Texts, option("F,F", "latex, csv; with no option at all: csv.")] = None,
    methods: Annotated[bool, flag("--methods", "What was done, in words: methods.txt.")] = False,
    bibtex: Annotated[bool, flag("--bibtex", "What these words cite: references.bib.")] = False,
    to: Annotated[Texts, option("F,F", "Draws as csv or json, SI and radians; soils for chrono-scm.")] = None,
    slip: Annotated[Texts, option("S,S", "Slips where chrono-scm takes the exponent; else three driven.")] = None,
    out: Annotated[Path | None, option("FOLDER", "New folder; by default <result>-export.")] = None,
    overwrite: Overwrite = False,
) -> None:
    """Write the report's figures and tables as files, a text on methods, references, and the draws."""
    from bayesterra.analysis.export import Export
    from bayesterra.analysis.run import load_result
    from bayesterra.prediction.prediction import slips_of

    texts = {"figures": figures, "tables": tables, "to": to}
    asked = {name: ",".join(text).split(",") if text else [] for name, text in texts.items()}
    if not (any(asked.values()) or methods or bibtex):
        asked, methods, bibtex = {"figures": ["svg"], "tables": ["csv"], "to": []}, True, True
    folder = out or Path(f"{result.resolve().name.removesuffix('-result')}-export")
    slips = tuple(slips_of(slip or ()))
    made = Export(result=load_result(result), asked=asked, methods=methods, bibtex=bibtex, slips=slips)
    made.save(folder, overwrite=overwrite)
    show(made, folder)


@app.command(short_help="Check the posteriors of a study against simulated truths.")
def calibrate(
    study: StudyPath,
    number: Annotated[int, option("N", "Replications; 200 or more are worth their time.", "-n", "--number")],
    out: Annotated[Path | None, option("DIR", "New folder; by default <study folder>-calibration.")] = None,
    seed: Seed = 1,
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a study many times over and check that its posterior is right."""
    from bayesterra.study.study import load_study

    loaded = load_study(study)
    from bayesterra.checking.calibration import CalibrationRequest, calibrate_study
    from bayesterra.runtime.engines import chosen

    folder = out or beside(study, "calibration")
    with chosen(workers, scheduler) as engine:
        job = CalibrationRequest(loaded, number, seed, engine)
        calibration = calibrate_study(job, folder, resume=resume, overwrite=overwrite, quiet=quiet)
    show(calibration, folder, converged=calibration.calibrated)


@app.command(short_help="Say what data determine, and what only repeats its prior.")
def identify(
    what: Annotated[Path, argument("STUDY|DIR", "A study, which is sampled first, or a result folder.")],
    out: Annotated[Path | None, option("DIR", "New folder; by default <name>-identifiability.")] = None,
    seed: Seed = 1,
    workers: Workers = None,
    scheduler: Scheduler = None,
    prior_only: Annotated[bool, flag("--prior-only", "What the design could determine; no readings.")] = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Say what these data determine, what is coupled, and what only repeats its prior."""
    from bayesterra.study.study import load_study

    if prior_only:
        if out is not None:
            raise typer.BadParameter("--prior-only prints and writes nothing", param_hint="--out")
        loaded = load_study(what, prior_only=True)
        from bayesterra.identifiability.analysis import foresee
        from bayesterra.identifiability.page import foreseen_overview
        from bayesterra.report import terminal

        terminal.show(foreseen_overview(foresee(loaded, seed=seed)))
        return
    from bayesterra.analysis.run import opened
    from bayesterra.identifiability.analysis import identify_into
    from bayesterra.runtime.engines import chosen

    folder = out or Path(beside(what, "identifiability").name.replace("-result-", "-"))
    with chosen(workers, scheduler) as engine:
        how: dict[str, Any] = {"seed": seed, "engine": engine, "overwrite": overwrite, "quiet": quiet}
        identifiability = identify_into(opened(what), folder, **how)
    show(identifiability, folder, converged=identifiability.record["converged"])


@app.command(short_help="Rank rows that could come next by what they would tell.")
def design(
    study_or_result: Annotated[Path, argument("STUDY|DIR", "A result, whose posterior is built on, or a study.")],
    about: Annotated[Texts, option("P,P", "Parameters of interest, e.g. c,phi; by default all free.")] = None,
    slip: Annotated[Texts, option("S,S", "Candidate slips; by default the driven range and beyond.")] = None,
    load: Annotated[Texts, option("W", 'Candidate load, e.g. "80 N"; may be repeated; else the study\'s.')] = None,
    wheel: Wheels = None,
    channel: Annotated[Texts, option("NAME=SD", 'A sensor to add: "resistance_moment=0.15 N m".')] = None,
    number: Annotated[int, option("N", "Rows to choose together.", "-n", "--number")] = 1,
    by: Annotated[str, option("WHAT", "information (all of them together) or sd (of each).")] = "information",
    group: Group = None,
    out: Annotated[Path | None, option("FOLDER", "New folder; by default <study folder>-design.")] = None,
    seed: Seed = 1,
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Resume = False,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Rank the rows that could come next by what they are expected to tell."""
    from bayesterra.analysis.run import opened_for_design
    from bayesterra.design.recommendation import design_into
    from bayesterra.prediction.prediction import slips_of
    from bayesterra.runtime.engines import chosen

    names = [name.strip() for text in about or () for name in text.split(",") if name.strip()]
    folder = out or Path(beside(study_or_result, "design").name.replace("-result-", "-"))
    asked: dict[str, Any] = {"about": names, "slips": slips_of(slip or ()), "loads": load or (), "group": group}
    asked |= {"wheels": wheel or (), "channels": channel or (), "number": number, "by": by, "seed": seed}
    asked |= {"resume": resume, "overwrite": overwrite, "quiet": quiet}
    with chosen(workers, scheduler) as engine:
        recommendation = design_into(opened_for_design(study_or_result), folder, engine=engine, **asked)
    show(recommendation, folder)


@app.command(short_help="Predict rows that the fit has not seen, level by level.")
def holdout(
    what: Annotated[Path, argument("STUDY|DIR", "A study, or a result folder with its study.")],
    by: Annotated[str, option("WHAT", "What is left out at a time: slip, wheel or row.")] = "slip",
    tolerance: Annotated[float, option("D", "Slips nearer than this are one level, to four times its width.")] = 0.03,
    out: Annotated[Path | None, option("DIR", "New folder; by default <study folder>-holdout.")] = None,
    seed: Seed = 1,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Predict rows that the fit has not seen, level by level, and score that beside regressions."""
    from bayesterra.checking.holdout import leave_out_into
    from bayesterra.runtime.engines import chosen

    folder = out or Path(beside(what, "holdout").name.replace("-result-", "-"))
    asked: dict[str, Any] = {"by": by, "tolerance": tolerance, "seed": seed}
    with chosen(workers, scheduler) as engine:
        scores = leave_out_into(what, folder, overwrite=overwrite, quiet=quiet, engine=engine, **asked)
    show(scores, folder, converged=scores.converged)


@app.command(short_help="Posterior of plate or shear tests beside least squares.")
def soiltest(
    file: Annotated[Path, argument("FILE", "A soil-test file, or a folder that holds soiltest.toml.")],
    out: Annotated[Path | None, option("DIR", "New folder; by default <name>-result.")] = None,
    seed: Seed = 1,
    overwrite: Overwrite = False,
    quiet: Quiet = False,
) -> None:
    """Plate sinkage or annular shear tests: their posterior beside least squares, and a report."""
    from bayesterra.analysis.run import run_study
    from bayesterra.study.study import load_soil_test

    name = file.resolve().name if file.is_dir() or file.stem != "soiltest" else file.resolve().parent.name
    folder = out or Path(f"{name.removesuffix('.toml')}-result")
    result = run_study(load_soil_test(file), out=folder, seed=seed, overwrite=overwrite, quiet=quiet)
    show(result, folder, converged=result.converged)


@app.command(short_help="Reduce raw logs of wheel or plate tests to rows.")
def reduce(
    logs: Annotated[list[Path], argument("LOG...", "CSV, Excel, Parquet, MATLAB (.mat) or ROS bag.")],
    out: Annotated[Path, option("FILE", "New table; its page stands beside it.")] = Path("measurements.csv"),
    zero: Annotated[Path | None, option("LOG", "Record of the unloaded sensors: its means are subtracted.")] = None,
    radius: Annotated[str | None, option("R", 'Radius behind the rim\'s speed, e.g. "58 mm".')] = None,
    lugs: Annotated[int, typer.Option(min=0, metavar="N", help="Lugs of the wheel, for the ripple's period.")] = 0,
    plate: Annotated[str | None, option("D", 'Diameter of a plate, e.g. "100 mm": logs are plate tests.')] = None,
    steady: Annotated[float, option("SHARE", "Drift within a window that is taken for steady.")] = 0.02,
    kind: Annotated[str, option("WORD", "measured, digitised or simulated.")] = "measured",
    sheet: Annotated[str, option("NAME", "Sheet of an Excel workbook.")] = "",
    decimal: Annotated[str | None, option("MARK", "What separates decimals, where asked for: , or .")] = None,
) -> None:
    """Reduce logs: steady windows of wheel tests to rows with standard errors, plate tests to their loading branch."""
    from bayesterra.reduce.reduction import reduce_logs

    asked: dict[str, Any] = {"radius": radius, "lugs": lugs, "plate": plate, "steady": steady}
    reduction = reduce_logs(logs, zero=zero, kind=kind, sheet=sheet, decimal=decimal, **asked)
    reduction.save(out)
    show(reduction, out)


@app.command(short_help="Update a posterior row by row; say when the soil changes.")
def follow(
    what: Annotated[Path, argument("STUDY|DIR", "A study, without its readings, a result to go on from, or a stream.")],
    data: Annotated[Path, option("FILE", "CSV of rows, read one by one; - is standard input.")],
    out: Annotated[Path | None, option("DIR", "New folder for tables, figure and state; else none.")] = None,
    seed: Seed = 1,
    particles: Annotated[int | None, option("N", "Parameter sets that stand for the posterior.")] = None,
    false_alarms: Annotated[float | None, option("P", "False alarms per row at most, on average; else 0.0001.")] = None,
    restart: Annotated[bool, flag("--restart", "After an alarm begin anew where the soil changed.")] = False,
    slip_reference: Annotated[str | None, option("RADIUS", "As in a study; else its own, or shearing.")] = None,
    sinkage_reference: Annotated[str | None, option("PART", "Zero of sinkages; else the study's, or rim.")] = None,
    overwrite: Overwrite = False,
    quiet: Annotated[bool, quieting("No line per row, only alarms and the end.")] = False,
) -> None:
    """Update a posterior row by row as a rover drives, and say when the soil has changed."""
    from bayesterra.analysis.run import opened_for_stream
    from bayesterra.follow import session
    from bayesterra.follow.page import print_row

    stream = session.follow(
        opened_for_stream(what), sys.stdin if str(data) == "-" else data, out=out, restart=restart,
        overwrite=overwrite, show=lambda seen: print_row(seen, quiet=quiet), seed=seed, particles=particles,
        false_alarms=false_alarms, slip_reference=slip_reference, sinkage_reference=sinkage_reference,
    )  # fmt: skip
    show(stream, out)


@app.command(short_help="Open a page in the browser that does the main job.")
def ui(
    folder: Annotated[Path, typer.Argument(metavar="[FOLDER]", help="Where studies and results are, and go.")] = Path(),
    port: Annotated[int, typer.Option(min=0, max=65535, metavar="N", help="Port; by default a free one.")] = 0,
    host: Annotated[str, option("ADDRESS", "Listen there, which lets other machines in.")] = "127.0.0.1",
    no_browser: Annotated[bool, flag("--no-browser", "Only print the address.")] = False,
) -> None:
    """Open a page in the browser, of this machine alone: studies from tables, runs, reports, what if."""
    try:
        from bayesterra.ui.server import serve
    except ImportError as error:
        from bayesterra.errors import StudyError

        raise StudyError(f"'ui' needs {error.name}: pip install 'bayesterra[ui]'") from error
    serve(folder, port=port, host=host, browser=not no_browser)
