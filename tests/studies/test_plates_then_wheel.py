"""The stored study of plates and a wheel on one sand: what its README says follows from its tables."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

STORED = Path(__file__).parents[2] / "studies" / "soil-tests" / "plates-then-wheel"


@pytest.fixture(scope="module")
def runs() -> pd.DataFrame:
    """Runs by geometry and prior."""
    return pd.read_csv(STORED / "runs.csv").set_index(["geometry", "prior"])


def test_plates_decide_between_the_geometries(runs: pd.DataFrame) -> None:
    """All runs converged; the plates' prior suits the wider geometry by far."""
    assert runs["converged"].all()
    evidence = runs["log_evidence"].to_dict()
    wide, narrow = ("cmu-grouser-wide", "plates"), ("cmu-grouser", "plates")
    assert evidence[wide] - evidence[narrow] > 8
    assert evidence[narrow] < evidence["cmu-grouser", "box"] - 3
    assert evidence[wide] > evidence["cmu-grouser-wide", "box"] + 3


def test_the_wheel_adds_nothing_about_the_moduli() -> None:
    """With either geometry the plates' moduli keep their spread; the narrower one moves the zero error."""
    table = pd.read_csv(STORED / "parameters.csv").query("prior == 'plates'")
    moduli = table[table["parameter"].isin(["kc", "kphi", "n0"])]
    assert len(moduli) == 6
    assert np.allclose(moduli["sd"] / moduli["prior_sd"], 1.0, atol=0.1)
    offset = table[table["parameter"] == "sinkage_offset"].set_index("geometry")
    shift = (offset["median"] - offset["prior_mean"]) / offset["prior_sd"]
    assert shift["cmu-grouser"] < -2.4
    assert abs(shift["cmu-grouser-wide"]) < 0.5
