"""Reference posteriors of the eight-parameter M1 problem, made by two methods, and a default run."""

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from numpy.random import SeedSequence

from bayesterra.sampling.sampler import sample

STUDY = Path(__file__).parents[2] / "studies" / "benchmarks" / "samplers"
DRIVES = ["load", "sinkage"]


@pytest.fixture
def measures(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The study's module of references and measures."""
    monkeypatch.syspath_prepend(str(STUDY))
    return importlib.import_module("measures")


@pytest.fixture
def problems(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The study's module of posteriors."""
    monkeypatch.syspath_prepend(str(STUDY))
    return importlib.import_module("problems")


@pytest.mark.slow
@pytest.mark.parametrize("drive", DRIVES)
def test_a_default_run_agrees_with_the_reference(drive: str, measures: ModuleType, problems: ModuleType) -> None:
    """Mean and 5, 50, 95 % points of eight parameters lie within 4 Monte Carlo errors of the reference."""
    study = problems.simulated_study(drive)
    samples = sample(problems.Problem(study).target.posterior, study.sampling, SeedSequence(11))
    found = measures.of_ensembles(samples.chains, measures.Reference.load(drive))
    assert samples.diagnosis.converged
    assert np.abs(found.errors).shape == (4, 8)
    assert found.worst < measures.LIMIT


@pytest.mark.parametrize("drive", DRIVES)
def test_both_methods_agreed_on_the_reference(drive: str, measures: ModuleType) -> None:
    """Long runs and importance sampling differ by less than 4 Monte Carlo errors in all 32 statistics."""
    with np.load(STUDY / f"reference-{drive}.npz") as stored:
        checks = {name: float(stored[name]) for name in stored.files if stored[name].ndim == 0}
        assert stored["draws"].shape == (10_000, 8)
    assert checks["worst_difference"] < measures.LIMIT
    assert checks["pareto_k"] < 0.7
    assert checks["long_run_r_hat"] < 1.01
    assert min(checks["long_run_ess"], checks["weighted_ess"]) > 50_000


@pytest.mark.parametrize("drive", DRIVES)
def test_reference_draws_are_nearly_independent(drive: str, measures: ModuleType) -> None:
    """By posteriordb's rules: R-hat below 1.01, lag-1 correlation below 0.05, statistics of the long run."""
    reference = measures.Reference.load(drive)
    found = measures.of_chains(reference.draws.reshape(10, -1, 8), reference)
    z = (reference.draws - reference.draws.mean(axis=0)) / reference.draws.std(axis=0)
    assert found.r_hat < 1.01
    assert np.abs((z[1:] * z[:-1]).mean(axis=0)).max() < 0.05
    assert found.worst < measures.LIMIT


@pytest.mark.parametrize("drive", DRIVES)
def test_draws_without_soft_soils_are_found_wrong(drive: str, measures: ModuleType) -> None:
    """Draws that miss the soils with K_s below 1 MPa, as nested samplers do, fail the comparison."""
    reference = measures.Reference.load(drive)
    soft = reference.draws[:, 0] < 1e6
    assert soft.mean() > 0.05
    found = measures.of_weighted(reference.draws[~soft], np.zeros((~soft).sum()), reference)
    assert not found.right
