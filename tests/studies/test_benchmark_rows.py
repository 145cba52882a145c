"""The stored costs from ten rows to ten thousand: what the README says of them, and the exact path once more."""

from pathlib import Path
from types import ModuleType
from unittest.mock import patch

import numpy as np
import pandas as pd
import pytest
from scripts import loaded

import bayesterra as bt
from bayesterra.likelihood.forward import Nodes
from bayesterra.likelihood.posterior import draw_cut_prior

STUDY = Path(__file__).parents[2] / "studies" / "benchmarks" / "rows"


@pytest.fixture(scope="module")
def script() -> ModuleType:
    """The study's script."""
    return loaded(STUDY / "run.py")


def test_the_readme_says_what_is_stored(script: ModuleType) -> None:
    """All three tables, with every size of both kinds."""
    assert script.table() in (STUDY / "README.md").read_text(encoding="utf-8")
    stored = pd.read_csv(STUDY / "cost.csv")
    assert set(stored[["kind", "rows"]].itertuples(index=False, name=None)) == {
        (kind, rows) for kind in script.LOADS for rows in script.ROWS
    }
    assert (stored["exit"] == 0).all()
    assert stored["converged"].all()


def test_many_rows_left_the_posterior_right() -> None:
    """Against the model at every row, and against a long run."""
    exact, long = pd.read_csv(STUDY / "exact.csv"), pd.read_csv(STUDY / "long.csv")
    assert (exact["moved"] < 0.01).all()
    assert (exact["spread"] < 0.01).all()
    assert (long["worst"] < 4.5).all()
    assert (long["rms"] < 1.6).all()


def test_the_exact_path_says_the_same_today(script: ModuleType) -> None:
    """Of soils near the truth of 100 rows, told by nodes: their log likelihoods to a thousandth."""
    study = script.study("one load", 100)
    told = bt.posterior(study)
    x = draw_cut_prior(told, 3000, np.random.default_rng(1)).x
    x = x[np.argsort(-told.log_density(x))[:20]]
    with patch.object(Nodes, "of", lambda *_, **__: None):
        exact = bt.posterior(study)
        assert told.likelihood.forward.nodes is not None
        assert exact.likelihood.forward.nodes is None
        np.testing.assert_allclose(told.log_density(x), exact.log_density(x), rtol=1e-6, atol=1e-3)
