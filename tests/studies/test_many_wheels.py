"""Studies with several wheels: the stored results hold, and a part is made again."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng

from bayesterra.likelihood.joint import joint_posterior

STORED = Path(__file__).parents[2] / "studies" / "many-wheels"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """The study's script as a module."""
    return study_script("many-wheels")


def _table(name: str, case: str) -> pd.DataFrame:
    table = pd.read_csv(STORED / f"{name}.csv")
    return table[table["case"] == case].reset_index(drop=True)


@pytest.mark.parametrize(("case", "parameters", "one_soil"), [("one-soil", 38, True), ("six-soils", 52, False)])
def test_soils_are_recovered_and_judged(case: str, parameters: int, one_soil: bool) -> None:
    """Converged; intervals hold what they should; factors are reliable and point right."""
    recovery, costs = _table("recovery", case), _table("costs", case)
    assert len(recovery) == parameters
    assert costs["converged"].all()
    assert recovery["inside"].mean() >= 0.75
    sharing = _table("sharing", case).set_index("parameter")
    assert (sharing["log_bayes_factor"]["c and phi"] > 3.0) == one_soil
    assert (sharing["log_bayes_factor_as_stated"]["K"] < -3.0) == one_soil
    assert sharing["reliable"].all()
    assert sharing["error"].max() < 0.15
    assert sharing["verdict"]["c and phi"] == ("soil constant" if one_soil else "wheel-dependent")
    assert (sharing["verdict_as_stated"]["K"] == "wheel-dependent") == one_soil
    stated = sharing[sharing["verdict_as_stated"].notna()]
    assert stated["reliable_as_stated"].all()
    told = stated["log_bayes_factor_as_stated"].abs() > 3.0
    assert list(stated["verdict_as_stated"] != "cannot tell") == list(told)
    pooling = _table("pooling", case).set_index("pooling")
    assert pooling["log_evidence"].idxmax() == "as stated"


@pytest.mark.parametrize("case", ["one-soil", "six-soils"])
def test_the_readme_says_what_the_tables_say(case: str) -> None:
    """Draws, true values inside, evidence, and the factors of c with φ and of K."""
    text = (STORED / "README.md").read_text(encoding="utf-8").replace("\u2212", "-").replace("*", "")
    costs, inside = _table("costs", case).iloc[0], _table("recovery", case)["inside"]
    ess = f"{costs['ess']:.0f}"
    line = f"| `{case}` | yes | {costs['r_hat']:.4f} | {ess[:-3]} {ess[-3:]} |"
    assert line in text
    assert f"| {costs['ess_per_processor_second']:.0f} | {inside.sum()} of {len(inside)} |" in text
    evidence = _table("pooling", case).set_index("pooling")["log_evidence"]
    assert f"| {evidence['as stated']:.1f} | {evidence['none']:.1f} |" in text
    sharing = _table("sharing", case).set_index("parameter")
    together, alone, stated = (
        sharing["log_bayes_factor"]["c and phi"],
        sharing["log_bayes_factor"]["K"],
        sharing["log_bayes_factor_as_stated"]["K"],
    )
    for factor in (together, alone, stated):
        assert f"{factor:.2f} ±" in text or f"{factor:.1f} ±" in text


def test_readings_of_six_wheels_are_those_of_their_soils(script: ModuleType) -> None:
    """With c and φ of one soil the true values are likely: χ² is the number of readings within chance."""
    joint = joint_posterior(script.simulated("one-soil"))
    assert len(joint.names) == 38
    assert joint.names[:3] == ("c", "phi", "Ks[Wh11]")
    drivers = np.array([[script.truth("one-soil", "Wh11")[name] for name in joint.shared]])
    level, readings = 0.0, 0
    for group, posterior in joint.groups.items():
        own = np.array([[script.truth("one-soil", group)[name] for name in joint.local]])
        level += float(joint.log_likelihood_of_group(group, drivers, own)[0])
        readings += int(np.isfinite(posterior.likelihood.measured).sum())
    noise = np.log(np.array(list(script.NOISE.values())) * np.sqrt(2 * np.pi))
    assert readings == 180
    assert -2.0 * (level + noise.mean() * readings) == pytest.approx(readings, abs=4.5 * np.sqrt(2 * readings))


def test_a_replication_has_the_readings_of_its_truth(study_script: Callable[[str], ModuleType]) -> None:
    """Truth inside the support, its readings within noise, none of them those of the conditions."""
    calibration = study_script("calibration/groups")
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


def test_stored_ranks_are_uniform(study_script: Callable[[str], ModuleType]) -> None:
    """Every quantity passes, as the stored verdicts say; all fits converged, no replication counts twice."""
    script, folder = study_script("calibration/groups"), STORED.parent / "calibration" / "groups"
    table = pd.read_csv(folder / "ranks.csv", keep_default_na=True)
    made = script.Calibration(script.conditions(), table.drop(columns="note").assign(note=""), {})
    assert made.calibrated
    assert len(made.tested) == 17
    assert len(table) >= 200
    assert table["task"].is_unique
    assert (table["status"] == "converged").all()
    assert list(made.tests["verdict"]) == list(pd.read_csv(folder / "tests.csv")["verdict"])


def test_stored_factors_are_those_of_closed_forms() -> None:
    """At every true factor 19 of 20 reported ones lie within two stated errors, and errors stay small."""
    table = pd.read_csv(STORED.parent / "calibration" / "groups" / "factors.csv")
    assert set(table["level"]) == {-30, -6, -3, 2}
    assert not table.duplicated(["level", "number"]).any()
    np.testing.assert_allclose(table["true"], table["level"], atol=1e-5)
    for _, rows in table.groupby("level"):
        assert len(rows) >= 20
        assert rows["reliable"].mean() >= 0.95
        for off, error in (
            (rows["reported"] - rows["true"], rows["error"]),
            (rows["population_off"], rows["population_error"]),
        ):
            assert (np.abs(off) <= 2.0 * error).mean() >= 0.95
            assert error.median() < 0.05
