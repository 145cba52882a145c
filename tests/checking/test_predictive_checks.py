"""Predictive checks: quiet on data of the model, loud on planted misfits, and honest about the prior."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from numpy.random import Generator, SeedSequence, default_rng
from scipy.stats import kstest

from bayesterra.analysis.simulation import simulate
from bayesterra.arrays import FloatArray
from bayesterra.checking import predictive_checks as predictive_checks_module
from bayesterra.checking.predictive import ReplicateOptions, predict_rows
from bayesterra.checking.predictive_checks import ALARM, DOUBT, PredictiveChecks, predictive_checks, prior_checks
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.sampling.adaptation import AdaptationOptions, adapt
from bayesterra.sampling.coordinates import coordinates
from bayesterra.sampling.sampler import Target
from bayesterra.stats.laws import Law
from bayesterra.stats.mixture import normalised, systematic
from bayesterra.study.noise import Noise
from bayesterra.study.study import Study
from tests.support.choice import some
from tests.support.two_wheels import FREE, made

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]

QUICK = ReplicateOptions(number=100, pool=2048, draws=100)
LOADS = (40.0, 80.0, 120.0)


def weighted_draws(density: Posterior, rng: Generator, n: int = 1000) -> FloatArray:
    """Posterior draws (n, d) by importance from the prior; for few free parameters."""
    x = draw_cut_prior(density, 20_000, rng).x
    return x[systematic(normalised(density.log_terms(x).sum(axis=(1, 2))), n, rng)]


def tempered_draws(density: Posterior, rng: Generator, n: int = 2000) -> FloatArray:
    """Posterior draws (n, d) by one tempered run from the prior; for many free parameters."""
    target = Target(density, coordinates(density))
    plan = AdaptationOptions(particles=512, components=8, refinements=(4, 4), climbs=10)
    start = target.coordinates.from_physical(draw_cut_prior(density, plan.particles, rng).x)
    mixture = adapt(target.densities, start, plan, rng).proposal
    u = mixture.sample(2 * n, rng)
    weights = normalised(target.log_density(u) - mixture.log_density(u))
    return target.coordinates.to_physical(u[systematic(weights, n, rng)])[0]


@pytest.fixture(scope="module")
def two(make_study: MakeStudy) -> Study:
    """Free c and φ, with priors that are narrow enough for true values to be drawn from them."""
    priors = {"c": Law("uniform", lower=0.0, upper=1000.0), "phi": Law("norm", {"loc": 0.5, "scale": 0.05})}
    return make_study(free=("c", "phi"), priors=priors)


@pytest.mark.slow
def test_the_overall_p_is_that_of_one_test(two: Study) -> None:
    """On tables of the model, true values drawn from the prior, the overall p is uniform or a little high."""
    overall = []
    for seed in range(25):
        rng = default_rng([1, seed])
        c, phi = draw_cut_prior(posterior(two), 1, rng).x[0]
        made = simulate(two, {"c": float(c), "phi": float(phi)}, seed=seed)
        values = {
            "sinkage": made["sinkage [mm]"].to_numpy() * 1e-3,
            "drawbar_pull": made["drawbar_pull [N]"].to_numpy(),
            "resistance_moment": made["resistance_moment [N m]"].to_numpy(),
        }
        density = posterior(two.with_data(values))
        found = predictive_checks(density, weighted_draws(density, rng), SeedSequence([1, seed]), QUICK)
        overall.append(found.overall)
    assert np.sum(np.array(overall) < DOUBT) <= 2
    assert kstest(overall, "uniform", alternative="greater").pvalue > 0.01
    assert np.median(overall) < 0.8


@pytest.fixture(scope="module")
def campaign(make_table: MakeTable) -> Callable[[int], pd.DataFrame]:
    """Readings of the wheel under three loads at six slips, with noise."""

    def made(seed: int) -> pd.DataFrame:
        tables = [make_table("M2", slips=(0.02, 0.1, 0.2, 0.3, 0.45, 0.6), load=load) for load in LOADS]
        table, rng = pd.concat(tables, ignore_index=True), default_rng(seed)
        for name, sd in (("sinkage [m]", 1e-3), ("drawbar_pull [N]", 1.0), ("resistance_moment [N m]", 0.2)):
            table[name] += sd * rng.standard_normal(len(table))
        return table

    return made


NOISE = {"drawbar_pull": 1.0, "resistance_moment": 0.2}


def checked(study: Study, seed: int) -> PredictiveChecks:
    """Check a study whose eight parameters are free."""
    density = posterior(study)
    options = ReplicateOptions(number=100, pool=4096, draws=100)
    return predictive_checks(density, tempered_draws(density, default_rng(seed)), SeedSequence(seed), options)


@pytest.mark.slow
def test_data_of_the_model_raise_no_alarm(make_study: MakeStudy, campaign: Callable[[int], pd.DataFrame]) -> None:
    """The quick version of studies/misfit/planted, without a misfit."""
    found = checked(make_study(data=campaign(1), noise=NOISE), 1)
    assert found.overall >= DOUBT
    assert found.effective[1] > 30


@pytest.mark.slow
@pytest.mark.parametrize("misfit", some(["constant exponent", "pull offset", "sinkage offset", "lugs ignored"], 2))
def test_planted_misfits_are_found(misfit: str, make_study: MakeStudy, campaign: Callable[[int], pd.DataFrame]) -> None:
    """The quick version of studies/misfit/planted: all raise the alarm, offsets in their own channel."""
    table = campaign(3)
    if misfit == "pull offset":
        table["drawbar_pull [N]"] += 5.0
    if misfit == "sinkage offset":
        table["sinkage [m]"] += 0.015
    options = {"constant_exponent": True} if misfit == "constant exponent" else {}
    priors = {"n1": 0.0} if misfit == "constant exponent" else {}
    study = make_study(data=table, noise=NOISE, model_options=options, priors=priors)
    if misfit == "lugs ignored":
        study = _without_lugs(study, table)
    found = checked(study, 3)
    assert found.overall < DOUBT
    if misfit.endswith("offset"):
        channel = {"pull": "drawbar_pull", "sinkage": "sinkage"}[misfit.split()[0]]
        assert (found.checks[0].channel, found.checks[0].statistic) == (channel, "level")
        assert found.checks[0].finding == "is shifted as a whole"


@pytest.mark.slow
@pytest.mark.parametrize("offset", [0.0, 5.0])
def test_latent_loads_are_checked_alike(offset: float, make_study: MakeStudy, make_table: MakeTable) -> None:
    """With drive both, data of the model raise no alarm, and an offset in pull raises it in its channel."""
    tables = [make_table("M2", slips=(0.05, 0.2, 0.35, 0.6), load=load) for load in (50.0, 90.0)]
    table, rng = pd.concat(tables, ignore_index=True), default_rng(7)
    table = table.rename(columns={"load [N]": "normal_force [N]"})
    noise = {"normal_force [N]": 2.0, "drawbar_pull [N]": 1.0, "resistance_moment [N m]": 0.2}
    for name, sd in {"sinkage [m]": 1e-3, **noise}.items():
        table[name] += sd * rng.standard_normal(len(table))
    table["drawbar_pull [N]"] += offset
    free = ("n0", "c", "phi", "c1")
    study = make_study(data=table, drive="both", load_range=[20.0, 130.0], free=free, noise=NOISE)
    found = checked(study, 7)
    assert (found.overall < DOUBT) == (offset > 0)
    if offset:
        assert (found.checks[0].channel, found.checks[0].statistic) == ("drawbar_pull", "level")


def _without_lugs(study: Study, table: pd.DataFrame) -> Study:
    """The study of a user who measures slip on the rim and takes the wheel for a smooth one."""
    lugged = study.wheels["Wh32"]
    rim = 1 - float(lugged.shearing_radius()) / lugged.radius * (1 - table["slip"])
    return Study(
        table.assign(slip=rim.clip(lower=0.0)),
        {"Wh32": replace(lugged, lug_height=0.0, lug_count=0, shearing_radius_coefficient=None)},
        model="M2",
        slip_reference="rim",
        noise=study.noise,
        priors={"set": "paper-box"},
    )


def test_missing_readings_and_one_slip_are_no_obstacle(make_study: MakeStudy, make_table: MakeTable) -> None:
    """Channels are checked on the rows that they were read in, with the statistics that these can have."""
    table = make_table(slips=(0.2, 0.2, 0.2))
    table.loc[1:, "drawbar_pull [N]"] = np.nan
    density = posterior(make_study(data=table, free=("c", "phi")))
    found = predictive_checks(density, weighted_draws(density, default_rng(1)), SeedSequence(1), QUICK)
    statistics = {(one.channel, one.statistic) for one in found.checks}
    names = ("misfit", "level", "largest")
    channels = ("sinkage", "drawbar_pull", "resistance_moment")
    assert statistics == {(channel, name) for channel in channels for name in names}


def test_the_same_seed_gives_the_same_answer(two: Study) -> None:
    """Nothing depends on the order of threads."""
    density = posterior(two)
    draws = weighted_draws(density, default_rng(1))
    first, again = (predictive_checks(density, draws, SeedSequence(4), QUICK) for _ in range(2))
    assert first == again


def test_prior_checks_find_readings_that_the_prior_cannot_predict(two: Study) -> None:
    """Readings of the model agree with the prior; a pull of 60 N more contradicts it, in its channel."""
    density = posterior(two)
    rows = predict_rows(two, density, draw_cut_prior(density, 4000, default_rng(1)).x, default_rng(2))
    assert not prior_checks(two, rows).conflict
    pull = two.observations.values["drawbar_pull"]
    found = prior_checks(two.with_data({"drawbar_pull": pull + 60.0}), rows)
    assert found.conflict
    worst = min(found.checks, key=lambda check: check.p)
    assert (worst.channel, worst.value > worst.high) == ("drawbar_pull", True)


def test_prior_checks_pass_over_rows_that_are_not_used(make_study: MakeStudy, make_table: MakeTable) -> None:
    """A reading far out in a row that is left out of the fit contradicts nothing."""
    table = make_table()
    table["use"] = np.where(table.index == 2, 0, 1)
    table["drawbar_pull [N]"] += np.where(table.index == 2, 500.0, 0.0)
    study = make_study(data=table, free=("c", "phi"))
    density = posterior(study)
    x = draw_cut_prior(density, 1000, default_rng(1)).x
    assert not prior_checks(study, predict_rows(study, density, x, default_rng(2))).conflict


def test_prior_checks_are_exact(two: Study) -> None:
    """For readings drawn from the prior itself every p is uniform, and conflicts are rare."""
    density = posterior(two)
    x = draw_cut_prior(density, 2200, default_rng(1)).x
    rows = predict_rows(two, density, x, default_rng(2))
    before = replace(rows, readings=rows.readings[200:], modelled=rows.modelled[200:])
    found = []
    for readings in rows.readings[:200]:
        values = {name: readings[:, i] for i, name in enumerate(rows.channels)}
        found.append(prior_checks(two.with_data(values), before))
    assert np.mean([one.conflict for one in found]) < 0.03
    for i in range(len(found[0].checks)):
        assert kstest([one.checks[i].p for one in found], "uniform").pvalue > 1e-3


def test_no_p_is_below_what_so_many_draws_can_show(two: Study) -> None:
    """Readings that no draw comes near: (1 + 0) / (1 + n), twice that from both sides, never 0."""
    density = posterior(two)
    rows = predict_rows(two, density, draw_cut_prior(density, 400, default_rng(1)).x, default_rng(2))
    pull = two.observations.values["drawbar_pull"]
    answered = np.isfinite(rows.readings[:, :, rows.channels.index("drawbar_pull")]).all(axis=1).sum()
    checks = prior_checks(two.with_data({"drawbar_pull": pull + 1e5}), rows)
    assert min(check.p for check in checks.checks) == pytest.approx(2 / (1 + answered))
    judges = predictive_checks_module._judges(density, default_rng(3), {})
    number = sum(len(judge.statistics) for judge in judges)
    made = default_rng(4).uniform(0.2, 0.8, (99, number))
    compared = predictive_checks_module._compared(judges, np.full(number, 1e-9), made, (1.0, 1.0))
    assert (compared.overall, min(check.calibrated for check in compared.checks)) == (0.01, 0.01)


SHIFTED = pd.DataFrame(
    {
        "wheel": ["Wh11"] * 9 + ["Wh32"] * 9,
        "slip": [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6] * 2,
        "load [N]": 80.0,
        "resistance_moment [N m]": np.zeros(18),
    }
)


@pytest.mark.parametrize("shift", [0.0, 0.9])
def test_two_wheels_of_one_soil_that_differ_are_seen_by_wheel(shift: float) -> None:
    """Moments of one wheel all low and of the other all high, under noise that is estimated with them."""
    estimate = Noise("resistance_moment", law=Law("halfnorm", {"loc": 0.0, "scale": 1.0}, lower=0.05))
    study = made(pooling=None, data=SHIFTED, noise={"resistance_moment": estimate}, priors=FREE)
    density = posterior(study)
    mean = density.likelihood.predicted(density.outcomes(np.array([[1000.0, 0.52, 0.012, 0.2]])))[0, :, 0]
    moved = mean + 0.3 * default_rng(3).standard_normal(18) + np.where(np.arange(18) < 9, -shift, shift)
    density = posterior(study.with_data({"resistance_moment": moved}))
    draws, parts = tempered_draws(density, default_rng(1)), {"wheel": np.repeat([0, 1], 9)}
    found = predictive_checks(density, draws, SeedSequence(2), parts=parts)
    assert [check.statistic for check in found.checks].count("by wheel") == 1
    if shift:
        assert found.checks[0].statistic == "by wheel"
        assert found.doubtful
        assert found.checks[0].finding == "is off to different sides for different wheels"
        assert predictive_checks(density, draws, SeedSequence(2)).overall > 2 * found.overall
    else:
        assert found.overall >= DOUBT


def test_what_no_replicate_is_as_strange_as_is_held_against_more(two: Study) -> None:
    """Twice as many again, so that an alarm is no chance of one in two hundred; else as many as asked for."""
    density = posterior(two)
    draws = weighted_draws(density, default_rng(1))
    assert predictive_checks(density, draws, SeedSequence(1), QUICK).replicates == 100
    pull = two.observations.values["drawbar_pull"] + np.array([9.0, 0, 0, 0, 0, -9.0])
    density = posterior(two.with_data({"drawbar_pull": pull}))
    found = predictive_checks(density, weighted_draws(density, default_rng(1)), SeedSequence(1), QUICK)
    assert (found.replicates, found.overall) == (300, 1 / 301)
    assert not found.alarm
    assert found.doubtful
    assert replace(found, overall=0.9 * ALARM).alarm
