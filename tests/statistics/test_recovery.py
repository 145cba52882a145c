"""Simulated data give the truth back: the quick version, on a few parameters of every model."""

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd
import pytest

from bayesterra.analysis.simulation import simulate
from bayesterra.arrays import FloatArray
from bayesterra.likelihood.posterior import posterior
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.sampler import sample
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]
FREE = ("n0", "n1", "c", "phi", "K")
OPTIONS = SamplingOptions(target_ess=1500, walkers=32, max_steps=1000)
PLAN = AdaptationOptions(particles=512, components=8)


def credible_level(study: Study, truth: Mapping[str, float], seed: int) -> float:
    """Share of posterior draws that are denser than the truth."""
    density = posterior(study)
    samples = sample(density, OPTIONS, np.random.SeedSequence(seed), adaptation=PLAN)
    assert samples.diagnosis.converged
    levels = density.log_density(samples.chains.reshape(-1, len(density.names)))
    true: FloatArray = np.array([[truth[name] for name in density.names]])
    return float(np.mean(levels > density.log_density(true)[0]))


def simulated(study: Study, make_study: MakeStudy, truth: Mapping[str, float], seed: int) -> Study:
    """The same study on data simulated with the truth."""
    data = simulate(study, truth, seed)
    return make_study(model=study.model.name, drive=study.drive, free=FREE, data=data)


@pytest.mark.slow
@pytest.mark.parametrize("drive", ["load", "sinkage"])
@pytest.mark.parametrize("model", ["M1", "M2", "M3"])
def test_the_truth_lies_in_the_joint_region(
    model: str, drive: str, make_study: MakeStudy, truth: Mapping[str, float]
) -> None:
    """The parameters that made the data lie inside the joint 99.9 % region, in both drives."""
    study = make_study(model=model, drive=drive, free=FREE)
    assert credible_level(simulated(study, make_study, truth, 1), truth, 1) < 0.999


@pytest.mark.slow
def test_sinkage_noise_breaks_the_sinkage_drive(
    make_study: MakeStudy, make_table: Callable[..., pd.DataFrame], truth: Mapping[str, float]
) -> None:
    """Conditioning on a sinkage that carries 1 mm of noise puts the truth outside, as the drive must."""
    table = make_table("M1")
    table["sinkage [m]"] += 1e-3 * np.random.default_rng(1).standard_normal(len(table))
    study = make_study(model="M1", drive="sinkage", free=FREE, data=table)
    assert credible_level(study, truth, 1) > 0.999
