"""Levels left out of a run: which, the posterior without them against grids, what counts are worth."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence, default_rng
from scipy.special import logsumexp
from scipy.stats import binom

from bayesterra.arrays import FloatArray
from bayesterra.checking.folds import Fold
from bayesterra.checking.levels import ROWS, counts, parts_of, places, predicted, rests, scope, untested, ways
from bayesterra.checking.loo import Level, Without, cross_validate
from bayesterra.checking.validation import prediction_verdict
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.stats.laws import Law
from bayesterra.stats.mixture import normalised, systematic
from bayesterra.study.study import Study
from tests.support.two_wheels import TABLE, made

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]

PRIORS = {"c": Law("uniform", lower=0.0, upper=2000.0), "phi": Law("norm", {"loc": 0.55, "scale": 0.1})}


def noisy(table: pd.DataFrame, seed: int) -> pd.DataFrame:
    """The table with the noise that the studies state."""
    rng = default_rng(seed)
    for name, sd in (("sinkage [m]", 1e-3), ("drawbar_pull [N]", 1.5), ("resistance_moment [N m]", 0.3)):
        table[name] += sd * rng.standard_normal(len(table))
    return table


def test_what_the_table_has_two_of_is_left_out() -> None:
    """Slips, wheels, sites and loads; one level is none, and the same parts in two ways are one."""
    study = made(pooling=None)
    assert list(ways(study)) == ["slip", "wheel", "site"]
    assert [fold.name for fold in ways(study)["slip"]] == ["slip 0.100", "slip 0.250", "slip 0.500"]
    loads = TABLE.assign(**{"load [N]": [80.0, 40.0, 41.0] + [80.0] * 3})
    folds = ways(made(pooling=None, data=loads))["load"]
    assert [fold.name for fold in folds] == ["load 40.5 N", "load 80 N"]
    loads = TABLE.assign(**{"load [N]": [80.0] * 3 + [40.0] * 3})  # a load for each wheel
    assert list(ways(made(pooling=None, data=loads))) == ["slip", "wheel", "site"]
    parts = parts_of(study, ways(study))
    assert {by: numbers.tolist() for by, numbers in parts.items()} == {
        "wheel": [0, 0, 0, 1, 1, 1], "site": [0, 0, 1, 1, 0, 0],
    }  # fmt: skip


def test_a_log_has_levels_too() -> None:
    """Slips without a gap between them are cut into equal ranges: else nothing could be left out of a log."""
    slip = np.linspace(0.05, 0.6, 300)
    data = pd.DataFrame({name: np.interp(slip, TABLE["slip"][:3], TABLE[name][:3]) for name in TABLE.columns[2:]
                         if pd.api.types.is_numeric_dtype(TABLE[name])})  # fmt: skip
    study = made(pooling=None, data=data.assign(wheel="Wh32", site="a", slip=slip))
    folds = ways(study)["slip"]
    assert len(folds) == 5
    assert max(float(np.ptp(slip[fold.left])) for fold in folds) < 0.13
    assert np.sum([fold.left for fold in folds], axis=0).tolist() == [1] * 300


def test_rows_that_are_not_used_are_no_level() -> None:
    """Places count the rows in the fit only."""
    study = made(pooling=None, data=TABLE.assign(use=[1, 0, 1, 1, 0, 1]))
    slips = ways(study)["slip"]
    assert [places(study, fold) for fold in slips] == [(0, 2), (1, 3)]
    assert list(rests(study, {"slip": slips})) == [(0, 2), (1, 3)]


def grid(study: Study) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation of c and φ on a grid."""
    density = posterior(study)
    c, phi = np.linspace(5, 1995, 100), np.linspace(0.2, 0.9, 120)
    x = np.stack(np.meshgrid(c, phi, indexing="ij"), axis=-1).reshape(-1, 2)
    level = density.log_density(x)
    weights = np.exp(level - logsumexp(level))
    mean = weights @ x
    return mean, np.sqrt(weights @ (x - mean) ** 2)


def without_levels(study: Study, by: str = "slip") -> tuple[tuple[Fold, ...], dict[Level, Without]]:
    """Levels and the posteriors without them, from draws by importance."""
    density = posterior(study)
    x = draw_cut_prior(density, 40_000, default_rng(1)).x
    draws = x[systematic(normalised(density.log_prior_and_likelihood(x)[1]), 4000, default_rng(2))]
    folds = ways(study)[by]
    return folds, cross_validate(density, draws, SeedSequence(1), rests(study, {by: folds}))[1]


@pytest.mark.parametrize("errors", [{}, pytest.param({"slip": {"sd": 0.01}}, marks=pytest.mark.slow)])
def test_the_posterior_without_a_level_is_that_of_the_other_rows(
    make_study: MakeStudy, make_table: MakeTable, errors: dict[str, Any]
) -> None:
    """Levels of two rows; where rows hang together, what is left out is more than a sum over rows."""
    table = noisy(make_table(slips=(0.1, 0.11, 0.3, 0.31, 0.5, 0.51)), 3)
    study = make_study(data=table, free=("c", "phi"), priors=PRIORS, **errors)
    folds, without = without_levels(study)
    assert len(folds) == 3
    for fold in folds:
        mean, sd = grid(study.with_use(~fold.left))
        found = without[places(study, fold)]
        assert found.reliable
        assert (np.abs(found.x.mean(axis=0) - mean) < 0.15 * sd).all()
        assert (np.abs(found.x.std(axis=0) / sd - 1) < 0.12).all()


def test_readings_are_predicted_from_the_other_levels(make_study: MakeStudy, make_table: MakeTable) -> None:
    """A wild reading lies outside what the others say; the polynomial predicts the same readings."""
    table = noisy(make_table(slips=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6)), 4)
    table["drawbar_pull [N]"] += np.where(table.index == 3, 12.0, 0.0)
    study = make_study(data=table, free=("c", "phi"), priors=PRIORS)
    folds, without = without_levels(study)
    records = predicted(study, posterior(study), {"slip": folds}, without, default_rng(1))
    rows = pd.DataFrame(records)
    assert set(rows["predictor"]) == {"M2", "polynomial"}
    own = rows[rows["predictor"] == "M2"]
    assert len(own) == 18
    wild = own[(own["row"] == 4) & (own["channel"] == "drawbar_pull")]
    assert wild["pit"].item() > 0.999
    inside = int(own[own["channel"] == "drawbar_pull"]["covered90"].sum())
    pull = next(count for count in counts(records, "M2") if count.channel == "drawbar_pull")
    assert (pull.readings, pull.inside, pull.levels) == (6, inside, 6)
    assert pull.few == pytest.approx(binom.cdf(inside, 6, 0.9))


def test_of_many_rows_some_are_scored(make_study: MakeStudy, make_table: MakeTable) -> None:
    """Evenly spaced; all rows of a level are left out all the same."""
    study = make_study(data=make_table(slips=tuple(np.linspace(0.05, 0.6, 2 * ROWS))), free=("phi",))
    fold = Fold("half", study.observations.slip > 0.3)
    without = {places(study, fold): Without(np.array([[0.5568]] * 50), reliable=True)}
    rows = pd.DataFrame(predicted(study, posterior(study), {"slip": (fold,)}, without, default_rng(1)))
    pull = rows[(rows["predictor"] == "M2") & (rows["channel"] == "drawbar_pull")]
    assert (np.diff(pull["row"]) == 2).all()
    assert len(pull) == pytest.approx(ROWS * fold.left.mean(), abs=1)


def readings(inside: list[bool], by: str = "slip", channel: str = "drawbar_pull", crps: float = 1.0) -> list[Any]:
    """Entries of a record: one reading a level, beside a polynomial whose score is 1."""
    return [
        {
            "by": by, "reliable": True, "predictor": name, "level": f"{by} {i}", "row": i + 1,
            "channel": channel, "covered90": each if name == "M1" else True, "extrapolated": False,
            "crps": score + 0.01 * (i % 3),
        }
        for name, score in (("M1", crps), ("polynomial", 1.0)) for i, each in enumerate(inside)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("inside", "of", "word", "grade"),
    [
        (12, 12, "predicts", "good"), (8, 12, "predicts", "good"), (7, 12, "too narrow", "doubtful"),
        (4, 12, "too narrow", "bad"), (40, 40, "too wide", "doubtful"), (20, 20, "predicts", "good"),
    ],
)  # fmt: skip
def test_coverage_of_left_out_readings_decides(inside: int, of: int, word: str, grade: str) -> None:
    """As few, or as many, as hardly ever happen."""
    found = prediction_verdict(readings([i < inside for i in range(of)]), "M1")
    assert (found.word, found.grade) == (word, grade)
    assert str(found.sentence).startswith(f"Left-out slips: {inside} of {of} pulls inside 90 %")
    if word == "too narrow":
        claim = f"intervals are too narrow for other slips ({inside} of {of} pulls inside 90 %)"
        assert found.claim == claim


def test_readings_of_one_level_count_once() -> None:
    """Two wheels, of which one is missed altogether: half, and not ten of twenty."""
    rows = [{**row, "level": "Wh11" if i % 20 < 10 else "Wh32"}
            for i, row in enumerate(readings([i < 10 for i in range(20)], "wheel"))]  # fmt: skip
    (count,) = counts(rows, "M1")
    assert (count.readings, count.inside, count.levels) == (20, 10, 2)
    assert count.few == pytest.approx(binom.cdf(1, 2, 0.9))
    assert prediction_verdict(rows, "M1").grade == "good"


def test_the_least_probable_of_all_counts_is_judged_as_one_of_many() -> None:
    """Of two channels the same shortfall is twice as probable."""
    short = [i < 7 for i in range(12)]
    alone = prediction_verdict(readings(short), "M1").figures["few"]
    both = prediction_verdict([*readings(short), *readings([True] * 12, channel="sinkage")], "M1")
    assert both.figures["few"] == pytest.approx(2 * alone)
    assert "7 of 12 pulls and 12 of 12 sinkages inside 90 %" in str(both.sentence)


def test_a_curve_that_predicts_better_is_said() -> None:
    """By more than three standard errors of the difference, and not where the model is as good."""
    found = prediction_verdict(readings([True] * 12, crps=1.5), "M1")
    assert (found.word, found.grade) == ("worse than a curve", "doubtful")
    assert found.claim == "a curve through the readings predicts pulls better"
    assert prediction_verdict(readings([True] * 12, crps=1.0), "M1").word == "predicts"


def test_what_cannot_be_tested_says_why() -> None:
    """One level, an older folder, a failure; and levels whose posterior was not found."""
    assert prediction_verdict([], "M1").sentence == "All readings are of one level: none can be left out."
    assert "older version" in str(prediction_verdict(None, "M1").sentence)
    failed = prediction_verdict(None, "M1", "levels left out could not be computed (ValueError).")
    assert (failed.word, failed.grade) == ("not tested", "note")
    assert failed.sentence == "levels left out could not be computed (ValueError)."
    unsure = [{**row, "reliable": row["level"] != "slip 3"} for row in readings([True] * 12)]
    assert "Not relied on: slip 3" in str(prediction_verdict(unsure, "M1").sentence)


def test_the_scope_of_a_result_is_that_of_its_rows() -> None:
    """Wheels, slips and loads in the fit; what stood still was not tested."""
    study = made(pooling=None)
    assert scope(study) == "wheels Wh11 and Wh32 at slips 0.1 to 0.5 under 80 N"
    assert untested(study) == ["other loads were not tested"]
    one = study.with_use(np.arange(6) == 1)
    assert scope(one) == "wheel Wh11 at slip 0.25 under 80 N"
    assert untested(one) == ["other slips, loads and wheels were not tested"]


def test_a_row_without_a_reading_is_not_claimed() -> None:
    """It stretches neither slips nor loads of the sentence, and tests no other load."""
    silent = {"wheel": "Wh11", "site": "a", "slip": 0.95, "load [N]": 160.0}
    study = made(pooling=None, data=pd.concat([TABLE, pd.DataFrame([silent])], ignore_index=True))
    assert scope(study) == scope(made(pooling=None)) == "wheels Wh11 and Wh32 at slips 0.1 to 0.5 under 80 N"
    assert untested(study) == untested(made(pooling=None))
