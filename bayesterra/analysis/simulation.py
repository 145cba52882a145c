"""Data made by the model itself: the same wheels, slips and loads as a study, outcomes with its noise."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.random import Generator

from bayesterra.arrays import FloatArray
from bayesterra.errors import ResultError, SupportError, check_kind, check_seed
from bayesterra.likelihood.posterior import REASONS, draw_cut_prior, likelihood_of, posterior
from bayesterra.parameters import CHANNELS, OUTCOMES, PARAMETERS, in_order, whole_and_part
from bayesterra.report.blocks import Overview, Table
from bayesterra.runtime.folders import whole_folder, write_text
from bayesterra.runtime.tables import csv_text
from bayesterra.stats.laws import draw_population
from bayesterra.study.canonical import simulated_toml, write_readings
from bayesterra.study.entries import parameter_value
from bayesterra.study.groups import values_of_group
from bayesterra.study.observations import Observations
from bayesterra.study.study import Study, without_wheels

_PRIOR_DRAWS = 2000


@dataclass(frozen=True)
class Truth:
    """True values that simulated data are made with.

    Attributes
    ----------
    values : SI values of every parameter that has a prior, by name.
    origins : where each value comes from: ``given``, ``truth``, ``published``, ``fixed``, ``prior median`` or
        ``tied to <another>``.
    """

    values: Mapping[str, float]
    origins: Mapping[str, str]


def true_values(study: Study, assigned: Mapping[str, float | str] | None = None, seed: int = 1) -> Truth:
    """Choose a value for every parameter, of every group for what is a group's own.

    The first of these that has one: ``assigned``; the study's [truth]; the population, where these have its
    mean and spread; the prior, where it fixes the parameter; [published], where there is no [truth]; the
    median of the prior cut to the physical support. A group's own value, ``K[Wh11]``, goes before that of
    all, ``K``.

    Parameters
    ----------
    assigned : values by parameter, SI numbers or text with a unit.
    seed : of values drawn from populations.
    """
    names = tuple(in_order(study.prior.entries))
    groups, own = groups_of(study), list[str]()
    if study.pooling is not None:
        own = study.pooling.own_names(dict.fromkeys(groups))
    chosen = {n: parameter_value(n, v, (*names, *own), bare=True) for n, v in (assigned or {}).items()}
    stated = {**(study.truth.values if study.truth else {}), **chosen}
    sources = {"given": chosen, "truth": dict(study.truth.values) if study.truth else {}}
    sources["population"] = _from_populations(study, stated, own, seed)
    sources["fixed"] = study.prior.fixed
    sources["published"] = dict(study.published.values) if study.published and not study.truth else {}
    several = {whole_and_part(name)[0] for name in own}
    tied = [n for n in names if n in study.prior.ties]
    wanted = [n for n in names if n not in tied and n not in several]
    wanted += [name for name in own if name.endswith("]")]

    def source(name: str) -> tuple[str, float] | None:
        found = ((o, v.get(name, v.get(whole_and_part(name)[0]))) for o, v in sources.items())
        return next(((origin, value) for origin, value in found if value is not None), None)

    if not all(map(source, wanted)):
        density = posterior(study)
        middles = np.median(draw_cut_prior(density, _PRIOR_DRAWS, np.random.default_rng(0)).x, axis=0)
        sources["prior median"] = dict(zip(density.names, middles.tolist(), strict=True))
    told = {name: both for name in wanted if (both := source(name))}
    origins = {name: origin for name, (origin, _) in told.items()}
    values = {name: value for name, (_, value) in told.items()}
    for n in (n for n in tied if study.prior.root(n) not in several):
        values[n], origins[n] = values[study.prior.root(n)], f"tied to {study.prior.ties[n]}"
    for n in (n for n in own if n in stated and not n.endswith("]")):
        values[n], origins[n] = stated[n], "given" if n in chosen else "truth"
    return Truth(values, origins)


def truth_overview(truth: Truth) -> Overview:
    """Values that readings were simulated with, and where each comes from."""
    rows = ((name, PARAMETERS[name].field_text(value), truth.origins[name]) for name, value in truth.values.items())
    return (Table("Simulated with", "lll", ("parameter", "value", "from"), tuple(rows)),)


def groups_of(study: Study) -> tuple[str, ...]:
    """Group of every row of the table; of all the same, without a name, where there are none."""
    if study.pooling is None:
        return ("",) * len(study.observations)
    return study.observations.label(study.pooling.by)


def _from_populations(study: Study, stated: Mapping[str, float], own: Sequence[str], seed: int) -> dict[str, float]:
    """Values of groups from populations whose mean and spread are stated."""
    rng, drawn = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(1,))), {}
    for name in own:
        base = whole_and_part(name)[0]
        ends = [np.array([stated[part]]) for part in (f"{base}.mean", f"{base}.spread") if part in stated]
        if name.endswith("]") and len(ends) == 2:
            drawn[name] = float(draw_population(ends[0], ends[1], study.prior.laws[base].range, rng)[0])
    return drawn


def simulate(study: Study, truth: Mapping[str, float | str] | None = None, seed: int = 1) -> pd.DataFrame:
    """Make readings where the study has some, at its slips, loads and wheels.

    Parameters
    ----------
    study : conditions, noise and model. With the drive ``sinkage`` the sinkage is kept as it stands; with
        ``both`` the true load is the stated one, else the measured normal force.
    truth : parameter values as for :func:`true_values`.
    seed : same seed, same readings.

    Returns
    -------
    A table in the form of the measurement files; slip on the shearing radius, sinkage from the rim.

    Raises
    ------
    StudyError : no study is given, or an unknown parameter.
    SupportError : the model has no answer at one of the rows.
    """
    check_kind("bt.simulate", study, Study)
    without_wheels(study, "bt.simulate")
    check_seed(seed)
    values, rng = true_values(study, truth, seed).values, np.random.default_rng(seed)
    rows, groups = study.observations, np.array(groups_of(study), dtype=object)
    made = {name: np.full(len(rows), np.nan) for name in study.noise}
    for group in dict.fromkeys(groups):
        drawn = _drawn(study, rows.take(groups == group), values_of_group(values, group), rng)
        for i, name in enumerate(study.noise):
            made[name][groups == group] = drawn[:, i]
    return _table(study, {n: np.where(np.isnan(rows.values[n]), np.nan, v) for n, v in made.items()})


def simulated_tests(study: Study, values: Mapping[str, float], seed: int) -> Study:
    """The study with soil tests that these values (SI) make, at its sinkages and displacements."""
    target, rng = posterior(study), np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(2,)))
    x = np.array([[values[name] for name in target.names]])
    return study.with_stresses({each.test.name: each.draw(x, rng)[0] for each in target.experiments})


def _drawn(study: Study, rows: Observations, values: Mapping[str, float], rng: Generator) -> FloatArray:
    """Readings (m, channels) of some rows."""
    likelihood, soil = likelihood_of(study, rows), study.prior.soil_of(values)
    outcomes = likelihood.forward(soil)
    if outcomes.status[0]:
        raise SupportError(f"nothing can be simulated with these values: {REASONS[int(outcomes.status[0])]}")
    estimated = [n.parameter for n in study.noise.values() if n.parameter]
    noise = np.array([[values[name] for name in (*estimated, *study.errors.laws)]])
    if study.errors:
        outcomes = likelihood.imagined(soil, noise, rng)
    return np.asarray(likelihood.draw(outcomes, noise, rng)[0])


def _table(study: Study, made: Mapping[str, FloatArray]) -> pd.DataFrame:
    """Field units; what was simulated beside what was conditioned on."""
    rows = study.observations
    columns: dict[str, object] = {"wheel": rows.wheel} if len(study.wheels) > 1 else {}
    columns |= rows.labels
    columns["slip"] = rows.slip
    for name, values in study.drive.conditioned(rows).items():
        columns |= _column(name, values)
    made_rows = replace(rows, values={**rows.values, **made})
    for name in (name for name in OUTCOMES if name in made):
        columns[f"{name} [{CHANNELS[name].unit}]"] = made_rows.cells(name, CHANNELS[name].scale)
        if not np.isnan(rows.given_sd[name]).all():
            columns |= _column(f"{name}_sd", rows.given_sd[name])
    return pd.DataFrame({**columns, "use": rows.use.astype(int)})


def _column(name: str, values: FloatArray) -> dict[str, FloatArray]:
    channel = CHANNELS[name.removesuffix("_sd")]
    return {f"{name} [{channel.unit}]": values / channel.scale}


def write_simulated(
    study: Study, folder: str | Path, *, seed: int = 1, truth: Mapping[str, float | str] | None = None
) -> Truth:
    """Write a study folder with simulated measurements, whole or not at all.

    Parameters
    ----------
    folder : must not exist yet; gets ``study.toml``, with the truth in it, ``measurements.csv`` and soil tests.
    seed, truth : see :func:`simulate`.

    Raises
    ------
    ResultError : the folder exists or cannot be written.
    """
    folder = Path(folder)
    if folder.exists():
        raise ResultError(f"'{folder}' exists already: give another folder with --out")
    made_with = true_values(study, truth, seed)
    table = simulate(study, made_with.values, seed) if study.wheels else None
    study = simulated_tests(study, made_with.values, seed) if study.soil_tests else study
    text = simulated_toml(study, truth=made_with.values, source=f"simulated with seed {seed}")
    with whole_folder(folder, sums=False) as part:  # a study to work on
        if table is not None:
            write_text(part / "measurements.csv", csv_text(table, "%.12g"))
        write_readings(study, part)
        write_text(part / "study.toml", text)
    return made_with
