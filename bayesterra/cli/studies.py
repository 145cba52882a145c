"""Commands that begin with a study file: run, check, fit, simulate, init."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from bayesterra.cli.common import Seed, StudyPath, app, beside, hushed
from bayesterra.errors import printable


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
    quiet: Annotated[
        bool, typer.Option("--quiet", callback=hushed, help="No progress, only the result.")
    ] = False,
) -> None:
    """Sample the posterior, compare with least squares, and write a report."""
    from bayesterra.study import load_study

    if resume and prior_only:
        raise typer.BadParameter("goes on with sampling, and --prior-only does none", param_hint="--resume")
    # mistakes in the study are reported before the sampler's libraries are loaded
    loaded = load_study(study, prior_only=prior_only)
    from bayesterra.console import print_pooled, print_prior, print_result
    from bayesterra.workflow import run_prior_study, run_study

    folder = out or beside(study, "result")
    if prior_only:
        prior = run_prior_study(loaded, out=folder, seed=seed, overwrite=overwrite)
        return print_prior(prior, folder / "report.html")
    how = {"overwrite": overwrite, "resume": resume, "quiet": quiet, "crosscheck": crosscheck}
    result = run_study(loaded, out=folder, seed=seed, **how)
    if loaded.pooling is not None:
        print_pooled(result.record, folder / "report.html")
    else:
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
    typer.echo(printable(f"Written: {folder} (seed {seed})"))


@app.command()
def init(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="The study file to write, e.g. study.toml.")],
) -> None:
    """Write a commented template of a study file."""
    from bayesterra.template import write_template

    write_template(file)
    typer.echo(printable(f"Written: {file}"))
    typer.echo(printable(f"Next: put the measurements into {file.parent / 'measurements.csv'}, fill in the"))
    typer.echo(printable(f"rest, and see whether it is understood: bayesterra check {file}"))


def _assignment(text: str) -> tuple[str, str]:
    name, equals, value = text.partition("=")
    if not equals:
        message = f'must be NAME=VALUE, e.g. phi="30 deg" (got {text!r})'
        raise typer.BadParameter(message, param_hint="--set")
    return name.strip(), value.strip()
