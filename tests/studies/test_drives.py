"""The three drives on one wheel: a short run now, the stored study checked."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence

from bayesterra.likelihood.posterior import posterior
from bayesterra.parameters import PARAMETERS
from bayesterra.sampling.sampler import sample
from bayesterra.study.schema import SamplingOptions

STUDY = Path(__file__).parents[2] / "studies" / "recovery" / "drives"


@pytest.mark.slow
def test_a_short_run_agrees_with_the_stored_study(study_script: Callable[[str], ModuleType]) -> None:
    """Posterior medians of drive ``both`` are the stored ones within their Monte Carlo errors."""
    density = posterior(study_script("recovery/drives").study("both"))
    options = SamplingOptions(walkers=32, target_ess=400)
    draws = sample(density, options, SeedSequence(5)).chains.reshape(-1, len(density.names))
    table = pd.read_csv(STUDY / "drives.csv").set_index(["drive", "parameter"]).loc["both"]
    stored = table.loc[list(density.names)]
    scales = np.array([PARAMETERS[name].scale for name in density.names])
    away = (np.median(draws, axis=0) / scales - stored["median"]) / stored["sd"]
    assert np.abs(away).max() < 0.3


def test_the_stored_study_holds() -> None:
    """All drives converged; a load with an error changes little, an exact sinkage much."""
    table = pd.read_csv(STUDY / "drives.csv").set_index(["drive", "parameter"])
    assert table["converged"].all()
    load, both, sinkage = (table.loc[drive].loc[["n1", "c1", "c2"]] for drive in ("load", "both", "sinkage"))
    assert (np.abs(both["median"] - load["median"]) < 0.1 * load["sd"]).all()
    assert (sinkage["sd"] < 0.75 * load["sd"]).all()
