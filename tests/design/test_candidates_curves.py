"""Candidate drives beside a discrepancy: what they would read given the readings that there are."""

from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayesterra.arrays import FloatArray
from bayesterra.design.candidates import Situation, candidates, readings_of
from bayesterra.design.choosing import choose
from bayesterra.likelihood.posterior import posterior
from bayesterra.study.study import Study
from tests.support.joint_rows import HELD, joined

ROWS = pd.DataFrame(
    {
        "wheel": "A",
        "slip": [0.2, 0.35],
        "load [N]": 80.0,
        "sinkage [mm]": [10.2, 16.5],
        "drawbar_pull [N]": [19.0, 21.2],
        "resistance_moment [N m]": [4.8, 5.5],
    }
)
NEW = {"wheel": "A", "slip": 0.4, "load [N]": 80.0, "sinkage [mm]": 19.0, "drawbar_pull [N]": 20.0}
CURVE = {"drawbar_pull": {"sd": {"estimate": {"dist": "halfnorm", "scale": 2.0}}, "length": 0.3}}


def study(data: pd.DataFrame = ROWS, **tables: Any) -> Study:
    """Two rows with a curve of unknown size and errors of slip; φ free."""
    return joined("phi", data=data, **{"discrepancy": CURVE, "slip": {"sd": 0.01}, **tables})


def draws() -> FloatArray:
    """Values of φ and of the size of the curve."""
    rng = np.random.default_rng(1)
    phi = HELD["phi"] * (1 + 0.05 * rng.standard_normal(300))
    return np.column_stack([phi, rng.uniform(0.5, 3.0, 300)])


def test_a_candidate_has_the_law_that_it_adds_to_the_table() -> None:
    """The log likelihood with the row, less that without it; from the prior by itself."""
    plain, row = study(), pd.DataFrame([{**NEW, "resistance_moment [N m]": 5.7}])
    more, alone = study(pd.concat([ROWS, row], ignore_index=True)), study(row)
    density, x = posterior(plain), draws()
    assert density.names == ("phi", "discrepancy_drawbar_pull")
    (candidate,) = candidates(plain, slips=[0.4], loads=["80 N"])
    read = np.array([[19.0e-3, 20.0, 5.7]])
    level = {each: posterior(each).log_prior_and_likelihood(x)[1] for each in (plain, more, alone)}
    for source, expected in (("posterior", level[more] - level[plain]), ("prior", level[alone])):
        (reading,) = readings_of(Situation(plain, density, x, source), candidate)
        found = reading.log_density(read)[0]
        np.testing.assert_allclose(found, expected, rtol=1e-6)


def test_a_curve_takes_from_what_a_drive_tells() -> None:
    """About φ, the more the larger it is; beside readings at the same slip less is left of it."""
    grid, gains = candidates(study(), slips=[0.35], loads=["80 N"]), []
    for sd in (0.01, 1.0, 4.0):
        own = study(discrepancy={"drawbar_pull": {"sd": sd, "length": 0.3}})
        situation = Situation(own, posterior(own), draws()[:, :1], "prior")
        gains.append(choose(situation, grid, ("phi",)).ranking.estimates[0].values[0])
    assert gains[0] > gains[1] + 0.05 > gains[2] + 0.1
    known = study(discrepancy={"drawbar_pull": {"sd": 4.0, "length": 0.3}})
    spread = [
        1 / readings_of(Situation(known, posterior(known), draws()[:, :1], source), grid[0])[0].whitening[0, 1, 1]
        for source in ("prior", "posterior")
    ]
    assert spread[0] == pytest.approx(np.hypot(4.0, 0.5), rel=0.02)
    assert spread[1] < 0.25 * spread[0]
