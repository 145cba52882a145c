"""Agreement between samplers: what counts as one, and who is not called wrong."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.random import SeedSequence, default_rng
from scipy.special import logsumexp

from bayesterra.analysis import inference
from bayesterra.analysis.inference import run
from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError
from bayesterra.likelihood.joint import joint_posterior
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.sampling import evidence as nested
from bayesterra.sampling.evidence import CrossCheck, Weighted, against_nested, compare
from bayesterra.sampling.sampler import Samples, sample, thin
from bayesterra.stats.diagnostics import effective_size
from bayesterra.stats.mixture import normalised, weighted_quantiles
from bayesterra.study.result import Result
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study

pytestmark = pytest.mark.usefixtures("little_adaptation")

NAMES = ("a", "b")
N = 4000


def draws(seed: int, shift: float = 0.0, scale: float = 1.0) -> FloatArray:
    """Normal draws (N, 2), the second parameter moved or stretched."""
    x = default_rng(seed).standard_normal((N, 2))
    x[:, 1] = shift + scale * x[:, 1]
    return x


def equal(name: str, x: FloatArray, log_z: float, error: float) -> Weighted:
    """Independent draws of equal weight."""
    return Weighted.independent(name, x, np.full(len(x), 1 / len(x)), log_z, error)


def three(one: FloatArray, other: FloatArray, third: FloatArray, log_z: float = 0.0) -> CrossCheck:
    """Ours and two nested runs; the evidence of the last is ``log_z``."""
    ours = equal("ours", one, 0.0, 0.02)
    first = equal("nested (500)", other, 0.01, 0.1)
    return compare((ours, first, equal("nested (1500)", third, log_z, 0.06)), NAMES)


def test_samplers_of_one_law_agree() -> None:
    """Draws of the same law agree on every statistic; of many repetitions few come near 4 errors."""
    worst = [three(draws(3 * k), draws(3 * k + 1), draws(3 * k + 2)).table["z"].abs().max() for k in range(40)]
    assert np.mean(np.array(worst) > 4.0) < 0.05
    assert np.median(worst) > 1.5


@pytest.mark.parametrize("wrong", [{"shift": 0.15}, {"scale": 1.2}])
def test_a_difference_is_found_without_saying_who_errs(wrong: dict[str, float]) -> None:
    """Shifted or stretched draws disagree, named by parameter; both nested runs stand against ours."""
    found = three(draws(1), draws(2, **wrong), draws(3, **wrong))
    assert found.verdict == "disagree"
    assert "of b" in found.worst
    assert "errors between" in found.worst


def test_nested_runs_that_differ_are_no_judge() -> None:
    """Where the two settings of nested sampling differ from each other, that is the verdict."""
    assert three(draws(1), draws(2), draws(3, shift=0.3)).verdict == "nested sampling disagrees with itself"


def test_the_evidence_is_compared_too() -> None:
    """An evidence off by ten errors is a disagreement even where all draws agree."""
    found = three(draws(1), draws(2), draws(3), log_z=1.2)
    assert found.worst.startswith("log evidence")
    assert found.verdict != "agree"


def test_weights_count() -> None:
    """Draws of a wide law weighed to a narrow one agree with draws of the narrow one."""
    wide = 2.0 * draws(5)
    log_weights = -0.5 * (wide**2).sum(axis=1) * (1 - 1 / 4)
    weights = np.exp(log_weights - log_weights.max())
    weights /= weights.sum()
    nested = Weighted.independent("nested", wide, weights, 0.0, 0.1)
    assert compare((equal("ours", draws(6), 0.0, 0.01), nested), NAMES).verdict == "agree"
    unweighted = equal("nested", wide, 0.0, 0.1)
    assert compare((equal("ours", draws(6), 0.0, 0.01), unweighted), NAMES).verdict != "agree"


def walk(seed: int, memory: float) -> FloatArray:
    """Chains (4, 500, 8, 2) of a standard normal law, whose steps remember the one before."""
    noise = default_rng(seed).standard_normal((4, 500, 8, 2))
    for step in range(1, 500):
        noise[:, step] = memory * noise[:, step - 1] + np.sqrt(1 - memory**2) * noise[:, step]
    return noise


def test_draws_that_hang_together_count_for_as_many_as_they_are_worth() -> None:
    """Chains of memory 0.8 have a ninth of their draws: z against independent draws is a standard score."""
    z = []
    for k in range(60):
        ours = Weighted.of_ensembles("ours", walk(k, 0.8), None)
        assert 1200 < ours.sizes[0, 0] < 2400
        assert (ours.sizes[:, 1:] > 0.8 * ours.sizes[:, :1]).all()
        table = compare((ours, equal("nested", draws(1000 + k), 0.0, 0.1)), NAMES).table
        assert "log evidence" not in set(table["statistic"])
        z.append(table["z"].to_numpy())
    assert 0.8 < np.std(z) < 1.25


def test_every_setting_is_run_with_a_stream_of_its_own(
    make_study: Callable[..., Study], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Two numbers of live points, two streams; every parameter, four statistics and the evidence compared."""
    streams: list[tuple[int, tuple[int, ...]]] = []
    stages: list[str] = []

    def fake(target: Posterior, live: int, seed: SeedSequence) -> Weighted:
        streams.append((live, seed.spawn_key))
        return equal(f"nested ({live})", draws(live), 0.0, 0.1)

    monkeypatch.setattr(nested, "nested", fake)
    target = posterior(make_study(free=("c", "phi")))
    ours = equal("bayesterra", draws(1), 0.0, 0.01)
    found = against_nested(target, ours, SeedSequence(1), report=stages.append)
    assert [live for live, _ in streams] == [500, 1500]
    assert len({key for _, key in streams}) == 2
    assert stages == ["nested sampling, 500 live points", "nested sampling, 1500 live points"]
    assert len(found.table) == 3 * (1 + 2 * 4)
    assert set(found.table["parameter"]) == {"", "c", "phi"}
    assert found.verdict == "agree"


@pytest.mark.slow
def test_a_run_counts_its_draws_for_what_they_are_worth(
    make_study: Callable[..., Study], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its kept draws are no independent ones: each statistic has the size that their chains give it."""
    sampled, taken = list[Samples](), list[Weighted]()

    def noted(*given: Any, **more: Any) -> Samples:
        sampled.append(sample(*given, **more))
        return sampled[-1]

    def judged(target: Posterior, ours: Weighted, seed: SeedSequence, report: object) -> CrossCheck:
        taken.append(ours)
        return three(draws(1), draws(2), draws(3))

    monkeypatch.setattr(inference, "sample", noted)
    monkeypatch.setattr(nested, "check_installed", lambda: None)
    monkeypatch.setattr(nested, "against_nested", judged)
    options = SamplingOptions(target_ess=400, walkers=32)
    result = run(make_study(free=("c", "phi"), sampling=options), crosscheck=True)
    kept = result.draws["posterior"]["phi"]
    chains = sampled[0].chains
    chains = chains[:, :: thin(chains).every]
    assert taken[0].x.shape == (kept.size, 2) == (chains[..., 0].size, 2)
    assert taken[0].sizes[1, 0] == pytest.approx(effective_size(chains[..., 1]), rel=0.01)
    assert taken[0].sizes[1, 0] != kept.size
    assert result.record["crosscheck"]["verdict"] == "agree"


def test_what_is_not_installed_is_said_before_anything_runs(
    make_study: Callable[..., Study], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without dynesty the message says how to get it."""
    monkeypatch.setattr(nested, "find_spec", lambda name: None)
    with pytest.raises(StudyError, match=r"'--crosscheck' needs dynesty: pip install 'bayesterra\[crosscheck\]'"):
        run(make_study(free=("c", "phi")), crosscheck=True)


@pytest.mark.slow
def test_the_report_states_the_verdict(small_result: Result) -> None:
    """Verdict, greatest difference and limit stand in the section on sampling."""
    found = three(draws(1), draws(2, shift=0.15), draws(3, shift=0.15)).record()
    page = replace(small_result, record={**small_result.record, "crosscheck": found}).page().html()
    assert "two settings: <b>disagree</b>" in page
    assert found["worst"] in page
    assert "two settings" not in small_result.page().html()


@pytest.mark.slow
def test_groups_are_sampled_from_the_cube_of_their_prior(make: Callable[..., Study]) -> None:
    """Evidence and quantiles of a joint posterior with a population, against weighted draws of its prior."""
    joint = joint_posterior(make(noise={"drawbar_pull": 5.0, "resistance_moment": 1.5}))
    x = joint.prior.sample(200_000, default_rng(1))
    level = joint.log_prior_and_likelihood(x)[1]
    weights = normalised(level)
    assert 1 / (weights**2).sum() > 500
    found = nested.nested(joint, 300, SeedSequence(2))
    evidence = float(logsumexp(level) - np.log(len(x)))
    assert found.log_z == pytest.approx(evidence, abs=4 * found.error + 0.1)
    expected, quantiles = (weighted_quantiles(of, w, (0.05, 0.5, 0.95))
                           for of, w in ((x, weights), (found.x, found.weights)))  # fmt: skip
    assert (np.abs(quantiles - expected) < 0.15 * (expected[2] - expected[0])).all()
