"""The stored tables of plates, rings and a wheel in one posterior say what its README says of them."""

from pathlib import Path

import numpy as np
import pandas as pd

STUDY = Path(__file__).parents[2] / "studies" / "soil-tests" / "together"
PARAMETERS = pd.read_csv(STUDY / "parameters.csv")
RUNS = pd.read_csv(STUDY / "runs.csv").set_index("case")


def apart(first: pd.DataFrame, second: pd.DataFrame) -> tuple[float, float]:
    """Largest distance of medians in standard deviations, and of the logarithms of these, over common parameters."""
    both = first.merge(second, on="parameter")
    assert len(both) >= 5
    return (
        float(((both["median_x"] - both["median_y"]) / both["sd_y"]).abs().max()),
        float(np.abs(np.log(both["sd_x"] / both["sd_y"])).max()),
    )


def test_one_posterior_says_what_two_steps_say() -> None:
    """Of CMU's plates and wheel: parameters, and the evidence of the wheel."""
    steps = pd.read_csv(STUDY.parent / "plates-then-wheel" / "parameters.csv").query("prior == 'plates'")
    evidence = pd.read_csv(STUDY.parent / "plates-then-wheel" / "runs.csv").query("prior == 'plates'")
    shares = pd.read_csv(STUDY / "shares.csv").set_index("case")["log_share"]
    assert RUNS["converged"].all()
    for case, log_evidence in zip(evidence["geometry"], evidence["log_evidence"], strict=True):
        medians, spreads = apart(PARAMETERS[PARAMETERS["case"] == case], steps[steps["geometry"] == case])
        assert medians < 0.04
        assert spreads < 0.02
        alone = RUNS.loc[case, "log_z"] - RUNS.loc["plates", "log_z"] - shares[case]
        assert abs(alone - log_evidence) < 0.05


def test_tests_that_share_nothing_leave_each_other_alone() -> None:
    """Of Cullinan's plates and ring."""
    both = PARAMETERS[PARAMETERS["case"] == "cullinan"]
    for case in ("cullinan-plates", "cullinan-ring"):
        medians, spreads = apart(both, PARAMETERS[PARAMETERS["case"] == case])
        assert medians < 0.04
        assert spreads < 0.02
    log_z = RUNS["log_z"]
    assert abs(log_z["cullinan"] - log_z["cullinan-plates"] - log_z["cullinan-ring"]) < 0.05
