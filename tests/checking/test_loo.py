"""Leave-one-out: against quadrature, by weights and by new samplings, and what is said about differences."""

from collections.abc import Callable
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence, default_rng
from scipy.special import logsumexp, ndtr

from bayesterra.arrays import FloatArray
from bayesterra.checking import loo
from bayesterra.checking.loo import CrossValidation, Difference, LeftOut, cross_validate, difference
from bayesterra.likelihood.forward import Outcomes
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.sampling.evidence import PosteriorProposal
from bayesterra.stats.laws import Law
from bayesterra.stats.mixture import normalised, pareto_limit, pareto_smoothed, systematic
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]

PRIORS = {"c": Law("uniform", lower=0.0, upper=2000.0), "phi": Law("norm", {"loc": 0.55, "scale": 0.1})}


class Grid:
    """The posterior of c and φ on a grid: everything about rows left out by sums."""

    def __init__(self, density: Posterior) -> None:
        self.density = density
        c, phi = np.linspace(0.5, 1999.5, 500), np.linspace(0.15, 0.95, 400)
        self.x = np.stack(np.meshgrid(c, phi, indexing="ij"), axis=-1).reshape(-1, 2)
        self.prior = density.log_prior(self.x)
        self.rows = density.log_terms(self.x).sum(axis=2)

    def without(self, i: int) -> FloatArray:
        """Log weights of the posterior without row ``i``."""
        level = self.prior + np.delete(self.rows, i, axis=1).sum(axis=1)
        return np.asarray(level - logsumexp(level))

    @property
    def elpd(self) -> FloatArray:
        """Of every row."""
        return np.array([logsumexp(self.without(i) + self.rows[:, i]) for i in range(self.rows.shape[1])])

    def pit(self, i: int, outcomes: Outcomes) -> FloatArray:
        """Of every channel of row ``i``; ``outcomes`` are those of the whole grid."""
        likelihood = self.density.likelihood
        mean = likelihood.predicted(outcomes)[:, i]
        scale = np.array([noise.sd for noise in likelihood.noise])
        return np.asarray(np.exp(self.without(i)) @ ndtr((likelihood.measured[i] - mean) / scale))


def noisy(table: pd.DataFrame, seed: int) -> pd.DataFrame:
    """The table with the noise that the studies state."""
    rng = default_rng(seed)
    for name, sd in (("sinkage [m]", 1e-3), ("drawbar_pull [N]", 1.5), ("resistance_moment [N m]", 0.3)):
        table[name] += sd * rng.standard_normal(len(table))
    return table


def draws_of(density: Posterior, n: int = 4000) -> FloatArray:
    """Posterior draws by importance from the prior."""
    x = draw_cut_prior(density, 100_000, default_rng(1)).x
    return x[systematic(normalised(density.log_terms(x).sum(axis=(1, 2))), n, default_rng(2))]


@pytest.fixture(scope="module")
def study(make_study: MakeStudy, make_table: MakeTable) -> Study:
    """Six rows, the fifth of them 12 N (8 sd of noise) off in pull."""
    table = noisy(make_table(), 1)
    table["drawbar_pull [N]"] += np.where(table.index == 4, 12.0, 0.0)
    return make_study(data=table, free=("c", "phi"), priors=PRIORS)


@pytest.fixture(scope="module")
def grid(study: Study) -> Grid:
    """Its grid."""
    return Grid(posterior(study))


@pytest.fixture(scope="module")
def weighted(study: Study) -> CrossValidation:
    """Its rows left out, told that six rows are many: by weights where k̂ allows."""
    density = posterior(study)
    return cross_validate(density, draws_of(density), SeedSequence(1), {}, few_rows=2)[0]


@pytest.mark.slow
def test_new_samplings_agree_with_quadrature(study: Study, grid: Grid, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where no weights are even enough every row is sampled anew, and its elpd is that of the grid within its error."""
    monkeypatch.setattr(loo, "EVEN", -np.inf)
    density = posterior(study)
    found = cross_validate(density, draws_of(density), SeedSequence(1), {})[0]
    assert all(row.refitted for row in found.rows)
    errors = np.array([row.error for row in found.rows])
    assert (errors < 0.05).all()
    assert (np.abs(found.by_row - grid.elpd) < 4 * errors + 0.01).all()
    assert found.elpd == pytest.approx(grid.elpd.sum(), abs=0.1)
    full = logsumexp(grid.prior + grid.rows.sum(axis=1))
    at_all = logsumexp(grid.prior[:, None] + grid.rows.sum(axis=1)[:, None] + grid.rows, axis=0) - full
    assert found.effective_parameters == pytest.approx(at_all.sum() - grid.elpd.sum(), abs=0.15)


@pytest.mark.parametrize("enough", [0.0, np.inf])
def test_attempts_end_once_enough_draws_are_effective(
    study: Study, monkeypatch: pytest.MonkeyPatch, enough: float
) -> None:
    """Each row is sampled anew, three times at most; the draws kept are those of the best attempt."""
    monkeypatch.setattr(loo, "EVEN", -np.inf)
    monkeypatch.setattr(loo, "EFFECTIVE", enough)
    monkeypatch.setattr(loo, "FINAL_DRAWS", (4096, 4096, 4096))
    seen, drawn, result = dict[Any, list[Any]](), loo._Case._drawn, loo._Case.result
    kept = dict[Any, Any]()

    def watched(case: Any, *rest: Any) -> Any:
        seen.setdefault(case.rows, []).append(found := drawn(case, *rest))
        return found

    def ended(case: Any, *rest: Any, **more: Any) -> Any:
        kept[case.rows] = found = result(case, *rest, **more)
        return found

    monkeypatch.setattr(loo._Case, "_drawn", watched)
    monkeypatch.setattr(loo._Case, "result", ended)
    density = posterior(study)
    cross_validate(density, draws_of(density), SeedSequence(1), {})
    assert len(seen) == 6
    for rows, found in seen.items():
        assert [each.reliable for each in found].index(True) == len(found) - 1 or len(found) == 3
        assert len(found) == 3 or enough == 0.0
        assert kept[rows] is max((each for each in found if each.reliable), key=lambda each: each.effective)


def test_of_attempts_that_cannot_be_relied_on_the_most_even_stands(
    study: Study, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where a posterior far away is not looked for: the attempt of the least k̂, which is not always the last."""
    monkeypatch.setattr(loo._Weighted, "reliable", False)
    seen, drawn = list[Any](), loo._Case._drawn

    def watched(case: Any, *rest: Any) -> Any:
        seen.append(found := replace(drawn(case, *rest), k=[0.9, 0.8, 1.0, 1.1][len(seen)]))
        return found

    monkeypatch.setattr(loo._Case, "_drawn", watched)
    density = posterior(study)
    x = draws_of(density)
    near = PosteriorProposal.of(density, x)
    case = loo._Case(near, near.mixture(default_rng(1)), x, density.log_rows(x), (4,), None)
    assert case.result(-np.inf, 0.0, SeedSequence(1), far=False) is seen[1]
    assert len(seen) == 4


@pytest.mark.parametrize(("n", "far", "told"), [(4000, 500.0, True), (500, 500.0, False), (500, 0.5, True)])
def test_many_draws_are_right_though_the_rows_lie_far_off(n: int, far: float, told: bool) -> None:
    """The mean density of rows far from all told ones rests on few draws; the posterior without them does not."""
    x = default_rng(1).normal(size=(n, 1))
    found = loo._Weighted.of(x, np.zeros(n), -far * x[:, 0] ** 2)
    assert (found.estimate()[1] < loo.CLOSE) is (far < 1.0)
    assert found.effective == pytest.approx(n)
    assert found.reliable is told


@pytest.mark.parametrize(("least", "anew"), [(0.0, False), (400.0, True)])
def test_a_level_of_few_effective_draws_is_sampled_anew(
    study: Study, monkeypatch: pytest.MonkeyPatch, least: float, anew: bool
) -> None:
    """Without rows 3 and 4 the weights of 250 effective draws would do by their k̂ alone, were 0.7 allowed."""
    monkeypatch.setattr(loo, "EVEN", 0.7)
    monkeypatch.setattr(loo, "ENOUGH", least)
    sampled = list[tuple[int, ...]]()
    drawn = loo._Case._drawn

    def watched(case: Any, *rest: Any) -> Any:
        sampled.append(case.rows)
        return drawn(case, *rest)

    monkeypatch.setattr(loo._Case, "_drawn", watched)
    density = posterior(study)
    cross_validate(density, draws_of(density), SeedSequence(1), {(2, 3): density.likelihood}, few_rows=0)
    assert ((2, 3) in sampled) is anew


def test_weights_do_where_k_allows_and_only_there(weighted: CrossValidation, grid: Grid) -> None:
    """Told that six rows are many, it samples anew where k̂ is high, at the outlier, and is right."""
    limit = pareto_limit(4000)
    assert [row.refitted for row in weighted.rows] == [not row.k <= limit for row in weighted.rows]
    assert {row.refitted for row in weighted.rows} == {True, False}
    np.testing.assert_allclose(weighted.by_row, grid.elpd, atol=0.12)


def test_of_few_rows_even_weights_do_and_no_others(study: Study, grid: Grid) -> None:
    """Those with k̂ up to 0.5 and 1000 effective draws, which is what a new sampling gives; each is right."""
    density = posterior(study)
    x = draws_of(density)
    found = cross_validate(density, x, SeedSequence(1), {})[0]
    near, rows = PosteriorProposal.of(density, x), density.log_rows(x)
    weights = [loo._Case(near, near.mixture(default_rng(1)), x, rows, (i,), None).weighted for i in range(6)]
    even = [each.k <= 0.5 and each.effective >= 1000 for each in weights]
    assert [row.refitted for row in found.rows] == [not each for each in even]
    assert {*even} == {True, False}
    errors = np.array([row.error for row in found.rows])
    assert (errors < 0.05).all()
    assert (np.abs(found.by_row - grid.elpd) < 4 * errors + 0.01).all()


def test_pit_is_what_the_other_rows_predict(weighted: CrossValidation, grid: Grid) -> None:
    """PIT values of weighted and of newly sampled rows are those of the grid."""
    outcomes = grid.density.outcomes(grid.x)
    expected = np.array([grid.pit(i, outcomes) for i in range(6)])
    for c, name in enumerate(grid.density.likelihood.channels):
        np.testing.assert_allclose(weighted.pit[name], expected[:, c], atol=0.03)


def test_a_row_is_left_out_with_all_its_readings(make_study: MakeStudy, make_table: MakeTable) -> None:
    """Rows of one channel and rows of three count alike, and a missing reading has no PIT."""
    table = noisy(make_table(), 2)
    table.loc[2, ["sinkage [m]", "resistance_moment [N m]"]] = np.nan
    density = posterior(make_study(data=table, free=("c", "phi"), priors=PRIORS))
    found = cross_validate(density, draws_of(density), SeedSequence(1), {}, few_rows=2)[0]
    assert [row.row for row in found.rows] == [1, 2, 3, 4, 5, 6]
    assert np.isnan(found.pit["sinkage"][2])
    assert 0 < found.pit["drawbar_pull"][2] < 1


def test_latent_loads_have_no_pit(make_study: MakeStudy, make_table: MakeTable) -> None:
    """With drive both, rows are left out by their marginal density; readings of a row predict each other."""
    table = noisy(make_table(slips=(0.1, 0.3, 0.5)), 3).rename(columns={"load [N]": "normal_force [N]"})
    density = posterior(
        make_study(drive="both", data=table, free=("c", "phi"), priors=PRIORS, load_range=[40.0, 120.0])
    )
    x = draw_cut_prior(density, 3000, default_rng(1)).x
    draws = x[systematic(normalised(density.log_terms(x).sum(axis=(1, 2))), 1000, default_rng(2))]
    found = cross_validate(density, draws, SeedSequence(1), {}, few_rows=2)[0]
    assert found.pit == {}
    rows = density.log_terms(x).sum(axis=2)
    for i in range(3):
        weights = normalised(np.delete(rows, i, axis=1).sum(axis=1))
        assert found.by_row[i] == pytest.approx(logsumexp(np.log(weights) + rows[:, i]), abs=0.15)


def entry(row: int, elpd: float, **changes: Any) -> LeftOut:
    """One row left out."""
    return LeftOut(**{"row": row, "elpd": elpd, "error": 0.0, "k": 0.1, "refitted": False, **changes})


def some(values: list[float], first: int = 1) -> CrossValidation:
    """A cross-validation with these elpds."""
    rows = tuple(entry(first + i, value) for i, value in enumerate(values))
    return CrossValidation(rows, tuple(values), {"sinkage": (0.5, float("nan"))})


@pytest.mark.parametrize(
    ("elpd", "se", "apart"),
    [(3.9, 0.1, False), (4.0, 2.01, False), (4.0, 2.0, True), (-9.0, 1.0, True), (-9.0, 5.0, False)],
)
def test_small_or_uncertain_differences_are_not_told_apart(elpd: float, se: float, apart: bool) -> None:
    """A difference counts from 4 on and from two standard errors on."""
    assert Difference(elpd, se).distinguishable == apart


def test_differences_are_taken_row_by_row() -> None:
    """What both models predict badly cancels; the error is that of the rows' differences."""
    found = difference(some([1.0, -8.0, 3.0]), some([0.0, -9.5, 2.5]))
    assert found.elpd == pytest.approx(3.0)
    assert found.se == pytest.approx(np.sqrt(3) * np.std([1.0, 1.5, 0.5], ddof=1))


def test_models_of_different_rows_are_not_compared() -> None:
    """The error names the rows of both."""
    with pytest.raises(ValueError, match=r"on the same rows only \(got rows \[1, 2\] and \[2, 3\]\)"):
        difference(some([1.0, 2.0]), some([1.0, 2.0], first=2))


def test_records_are_read_back() -> None:
    """A record gives the same rows back, with null for what is not a number."""
    before = some([1.0, 2.0])
    before = replace(before, rows=(before.rows[0], entry(2, 2.0, k=float("nan"), refitted=True)))
    record = asdict(before)
    record["rows"][1]["k"] = record["pit"]["sinkage"] = None
    record["pit"] = {"sinkage": [0.5, None]}
    again = CrossValidation.from_record(record)
    assert again.elpd == before.elpd
    assert again.rows[0] == before.rows[0]
    assert np.isnan(again.rows[1].k)
    assert np.isnan(again.pit["sinkage"][1])


def test_weights_without_a_tail_to_fit() -> None:
    """A few draws with all the weight are never reliable; equal weights always are."""
    log_weights, k = pareto_smoothed(-1000.0 * np.arange(1000.0))
    assert np.isinf(k)
    assert np.exp(log_weights).sum() == pytest.approx(1.0)
    log_weights, k = pareto_smoothed(np.full(1000, -3.0))
    assert k == 0.0
    np.testing.assert_allclose(np.exp(log_weights), 1e-3)


def test_pareto_smoothing_finds_the_tail() -> None:
    """Weights 1/u^k of uniform u have the Pareto shape k, and smoothed weights sum to one."""
    u = default_rng(1).random(200_000)
    for shape in (0.3, 0.9):
        log_weights, k = pareto_smoothed(-shape * np.log(u))
        assert k == pytest.approx(shape, abs=0.12)
        assert np.exp(log_weights).sum() == pytest.approx(1.0)
    assert pareto_limit(100) == pytest.approx(0.5)
    assert pareto_limit(10_000) == 0.7


def test_rows_left_out_have_their_numbers_in_the_table(make_study: MakeStudy, make_table: MakeTable) -> None:
    """The third row is not in the fit: the others keep their numbers, and their own densities."""
    table = noisy(make_table(), 2).assign(use=[1, 1, 0, 1, 1, 1])
    density = posterior(make_study(data=table, free=("c", "phi"), priors=PRIORS))
    draws = np.array([268.0, 0.511]) + np.array([5.0, 0.002]) * default_rng(1).standard_normal((400, 2))
    found = cross_validate(density, draws, SeedSequence(1), {}, few_rows=1)[0]
    assert [row.row for row in found.rows] == [1, 2, 4, 5, 6]
    np.testing.assert_allclose(found.full, density.log_terms(draws).sum(axis=2).mean(axis=0), atol=0.2)
