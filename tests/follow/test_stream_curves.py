"""Rows that hang together, one after the other: a discrepancy and errors of slip."""

from copy import deepcopy
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.special import logsumexp
from scipy.stats import norm

import bayesterra as bt
from bayesterra.errors import StudyError
from bayesterra.follow.rows import Update
from bayesterra.follow.stream import load_stream
from bayesterra.likelihood.posterior import posterior
from bayesterra.study.study import Study
from tests.support.joint_rows import HELD, RIPPLE, joined

ROWS = pd.DataFrame(
    {
        "wheel": "A",
        "slip": [0.15, 0.2, 0.3, 0.35, 0.45],
        "load [N]": 80.0,
        "sinkage [mm]": [8.2, 10.2, 14.0, 16.5, 22.0],
        "drawbar_pull [N]": [16.5, 19.0, 20.5, 21.2, 21.5],
        "resistance_moment [N m]": [4.2, 4.8, 5.3, 5.5, 5.6],
    }
)
CURVE = {"drawbar_pull": {"sd": 2.0, "length": 0.3}}
KNOWN = {name: value for name, value in HELD.items() if name != "phi"}
GRID = np.linspace(0.3, 0.7, 801)
Followed = tuple[bt.Stream, list[Update]]


def study(rows: int = len(ROWS), **tables: Any) -> Study:
    """The first rows with φ free; a curve of discrepancy and errors of slip."""
    errors = tables or {"discrepancy": CURVE, "slip": {"sd": 0.005}}
    priors = {**KNOWN, "phi": {"dist": "norm", "loc": 0.5, "scale": 0.05}}
    return joined(data=ROWS[:rows], **errors, priors=priors)


def level(rows: int) -> np.ndarray[Any, Any]:
    """Log density over φ of the batch of the first rows."""
    return posterior(study(rows)).log_density(GRID[:, None])


@pytest.fixture(name="followed", scope="module")
def fixture_followed() -> Followed:
    """Four rows, and what came of each."""
    stream = bt.Stream(study(), particles=2000)
    return stream, [stream.add(row) for _, row in ROWS[:4].iterrows()]


def test_rows_add_up_to_their_batch(followed: Followed) -> None:
    """Evidence and law of φ, against sums over a grid; the likelihood of every particle."""
    stream, updates = followed
    for rows in (1, 4):
        exact = logsumexp(level(rows)) + np.log(GRID[1] - GRID[0])
        update = updates[rows - 1]
        assert update.log_evidence == pytest.approx(exact, abs=4 * update.log_evidence_error + 0.01)
    density = np.exp(level(4) - logsumexp(level(4)))
    mean = density @ GRID
    sd = np.sqrt(density @ (GRID - mean) ** 2)
    low, middle, high = updates[-1].quantiles[:, 0]
    assert middle == pytest.approx(mean, abs=0.15 * sd)
    assert (high - low) / (2 * norm.ppf(0.95)) == pytest.approx(sd, rel=0.1)
    whole = posterior(study(4)).log_prior_and_likelihood(stream.cloud.x)[1]
    np.testing.assert_allclose(stream.cloud.log_likelihood, whole, atol=1e-7)


def test_a_row_is_expected_given_the_rows_before(followed: Followed) -> None:
    """By the law that it has beside them, not by the model alone."""
    stream = deepcopy(followed[0])
    before, update = stream.cloud, stream.add(ROWS.iloc[4])
    density = posterior(study())
    law = density.likelihood.joint_law(density.prior.soil_values(before.x), np.empty((len(before.x), 0)))
    assert law is not None
    scores = law.scores(density.likelihood.measured)[:, 4]
    below = dict(zip(density.likelihood.channels, before.weights @ norm.cdf(scores), strict=True))
    assert 0.01 < below["drawbar_pull"] < 0.99
    assert update.pit == pytest.approx(below, abs=0.02)


def test_a_stream_is_put_down_and_taken_up(followed: Followed, tmp_path: Path) -> None:
    """It goes on to the last bit; changes of soil are not looked for, and that is said."""
    stream = deepcopy(followed[0])
    stream.save(tmp_path / "stream")
    updates = [each.add(ROWS.iloc[4]) for each in (stream, load_stream(tmp_path / "stream"))]
    np.testing.assert_array_equal(updates[0].quantiles, updates[1].quantiles)
    assert "Changes of soil were not looked for." in str(stream.overview())


def test_ripple_is_refused() -> None:
    """A stream has no sweeps."""
    with pytest.raises(StudyError, match=r"^following row by row knows no sweeps, along which \[ripple\] runs"):
        bt.Stream(study(ripple=RIPPLE))
