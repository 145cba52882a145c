"""Convergence of ensembles: autocorrelation, effective size, R-hat, frozen walkers, thinning."""

import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import kstest

from bayesterra.arrays import FloatArray
from bayesterra.sampling.sampler import thin
from bayesterra.stats import diagnostics
from bayesterra.stats.diagnostics import (
    Diagnosis,
    array_ess,
    autocorrelation_time,
    diagnose,
    disagreement,
    effective_size,
    hdi,
    monte_carlo_error,
    r_hat,
    rank_scores,
    tail_indicators,
    thinning,
)

ACCEPTED = np.full((4, 32), 0.5)


def bulk_size(chains: FloatArray) -> float:
    """Effective number of draws for the centre: that of the rank-normalised draws (Vehtari et al. 2021)."""
    return effective_size(rank_scores(chains))


def tail_size(chains: FloatArray) -> float:
    """Effective number of draws for the tails: the smaller one of the 5 and 95 % indicators."""
    return min(effective_size(inside) for inside in tail_indicators(chains))


def walks(correlation: float, *, ensembles: int = 4, steps: int = 2000, walkers: int = 32, seed: int = 1) -> FloatArray:
    """Standard normal walkers (ensembles, steps, walkers) with lag-one correlation ρ: τ = (1 + ρ)/(1 − ρ)."""
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal((ensembles, steps, walkers)) * np.sqrt(1 - correlation**2)
    noise[:, 0] = rng.standard_normal((ensembles, walkers))
    return np.asarray(lfilter([1.0], [1.0, -correlation], noise, axis=1))


def check(diagnosis: Diagnosis, name: str) -> bool:
    """Whether the check whose name begins like this passed."""
    return next(c.passed for c in diagnosis.checks if c.name.startswith(name))


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_autocorrelation_time_is_that_of_the_process(correlation: float) -> None:
    """First-order walks have τ = (1 + ρ)/(1 − ρ), in every ensemble."""
    times = autocorrelation_time(walks(correlation, steps=4000))
    np.testing.assert_allclose(times, (1 + correlation) / (1 - correlation), rtol=0.1)


@pytest.mark.parametrize("correlation", [0.0, 0.6, 0.9])
def test_effective_size_is_that_of_the_mean(correlation: float) -> None:
    """Over many repetitions the variance of the mean is that of so many independent draws."""
    repeated = [walks(correlation, steps=400, walkers=16, seed=k) for k in range(300)]
    variance = np.var([chains.mean() for chains in repeated])
    size = np.mean([effective_size(chains) for chains in repeated[:20]])
    assert variance * size == pytest.approx(1.0, rel=0.35)


def test_independent_draws_count_in_full() -> None:
    """Bulk and tail sizes of independent draws are their number, as ArviZ finds too."""
    chains = walks(0.0)
    for size, method in ((bulk_size(chains), "bulk"), (tail_size(chains), "tail")):
        assert size == pytest.approx(chains.size, rel=0.1)
        assert size == pytest.approx(array_ess(chains.reshape(4, -1), method), rel=0.2)


def test_rank_normalised_size_does_not_depend_on_the_scale() -> None:
    """Bulk and tail sizes are the same for a parameter and its exponential."""
    chains = walks(0.7)
    assert bulk_size(np.exp(3 * chains)) == pytest.approx(bulk_size(chains))
    assert tail_size(np.exp(3 * chains)) == pytest.approx(tail_size(chains))


def test_walkers_that_share_a_path_are_not_counted_apart() -> None:
    """R-hat compares ensembles: walkers in another order give the same value, other ensembles do not."""
    chains = walks(0.5)
    assert r_hat(chains[:, :, ::-1]) == pytest.approx(r_hat(chains), abs=1e-3)
    sorted_walkers = chains + np.linspace(-3, 3, 32)  # as chains of their own these would disagree wildly
    assert r_hat(sorted_walkers) < 1.01


@pytest.mark.parametrize("shift", [0.5, 1.0, 10.0])
def test_r_hat_sees_a_shifted_ensemble(shift: float) -> None:
    """One ensemble in another place fails R-hat, by name of the parameter."""
    chains = np.stack([walks(0.5), walks(0.5, seed=2)], axis=-1)
    chains[2, :, :, 1] += shift
    diagnosis = diagnose(("a", "b"), chains, ACCEPTED, 1000)
    assert not check(diagnosis, "R-hat")
    assert not diagnosis.converged
    assert "disagree on b" in diagnosis.checks[1].advice


def test_r_hat_sees_an_ensemble_of_another_width() -> None:
    """Equal means and unequal spreads fail as well: ranks are folded."""
    chains = walks(0.5)
    chains[1] *= 2.0
    assert r_hat(chains) > 1.01


def test_r_hat_sees_drift() -> None:
    """Ensembles that drift together disagree between their early and their late halves."""
    drift = np.linspace(-1, 1, 2000)[:, None]
    assert r_hat(walks(0.5) + drift) > 1.01


@pytest.mark.slow
@pytest.mark.parametrize("shift", [pytest.param(0.02, marks=pytest.mark.slow), 0.05])
def test_agreement_sees_what_many_draws_show_and_r_hat_lets_pass(shift: float) -> None:
    """An ensemble off by some hundredths of a standard deviation, or drifting by that, is no chance."""
    chains = walks(0.5, steps=8000, walkers=64)
    assert check(diagnose(("a",), chains[..., None], np.full((4, 64), 0.5), 1000), "agreement")
    off, drifting = chains.copy(), chains + shift * np.linspace(-1, 1, 8000)[:, None]
    off[2] += shift
    for wrong in (off, drifting):
        found = diagnose(("a",), wrong[..., None], np.full((4, 64), 0.5), 1000)
        assert check(found, "R-hat")
        assert not check(found, "agreement")


@pytest.mark.parametrize("correlation", [0.0, 0.8])
def test_agreement_is_a_fair_test(correlation: float) -> None:
    """On sound ensembles the p value is uniform, whatever their autocorrelation."""
    p = []
    for seed in range(200):
        chains = walks(correlation, steps=600, walkers=16, seed=seed)
        p.append(disagreement(chains, effective_size(chains)))
    assert kstest(p, "uniform").pvalue > 1e-3


def test_good_chains_pass_every_check() -> None:
    """Long, agreeing ensembles are converged; the diagnosis states τ, sizes and acceptance."""
    diagnosis = diagnose(("a",), walks(0.5)[..., None], ACCEPTED, 10_000)
    assert diagnosis.converged
    assert diagnosis.tau[0] == pytest.approx(3.0, rel=0.1)
    assert diagnosis.ess_bulk[0] == pytest.approx(4 * 2000 * 32 / 3.0, rel=0.1)
    assert diagnosis.ess == min(diagnosis.ess_bulk[0], diagnosis.ess_tail[0])
    assert diagnosis.acceptance == 0.5
    assert diagnosis.steps == 2000


def test_too_few_draws_and_too_short_chains_fail() -> None:
    """Asking for more draws than there are fails; so do steps fewer than fifty autocorrelation times."""
    few = diagnose(("a",), walks(0.5)[..., None], ACCEPTED, 1_000_000)
    assert not check(few, "effective draws")
    short = diagnose(("a",), walks(0.95, steps=1000)[..., None], ACCEPTED, 100)
    assert not check(short, "steps for a reliable")


@pytest.mark.parametrize(("correlation", "steps", "asked"), [(0.5, 2000, 1_000_000), (0.95, 1000, 100)])
def test_r_hat_waits_for_draws_and_steps_where_ensembles_go_on(correlation: float, steps: int, asked: float) -> None:
    """It costs most of a diagnosis, and too few draws or steps fail without it; all else is the same."""
    chains = walks(correlation, steps=steps)[..., None]
    first, whole = (diagnose(("a",), chains, ACCEPTED, asked, going_on=early) for early in (True, False))
    assert np.isnan(first.worst_r_hat)
    assert np.isfinite(whole.worst_r_hat)
    assert not first.converged
    assert not whole.converged
    assert (first.ess, first.tau) == (whole.ess, whole.tau)
    enough = diagnose(("a",), walks(0.5)[..., None], ACCEPTED, 10_000, going_on=True)
    assert enough.converged
    assert enough.worst_r_hat == diagnose(("a",), walks(0.5)[..., None], ACCEPTED, 10_000).worst_r_hat


def test_r_hat_waits_for_ensembles_that_are_apart() -> None:
    """Means that differ by more than chance fail without it, too."""
    chains = walks(0.5)[..., None]
    chains[0] += 0.2
    first, whole = (diagnose(("a",), chains, ACCEPTED, 1000, going_on=early) for early in (True, False))
    assert np.isnan(first.worst_r_hat)
    assert np.isfinite(whole.worst_r_hat)
    assert not check(whole, "agreement of ensembles")
    assert not first.converged
    assert not whole.converged


def test_r_hat_stops_at_the_slowest_that_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where ensembles go on; the verdict is that of all."""
    monkeypatch.setattr(diagnostics, "R_HAT_LIMIT", 1.0 + 1e-9)
    slow, fast = walks(0.95, steps=4000), walks(0.2, steps=4000)
    chains = np.stack([fast, slow, fast], axis=-1)
    first, whole = (diagnose(("a", "b", "c"), chains, ACCEPTED, 100, going_on=early) for early in (True, False))
    assert not check(whole, "R-hat")
    assert all(each.passed for each in whole.checks if not each.name.startswith("R-hat"))
    np.testing.assert_array_equal(np.isfinite(first.r_hat), [False, True, False])
    assert first.r_hat[1] == whole.worst_r_hat
    assert not first.converged


def test_a_frozen_walker_is_seen() -> None:
    """A walker that accepted nothing, and one that nearly so, end the claim of convergence."""
    chains = walks(0.5)
    chains[1, :, 7] = 0.3
    accepted = ACCEPTED.copy()
    accepted[1, 7] = 0.0
    frozen = diagnose(("a",), chains[..., None], accepted, 1000)
    assert not check(frozen, "walkers that never moved")
    accepted[1, 7] = 0.05
    slow = diagnose(("a",), walks(0.5)[..., None], accepted, 1000)
    assert check(slow, "walkers that never moved")
    assert not check(slow, "slowest walker")


def test_chains_that_do_not_move_at_all_are_judged_not_crashed_on() -> None:
    """Constant chains have no effective draws, and the verdict is a plain no without a warning."""
    chains = np.stack([walks(0.5), np.zeros((4, 2000, 32))], axis=-1)
    diagnosis = diagnose(("a", "stuck"), chains, np.zeros((4, 32)), 1000)
    assert diagnosis.ess == 0.0
    assert not diagnosis.converged
    assert "stuck is the slowest" in diagnosis.checks[0].advice
    assert thinning(np.ascontiguousarray(np.moveaxis(chains, -1, 0))) >= 1


def test_an_ensemble_that_stands_still_spoils_them_all() -> None:
    """Pooled with an ensemble that never moved, draws of the others are worth nothing."""
    chains = walks(0.5)
    chains[3] = 2.0
    assert effective_size(chains) == 0.0


def test_a_slow_ensemble_counts_with_its_full_weight() -> None:
    """Where ensembles differ in τ the size is still that of the pooled mean: repetitions agree."""

    def mixed(seed: int) -> FloatArray:
        return np.concatenate(
            [walks(0.95, ensembles=1, walkers=16, seed=seed), walks(0.0, ensembles=3, walkers=16, seed=10_000 + seed)]
        )

    variance = np.var([mixed(seed).mean() for seed in range(1, 301)])
    size = np.mean([effective_size(mixed(seed)) for seed in range(1, 6)])
    assert variance * size == pytest.approx(1.0, rel=0.35)


@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_thinning_keeps_nine_tenths(correlation: float) -> None:
    """The kept draws are worth at least 90 % of all, and ArviZ's size on them is ours within 20 %."""
    chains = walks(correlation, steps=4000)[..., None]
    kept = thin(chains)
    full = effective_size(chains[..., 0])
    thinned = effective_size(chains[:, :: kept.every, :, 0])
    assert thinned > 0.9 * full
    assert (kept.every > 1) == (correlation > 0)
    assert array_ess(kept.chains[..., 0]) == pytest.approx(bulk_size(chains[..., 0]), rel=0.2)


def test_kept_draws_are_laid_walker_after_walker() -> None:
    """Every kept draw says which walker and step it is, walker by walker in the order of steps."""
    steps, walkers = 300, 5
    chains = np.arange(2 * steps * walkers, dtype=float).reshape(2, steps, walkers, 1)
    kept = thin(chains + 1e-3 * np.random.default_rng(1).standard_normal(chains.shape))
    step, walker = kept.labels["step"].astype(int), kept.labels["walker"].astype(int)
    assert (np.diff(walker, axis=1) >= 0).all()
    expected = chains[np.arange(2)[:, None], step, walker, 0]
    np.testing.assert_allclose(kept.chains[..., 0], expected, atol=0.01)


@pytest.mark.parametrize("end", [0.0, 1.0])
def test_draws_piled_at_an_end_have_a_tail(end: float) -> None:
    """A law with a pole at an end of its range puts many draws on one value; they moved all the same."""
    chains = np.clip(walks(0.0) / 2.0, -0.2, 0.2) if end else np.minimum(walks(0.0), 0.3)
    assert (chains == chains.max()).mean() > 0.2
    assert tail_size(chains) == pytest.approx(chains.size, rel=0.1)


def test_hdi_is_the_shortest_interval() -> None:
    """For an exponential law the 90 % interval of highest density begins at zero and ends at ln 10."""
    draws = np.random.default_rng(1).exponential(size=100_000)
    low, high = hdi(draws, 0.9)
    assert low == pytest.approx(0.0, abs=0.01)
    assert high == pytest.approx(np.log(10.0), rel=0.02)


def test_monte_carlo_error_is_that_of_repetitions() -> None:
    """The stated error of the mean of independent draws is σ/√n."""
    chains = walks(0.0).reshape(4, -1)
    assert monte_carlo_error(chains, "mean") == pytest.approx(1 / np.sqrt(chains.size), rel=0.1)


def test_constant_draws_have_no_error() -> None:
    """A quantity that is the same in every draw has no Monte Carlo error, and gives no warning."""
    constant = np.full((4, 500), 0.4)
    assert [monte_carlo_error(constant, name) for name in ("mean", "median", "sd")] == [0.0, 0.0, 0.0]
    assert hdi(constant) == (0.4, 0.4)
