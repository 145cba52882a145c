"""Claims of the paper and Wh31's readings: pages from the stored tables, some figures remade."""

import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from readme import filled

PAPER = Path(__file__).parents[2] / "studies" / "paper"


@pytest.fixture(scope="module")
def claims(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The script of the claims."""
    return study_script("paper/claims")


@pytest.fixture(scope="module")
def readings(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The script of the readings."""
    return study_script("paper/readings")


def test_the_page_of_claims_is_remade(claims: ModuleType) -> None:
    """README and table follow from the stored figures, with a verdict for each of at least 25 claims."""
    text = (PAPER / "claims" / "README.md").read_text(encoding="utf-8")
    assert claims.page(text) == text
    stored = pd.read_csv(PAPER / "claims" / "claims.csv")
    assert len(stored) >= 25
    assert stored[["claim", "threshold", "full", "verdict"]].notna().all().all()
    assert {"confirmed", "refuted", "not decided"} <= set(stored["verdict"])


def test_nats_are_those_of_an_independent_computation(claims: ModuleType) -> None:
    """About G1: figures that were computed elsewhere without this package, others unknown and known."""
    near = claims.measures.near("G1")
    assert near.nats("P_I", 1.0, (0,)) == pytest.approx(3.53, abs=0.1)
    assert near.nats("P_II", 1.0, (2,)) == pytest.approx(3.99, abs=0.1)
    assert near.nats("P_I", 1.0, (2,), [0, 1, 2]) == pytest.approx(2.9, abs=0.1)
    assert near.mutual("P_I", "P_III", 1.0) == pytest.approx(1.76, abs=0.1)
    assert (near.contractions("P_III", 0.25) > 0.9).all()


def test_readings_are_had_back(readings: ModuleType) -> None:
    """The stored readings meet the printed errors; readings that are known come back from their own errors."""
    stored = pd.read_csv(PAPER / "readings" / "readings.csv")
    recover = sys.modules["recover"]
    predicted = recover.predictions()[..., 2]
    best = stored.query("channel == 'resistance_moment'")["best"].to_numpy()
    away = np.abs(recover.errors(best[None], predicted)[0] - recover.PRINTED[:, 2])
    assert away.mean() < 0.1
    true = predicted[0] * 1.02
    own = recover.errors(true[None], predicted)[0]
    found = recover.recover(predicted, own, predicted[0], np.random.default_rng(1), particles=500, sweeps=4)
    assert found.misfit.min() < 0.5
    assert found.best[-1] == pytest.approx(true[-1], rel=0.02)
    text = (PAPER / "readings" / "README.md").read_text(encoding="utf-8")
    assert filled(text, readings.blocks(readings.stored())) == text
