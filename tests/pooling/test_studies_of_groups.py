"""Studies with several wheels: the stored results hold, and a part is made again."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng

from bayesterra.parameters import PARAMETERS
from bayesterra.pooling.joint import joint_posterior

STORED = Path(__file__).parents[2] / "studies" / "many-wheels"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("many-wheels")


def _table(name: str, case: str) -> pd.DataFrame:
    table = pd.read_csv(STORED / f"{name}.csv")
    return table[table["case"] == case].reset_index(drop=True)


def test_one_soil_is_recovered(script: ModuleType) -> None:
    """38 parameters, converged; intervals hold what they should, and c and φ are the soil's."""
    recovery, costs = _table("recovery", "one-soil"), _table("costs", "one-soil")
    assert len(recovery) == 38
    assert costs["converged"].all()
    assert recovery["inside"].mean() >= 0.75
    verdicts = _table("sharing", "one-soil").set_index("parameter")["verdict"]
    assert verdicts["c and phi"] == "soil constant"


def test_stored_medians_fit_the_readings(script: ModuleType) -> None:
    """The readings made now are those of the stored run: its true values are likely, and where it says."""
    study, recovery = script.simulated("one-soil"), _table("recovery", "one-soil").set_index("parameter")
    joint = joint_posterior(study)
    scale = np.array([PARAMETERS[name.split("[")[0]].scale for name in joint.names])
    truth = recovery.loc[list(joint.names), "truth"].to_numpy() * scale
    assert np.isfinite(joint.log_density(truth[None])[0])
    D, L = joint.split(truth[None])
    readings = sum(int(np.isfinite(one.likelihood.measured).sum()) for one in joint.groups.values())
    level = sum(
        joint.log_likelihood_of_group(group, D, own)[0] for group, own in zip(joint.groups, L, strict=True)
    )
    noise = np.log(np.array(list(script.NOISE.values())) * np.sqrt(2 * np.pi))
    chi_square = -2.0 * (level + noise.mean() * readings)
    assert chi_square == pytest.approx(readings, abs=4.5 * np.sqrt(2 * readings))


def test_a_replication_has_the_readings_of_its_truth(study_script: Callable[[str], ModuleType]) -> None:
    """Truth inside the support, its readings within noise, none of them those of the conditions."""
    calibration = study_script("calibration-groups")
    truth, joint = calibration.replicated(calibration.conditions(), default_rng(1))
    assert truth.shape == (1, len(joint.names)) == (1, 16)
    assert np.isfinite(joint.log_density(truth)).all()
    D, L = joint.split(truth)
    for own, (group, posterior) in zip(L, joint.groups.items(), strict=True):
        x = joint.of_group(D, own)
        outcomes = posterior.likelihood.predicted(posterior.outcomes(x))[0]
        z = (posterior.likelihood.measured - outcomes) / np.array([0.001, 1.5, 0.3])
        assert np.abs(z).max() < 5.0
        assert np.abs(z).max() > 0.1
        assert group in calibration.WHEELS
