"""The sampler as a whole: determinism, correctness on small problems, honest stops."""

from collections.abc import Callable
from itertools import groupby
from typing import Any

import numpy as np
import pytest
from numpy.random import SeedSequence

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, SupportError
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.sampling import sampler
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.ensemble import Ensemble, Segment
from bayesterra.sampling.sampler import Progress, Samples, sample
from bayesterra.stats.diagnostics import Diagnosis, effective_size
from bayesterra.stats.laws import Law
from bayesterra.stats.mixture import StudentMixture, fit_mixture
from bayesterra.study.noise import Noise
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]

SMALL = SamplingOptions(target_ess=200, walkers=32, max_steps=60)
PLAN = AdaptationOptions(particles=256, components=4, refinements=(2, 4), more=(), shores=4, climbs=10)
QUICK = AdaptationOptions(particles=128, components=3, sweeps=2, refinements=(2,), more=(), shores=2, climbs=10)


def sampled(
    density: Posterior, seed: int, options: SamplingOptions = SMALL, plan: AdaptationOptions = QUICK
) -> Samples:
    """A short run."""
    return sample(density, options, SeedSequence(seed), adaptation=plan)


@pytest.fixture(scope="module")
def density(make_study: MakeStudy) -> Posterior:
    """Three free parameters of an M2 study."""
    return posterior(make_study(free=("n0", "c", "phi")))


@pytest.fixture(scope="module")
def samples(density: Posterior) -> Samples:
    """One short run with seed 7."""
    return sampled(density, 7)


@pytest.fixture
def short_rounds(monkeypatch: pytest.MonkeyPatch) -> int:
    """Rounds of so many steps."""
    monkeypatch.setattr(sampler, "ROUND_STEPS", 50)
    return 50


def test_draws_do_not_depend_on_the_number_of_cores(
    density: Posterior, samples: Samples, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One thread, two threads and a repetition give the same draws bit for bit; another seed others."""
    for cores in (1, 2):
        monkeypatch.setattr(sampler, "usable_processors", lambda cores=cores: cores)
        np.testing.assert_array_equal(sampled(density, 7).chains, samples.chains)
    assert not np.array_equal(sampled(density, 8).chains, samples.chains)


def test_ensembles_are_independent(samples: Samples) -> None:
    """Every ensemble has its own start, its own mixture and its own draws."""
    mixtures = [a.proposal.mixture for a in samples.adaptations]
    for i in range(4):
        for j in range(i):
            assert not np.array_equal(samples.chains[i], samples.chains[j])
            assert not np.array_equal(mixtures[i].means[:1], mixtures[j].means[:1])
            assert not np.isin(samples.adaptations[i].u, samples.adaptations[j].u).any()


def test_all_draws_lie_in_the_support(density: Posterior, samples: Samples) -> None:
    """No draw has log density −inf, and shapes are ensembles × steps × walkers × parameters."""
    assert samples.chains.shape == (4, samples.diagnosis.steps, 32, 3)
    assert samples.names == density.names
    assert np.isfinite(density.log_density(samples.chains.reshape(-1, 3))).all()
    assert samples.acceptance.shape == (4, 32)


def weighted_prior(density: Posterior, n: int) -> tuple[FloatArray, FloatArray]:
    """Draws of the prior and their normalised importance weights."""
    x = density.prior.sample(n, np.random.default_rng(11))
    _, likelihood = density.log_prior_and_likelihood(x)
    weights = np.exp(likelihood - likelihood.max())
    return x, weights / weights.sum()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("free", "noise"),
    [
        (("c", "phi", "K"), {"drawbar_pull": 6.0, "resistance_moment": 1.0, "sinkage": 5e-3}),
        (
            ("n0", "phi"),
            {
                "drawbar_pull": 5.0,
                "resistance_moment": Noise("resistance_moment", law=Law("halfnorm", {"scale": 1.5}, lower=0.2)),
                "sinkage": 8e-3,
            },
        ),
    ],
    ids=("three parameters", "two and a noise"),
)
@pytest.mark.parametrize("drive", ["load", "sinkage"])
def test_draws_agree_with_importance_sampling_from_the_prior(
    drive: str, free: tuple[str, ...], noise: dict[str, float | Noise], make_study: MakeStudy
) -> None:
    """Means, variances and evidence are those of weighted prior draws within 4 Monte Carlo errors."""
    noise = {**noise, "normal_force": 30.0}
    density = posterior(make_study(free=free, noise=noise, drive=drive))
    samples = sampled(density, 3, SamplingOptions(target_ess=4000, walkers=64, max_steps=2000), PLAN)
    assert samples.diagnosis.converged
    x, weights = weighted_prior(density, 150_000)
    centre = weights @ x
    for power in (1, 2):
        theirs, ours = (x - centre) ** power, (samples.chains - centre) ** power
        expected = weights @ theirs
        error = np.sqrt(weights**2 @ (theirs - expected) ** 2)
        own = ours.std(axis=(0, 1, 2)) / np.sqrt([effective_size(ours[..., i]) for i in range(x.shape[1])])
        assert np.abs((ours.mean(axis=(0, 1, 2)) - expected) / np.hypot(error, own)).max() < 4.0
    _, likelihood = density.log_prior_and_likelihood(x)
    mean, spread = np.exp(likelihood - likelihood.max()).mean(), np.exp(likelihood - likelihood.max()).std()
    evidence = np.mean([a.log_evidence for a in samples.adaptations])
    assert evidence == pytest.approx(np.log(mean) + likelihood.max(), abs=4 * spread / mean / np.sqrt(len(x)) + 0.05)


def test_a_run_ends_once_it_is_enough(density: Posterior, short_rounds: int) -> None:
    """Every round is judged whole, R-hat and all, and the first that is enough is the last."""
    asked = list[Diagnosis]()

    def enough(diagnosis: Diagnosis) -> bool:
        asked.append(diagnosis)
        return len(asked) == 2

    options = SamplingOptions(target_ess=1_000_000, walkers=32, max_steps=4 * short_rounds)
    samples = sample(density, options, SeedSequence(2), adaptation=QUICK, enough=enough)
    assert [diagnosis.steps for diagnosis in asked] == [short_rounds, 2 * short_rounds]
    assert np.isfinite([diagnosis.r_hat for diagnosis in asked]).all()
    assert samples.chains.shape[1] == 2 * short_rounds
    assert not samples.diagnosis.converged


def test_a_run_out_of_steps_says_so(density: Posterior, short_rounds: int) -> None:
    """At the last step without the draws asked for, the verdict is no and names the check that failed."""
    options = SamplingOptions(target_ess=1_000_000, walkers=32, max_steps=short_rounds + 30)
    samples = sampled(density, 1, options)
    assert samples.diagnosis.steps == short_rounds + 30
    assert not samples.diagnosis.converged
    failed = [check for check in samples.diagnosis.checks if not check.passed]
    assert failed[0].name == "effective draws"
    assert "run longer" in failed[0].advice


def test_sampling_stops_when_the_draws_are_there(density: Posterior, short_rounds: int) -> None:
    """A modest demand is met in whole rounds, long before the last step; more draws extend the same chain."""
    samples = sampled(density, 1, SamplingOptions(target_ess=500, walkers=32, max_steps=5000), PLAN)
    assert samples.diagnosis.converged
    assert samples.diagnosis.steps % short_rounds == 0
    longer = sampled(density, 1, SamplingOptions(target_ess=15_000, walkers=32, max_steps=5000), PLAN)
    assert longer.diagnosis.steps > samples.diagnosis.steps
    np.testing.assert_array_equal(longer.chains[:, : samples.diagnosis.steps], samples.chains)


def test_long_runs_are_diagnosed_less_often(density: Posterior, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every round at first but those too early to do, then every second, every third; and always the last."""
    monkeypatch.setattr(sampler, "ROUND_STEPS", 5)
    monkeypatch.setattr(sampler, "SOONEST", 10)
    monkeypatch.setattr(sampler, "DENSE_ROUNDS", 4)
    seen: list[int] = []

    def watch(progress: Progress) -> None:
        if progress.stage == "sampling" and progress.diagnosis is not None:
            seen.append(progress.diagnosis.steps // 5)

    options = SamplingOptions(target_ess=1_000_000, walkers=32, max_steps=85)
    sample(density, options, SeedSequence(1), watch, QUICK)
    assert seen == [2, 3, 4, 5, 6, 7, 8, 10, 12, 15, 16, 17]


def test_progress_is_reported_stage_by_stage(density: Posterior) -> None:
    """Adaptation first, step by step, then one report per round with its diagnosis; the last is complete."""
    reports: list[Progress] = []
    sample(density, SMALL, SeedSequence(1), reports.append, QUICK)
    assert [stage for stage, _ in groupby(r.stage for r in reports)] == ["adapting", "sampling"]
    rounds = [r for r in reports if r.stage == "sampling"]
    assert reports[-1].done == 1.0
    assert all(r.diagnosis is not None and r.seconds_left is not None for r in rounds)


def test_adaptation_ends_before_draws_are_kept(density: Posterior, monkeypatch: pytest.MonkeyPatch) -> None:
    """Once the first kept step is taken no mixture is fitted any more."""
    log: list[str] = []
    segment = Ensemble.segment

    def fit(*given: Any, **options: Any) -> StudentMixture:
        log.append("fit")
        return fit_mixture(*given, **options)

    monkeypatch.setattr("bayesterra.stats.transport.fit_mixture", fit)

    def watched(self: Ensemble, steps: int) -> Segment:
        log.append("keep")
        return segment(self, steps)

    monkeypatch.setattr(Ensemble, "segment", watched)
    sampled(density, 1)
    assert "fit" in log
    assert "fit" not in log[log.index("keep") :]


def test_nothing_to_sample_is_said(make_study: MakeStudy) -> None:
    """A study whose parameters are all fixed is refused."""
    with pytest.raises(StudyError, match="every parameter is fixed: there is nothing to sample"):
        sampled(posterior(make_study(free=())), 1)


def test_no_support_is_said(make_study: MakeStudy) -> None:
    """A prior without support ends with the reason, out of the worker threads."""
    study = make_study(free=("c1",), priors={"c1": Law("uniform", lower=1.5, upper=2.0)})
    with pytest.raises(SupportError, match="θm outside"):
        sampled(posterior(study), 1)
