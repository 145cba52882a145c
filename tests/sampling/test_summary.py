"""The summary table: every number of a row is that of its own draws, before and after the readings."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.posterior import posterior
from bayesterra.report.verdicts import Failures
from bayesterra.sampling.summary import summary_table
from bayesterra.stats.diagnostics import Diagnosis
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]
UNITS = {"c": 1e3, "phi": float(np.radians(1.0))}


@pytest.fixture(scope="module")
def chains() -> FloatArray:
    """Draws (4, 250, 2) of c and φ, skew enough that mean and median differ."""
    rng = np.random.default_rng(1)
    return np.array([200.0, 0.5]) + np.array([60.0, 0.01]) * rng.exponential(size=(4, 250, 2))


@pytest.fixture(scope="module")
def prior() -> FloatArray:
    """Draws (900, 2) of a skew prior."""
    rng = np.random.default_rng(2)
    return np.array([50.0, 0.35]) + np.array([300.0, 0.05]) * rng.exponential(size=(900, 2))


@pytest.fixture(scope="module")
def rows(make_study: MakeStudy, chains: FloatArray, prior: FloatArray) -> pd.DataFrame:
    """The table of these draws, whose diagnosis has a number of its own in every place."""
    study = make_study(free=("c", "phi"))
    bulk, tail, r_hat = np.array([[411.0, 422.0], [511.0, 522.0], [1.01, 1.02]])
    diagnosis = Diagnosis(("c", "phi"), bulk, tail, r_hat, np.ones(2), 0.4, 100, ())
    mode = np.array([205.0, 0.501])
    table = summary_table(study, posterior(study), chains, prior, mode, diagnosis, Failures())
    return table.set_index("parameter")


def described(rows: pd.DataFrame, name: str, draws: FloatArray, before: FloatArray, mode: float) -> None:
    """Assert that a row has the moments of draws, after and before the readings; field units."""
    row = rows.loc[[name]].iloc[0]
    expected = [mode, draws.mean(), np.median(draws), draws.std(), before.mean(), before.std()]
    columns = ["mode", "mean", "median", "sd", "prior_mean", "prior_sd"]
    np.testing.assert_allclose(row[columns].to_numpy(float), expected, rtol=1e-9)
    inside = (draws >= row["hdi90_lo"]) & (draws <= row["hdi90_hi"])
    assert inside.mean() == pytest.approx(0.9, abs=0.01)


def test_rows_of_parameters_are_those_of_their_draws(rows: pd.DataFrame, chains: FloatArray, prior: FloatArray) -> None:
    """Moments after and before, the mode, and each figure of the diagnosis in its own column."""
    for i, (name, scale) in enumerate(UNITS.items()):
        mode = (205.0, 0.501)[i] / scale
        described(rows, name, chains[:, :, i].ravel() / scale, prior[:, i] / scale, mode)
    assert rows.loc[["c", "phi"], "ess_bulk"].tolist() == [411.0, 422.0]
    assert rows.loc[["c", "phi"], "ess_tail"].tolist() == [511.0, 522.0]
    assert rows.loc[["c", "phi"], "r_hat"].tolist() == [1.01, 1.02]


def test_a_derived_row_is_that_of_its_quantity_before_and_after(
    rows: pd.DataFrame, chains: FloatArray, prior: FloatArray
) -> None:
    """Shear strength under 5 kPa, c + σ tan φ, by hand: of the draws, of the prior's, and at the mode."""

    def strength(x: FloatArray) -> FloatArray:
        return np.asarray(x[..., 0] / 1e3 + 5.0 * np.tan(x[..., 1]))

    mode = float(strength(np.array([205.0, 0.501])))
    described(rows, "shear_strength", strength(chains).ravel(), strength(prior), mode)
