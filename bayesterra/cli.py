"""The command line. It only reads options and prints; the work is done by functions that Python can call.

Imports that take long stand inside the commands, so that help and version come at once.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated, Any

import typer

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Posterior distributions of the mechanical parameters of planetary soil, from wheel tests.",
    epilog="Start with [bold]bayesterra init study.toml[/bold]. Exit codes: 0 done, 2 bad input,"
    " 3 not converged, 130 interrupted.",
)

StudyPath = Annotated[
    Path, typer.Argument(metavar="STUDY", help="A study file, or a folder that holds study.toml.")
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


@app.command()
def run(
    study: StudyPath,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Result folder; by default <study folder>-result.")
    ] = None,
    seed: Seed = 1,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with a run that was interrupted or killed.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace a result folder, once the new one is complete.")
    ] = False,
    prior_only: Annotated[
        bool, typer.Option("--prior-only", help="Report on the prior alone; needs no readings.")
    ] = False,
    crosscheck: Annotated[
        bool,
        typer.Option("--crosscheck", help="Repeat it by nested sampling at two settings (needs dynesty)."),
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, only the result.")] = False,
) -> None:
    """Sample the posterior, compare with least squares, and write a report."""
    from bayesterra.study import load_study

    if resume and prior_only:
        raise typer.BadParameter("goes on with sampling, and --prior-only does none", param_hint="--resume")
    # mistakes in the study are reported before the sampler's libraries are loaded
    loaded = load_study(study, prior_only=prior_only)
    from bayesterra.console import print_prior, print_result
    from bayesterra.workflow import run_prior_study, run_study

    folder = out or beside(study, "result")
    if prior_only:
        prior = run_prior_study(loaded, out=folder, seed=seed, overwrite=overwrite)
        return print_prior(prior, folder / "report.html")
    how = {"overwrite": overwrite, "resume": resume, "quiet": quiet, "crosscheck": crosscheck}
    result = run_study(loaded, out=folder, seed=seed, **how)
    print_result(result, folder / "report.html")
    raise typer.Exit(0 if result.converged else 3)


@app.command()
def check(study: StudyPath) -> None:
    """Read a study and its measurements, and show what was understood."""
    from bayesterra.overview import print_overview
    from bayesterra.study import load_study

    print_overview(load_study(study))


@app.command()
def fit(
    study: StudyPath,
    method: Annotated[
        list[str] | None, typer.Option(help="IM1, IM2, IM3 or joint; may be repeated. By default all.")
    ] = None,
) -> None:
    """Identify the soil by least squares: IM1, IM2, IM3 and all channels jointly."""
    from bayesterra.identification import fit as fit_study
    from bayesterra.identification import print_fits
    from bayesterra.study import load_study

    loaded = load_study(study)
    fits = fit_study(loaded, method or None)
    print_fits(fits, loaded)
    raise typer.Exit(0 if all(one.converged for one in fits.values() if one.path) else 3)


@app.command()
def simulate(
    study: StudyPath,
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="New folder; by default <study folder>-simulated.")
    ] = None,
    seed: Seed = 1,
    set_: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help='A true value, e.g. phi="30 deg"; may be repeated.'),
    ] = None,
) -> None:
    """Make measurements with known parameters, under the conditions and noise of a study."""
    from bayesterra.overview import print_truth
    from bayesterra.simulation import write_simulated
    from bayesterra.study import load_study

    folder = out or beside(study, "simulated")
    given = dict(_assignment(text) for text in set_ or ())
    print_truth(write_simulated(load_study(study), folder, seed=seed, truth=given))
    typer.echo(f"Written: {folder}   (seed {seed})")


@app.command()
def init(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The study file to write, e.g. study.toml.")],
) -> None:
    """Write a commented template of a study file."""
    from bayesterra.template import write_template

    write_template(file)
    typer.echo(f"Written: {file}")
    typer.echo(f"Next: put the measurements into {file.parent / 'measurements.csv'}, fill in the rest,")
    typer.echo(f"and see whether it is understood: bayesterra check {file}")


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
    from bayesterra.workflow import load_result

    loaded = load_result(result)
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


@app.command()
def calibrate(
    study: StudyPath,
    number: Annotated[
        int,
        typer.Option("-n", "--number", metavar="N", help="Replications; 200 or more are worth their time."),
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="New folder; by default <study folder>-calibration.")
    ] = None,
    seed: Seed = 1,
    workers: Annotated[
        int | None, typer.Option(min=1, metavar="K", help="Worker processes; by default one per core.")
    ] = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with what an interrupted calibration left in DIR.part.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an older calibration of that name, and begin anew.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, only the verdict.")] = False,
) -> None:
    """Simulate a study many times over and check that its posterior is right."""
    from bayesterra.study import load_study

    loaded = load_study(study)
    from bayesterra.calibrating import Job, calibrate_study
    from bayesterra.listing import print_calibration

    folder = out or beside(study, "calibration")
    job = Job(loaded, number, seed, workers or os.cpu_count() or 1)
    found = calibrate_study(job, folder, resume=resume, overwrite=overwrite, quiet=quiet)
    print_calibration(found, folder / "report.html")
    raise typer.Exit(0 if found.calibrated else 3)


@app.command()
def identify(
    what: Annotated[
        Path, typer.Argument(metavar="STUDY|DIR", help="A study, which is sampled first, or a result folder.")
    ],
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="New folder; by default <name>-identifiability.")
    ] = None,
    seed: Seed = 1,
    prior_only: Annotated[
        bool, typer.Option("--prior-only", help="What the design could determine; needs no readings.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an older analysis of that name.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, only the verdicts.")] = False,
) -> None:
    """Say what these data determine, what is coupled, and what only repeats its prior."""
    from bayesterra.study import load_study

    if prior_only:
        if out is not None:
            raise typer.BadParameter("--prior-only prints and writes nothing", param_hint="--out")
        loaded = load_study(what, prior_only=True)
        from bayesterra.identifying import foresee
        from bayesterra.listing import print_foreseen

        return print_foreseen(foresee(loaded, seed=seed))
    from bayesterra.identifying import identify_into
    from bayesterra.listing import print_identified

    folder = out or Path(beside(what, "identifiability").name.replace("-result-", "-"))
    found = identify_into(what, folder, seed=seed, overwrite=overwrite, quiet=quiet)
    print_identified(found, folder / "report.html")
    raise typer.Exit(0 if found.record["converged"] else 3)


@app.command()
def design(
    known: Annotated[
        Path,
        typer.Argument(metavar="STUDY|DIR", help="A result folder, whose posterior is built on, or a study."),
    ],
    about: Annotated[
        list[str] | None,
        typer.Option(metavar="P,P", help="Parameters of interest, e.g. c,phi; by default all that are free."),
    ] = None,
    slip: Annotated[
        list[str] | None,
        typer.Option(metavar="S,S", help="Candidate slips; by default the driven range and some beyond."),
    ] = None,
    load: Annotated[
        list[str] | None,
        typer.Option(
            metavar="W", help='Candidate load, e.g. "80 N"; may be repeated. By default the study\'s.'
        ),
    ] = None,
    wheel: Wheels = None,
    channel: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=SD", help='A sensor to add, e.g. "resistance_moment=0.15 N m".'),
    ] = None,
    number: Annotated[
        int, typer.Option("-n", "--number", metavar="N", help="Drives to choose together.")
    ] = 1,
    by: Annotated[
        str, typer.Option(metavar="WHAT", help="information (about all of them together) or sd (of each).")
    ] = "information",
    out: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="New folder; by default <study folder>-design.")
    ] = None,
    seed: Seed = 1,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an older design of that name.")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", help="No progress, only the ranking.")] = False,
) -> None:
    """Rank the drives that could come next by what they are expected to tell."""
    from bayesterra.designing import design_into
    from bayesterra.followup import slips_of
    from bayesterra.listing import print_design

    names = [name.strip() for text in about or () for name in text.split(",") if name.strip()]
    folder = out or Path(f"{beside(known, 'design').name.replace('-result-', '-')}")
    asked: dict[str, Any] = {"about": names, "slips": slips_of(slip or ()), "loads": load or ()}
    asked |= {"wheels": wheel or (), "channels": channel or (), "number": number, "by": by, "seed": seed}
    found = design_into(known, folder, overwrite=overwrite, quiet=quiet, **asked)
    print_design(found, folder)


def beside(study: Path, what: str) -> Path:
    """Default folder for what is made from a study, in the working directory."""
    folder = study if study.is_dir() else study.parent
    return Path(f"{folder.resolve().name}-{what}")


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        message = f'must be NAME=VALUE, e.g. phi="30 deg" (got {text!r})'
        raise typer.BadParameter(message, param_hint="--set")
    return name.strip(), value.strip()
