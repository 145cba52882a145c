"""Commands that examine a study: calibrate, identify, design, holdout."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from bayesterra.cli.common import Scheduler, Seed, StudyPath, Wheels, Workers, app, beside, hushed


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
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with what an interrupted calibration left in DIR.part.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an older calibration of that name, and begin anew.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", callback=hushed, help="No progress, only the verdict.")
    ] = False,
) -> None:
    """Simulate a study many times over and check that its posterior is right."""
    from bayesterra.study import load_study

    loaded = load_study(study)
    from bayesterra.calibrating import Job, calibrate_study
    from bayesterra.engines import chosen
    from bayesterra.listing.calibrations import print_calibration

    folder = out or beside(study, "calibration")
    with chosen(workers, scheduler) as engine:
        job = Job(loaded, number, seed, engine)
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
    workers: Workers = None,
    scheduler: Scheduler = None,
    prior_only: Annotated[
        bool, typer.Option("--prior-only", help="What the design could determine; needs no readings.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an older analysis of that name.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", callback=hushed, help="No progress, only the verdicts.")
    ] = False,
) -> None:
    """Say what these data determine, what is coupled, and what only repeats its prior."""
    from bayesterra.study import load_study

    if prior_only:
        if out is not None:
            raise typer.BadParameter("--prior-only prints and writes nothing", param_hint="--out")
        loaded = load_study(what, prior_only=True)
        from bayesterra.identifying import foresee
        from bayesterra.listing.verdicts import print_foreseen

        return print_foreseen(foresee(loaded, seed=seed))
    from bayesterra.engines import chosen
    from bayesterra.identifying import identify_into
    from bayesterra.listing.verdicts import print_identified
    from bayesterra.opening import opened

    folder = out or Path(beside(what, "identifiability").name.replace("-result-", "-"))
    with chosen(workers, scheduler) as engine:
        study_or_result = opened(what)
        found = identify_into(
            study_or_result, folder, seed=seed, engine=engine, overwrite=overwrite, quiet=quiet
        )
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
    workers: Workers = None,
    scheduler: Scheduler = None,
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with what an interrupted design left in FOLDER.part.")
    ] = False,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an older design of that name, and begin anew.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", callback=hushed, help="No progress, only the ranking.")
    ] = False,
) -> None:
    """Rank the drives that could come next by what they are expected to tell."""
    from bayesterra.designing import design_into
    from bayesterra.engines import chosen
    from bayesterra.followup import slips_of
    from bayesterra.listing.designs import print_design
    from bayesterra.opening import opened_for_design

    names = [name.strip() for text in about or () for name in text.split(",") if name.strip()]
    folder = out or Path(f"{beside(known, 'design').name.replace('-result-', '-')}")
    asked: dict[str, Any] = {"about": names, "slips": slips_of(slip or ()), "loads": load or ()}
    asked |= {"wheels": wheel or (), "channels": channel or (), "number": number, "by": by, "seed": seed}
    with chosen(workers, scheduler) as engine:
        found = design_into(
            opened_for_design(known),
            folder,
            engine=engine,
            resume=resume,
            overwrite=overwrite,
            quiet=quiet,
            **asked,
        )
    print_design(found, folder)


@app.command()
def holdout(
    what: Annotated[
        Path, typer.Argument(metavar="STUDY|DIR", help="A study, or a result folder with its study.")
    ],
    by: Annotated[
        str, typer.Option(metavar="WHAT", help="What is left out at a time: a level of slip, a wheel, a row.")
    ] = "slip",
    tolerance: Annotated[
        float, typer.Option(metavar="D", help="Slips nearer than this are one level.")
    ] = 0.03,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="New folder; by default <study folder>-holdout.")
    ] = None,
    seed: Seed = 1,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace an older check of that name.")
    ] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", callback=hushed, help="No progress, only the scores.")
    ] = False,
) -> None:
    """Predict rows that the fit has not seen, level by level, and score that beside regressions."""
    from bayesterra.engines import chosen
    from bayesterra.leaving import leave_out_into
    from bayesterra.listing.holdouts import print_holdout

    folder = out or Path(beside(what, "holdout").name.replace("-result-", "-"))
    asked: dict[str, Any] = {"by": by, "tolerance": tolerance, "seed": seed}
    with chosen(workers, scheduler) as engine:
        found = leave_out_into(what, folder, overwrite=overwrite, quiet=quiet, engine=engine, **asked)
    print_holdout(found, folder)
    raise typer.Exit(0 if found.converged else 3)
