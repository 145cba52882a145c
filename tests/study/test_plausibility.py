"""Warnings on readings that no wheel makes: each mistake by its row and mend, and none on sound tables."""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.analysis.page import warning
from bayesterra.errors import StudyError
from bayesterra.likelihood.page import conditions
from bayesterra.models import M1, M2, Soil, Wheel
from bayesterra.report.blocks import Table
from bayesterra.stats.laws import Law
from bayesterra.study.noise import Noise

WHEEL = Wheel(0.15735, 0.165, 0.010, 30, 0.65)
SOIL = Soil(Ks=2.5e6, n0=0.85, n1=1.06, c=268.0, phi=0.51, K=0.0101, c1=0.339, c2=-0.017)
SLIPS = np.array([0.05, 0.1, 0.2, 0.3, 0.45, 0.6])
NOISE = {"sinkage": 1e-3, "drawbar_pull": 1.0, "resistance_moment": 0.3}
ESTIMATED = Noise("drawbar_pull", law=Law("halfnorm", {"scale": 2.0}, lower=0.2))
STUDIES = Path(__file__).parents[2] / "studies"
PULL, MOMENT, SINKAGE = "drawbar_pull [N]", "resistance_moment [N m]", "sinkage [mm]"


def table(load: float = 80.0, soil: Soil = SOIL, model: M1 | M2 | None = None) -> pd.DataFrame:
    """Readings without noise."""
    model = model or M2()
    sinkage = model.sinkage(soil, WHEEL, SLIPS, load)
    forces = model.forces(soil, WHEEL, SLIPS, sinkage)
    return pd.DataFrame(
        {
            "slip": SLIPS,
            "load [N]": load,
            SINKAGE: 1e3 * np.asarray(sinkage),
            PULL: np.asarray(forces.drawbar_pull),
            MOMENT: np.asarray(forces.resistance_moment),
        }
    )


def study(data: pd.DataFrame, wheel: Wheel = WHEEL, **tables: Any) -> bt.Study:
    """A study of the table."""
    given = {"noise": NOISE, "priors": {"set": "paper-box"}, **tables}
    return bt.Study(data, {"A": wheel}, slip_reference="shearing", kind="simulated", **given)


def halved(column: str, rows: slice, factor: float) -> Callable[[pd.DataFrame], pd.DataFrame]:
    """The table with a column multiplied in some rows."""

    def change(data: pd.DataFrame) -> pd.DataFrame:
        data.loc[data.index[rows], column] *= factor
        return data

    return change


FAULTS: dict[str, tuple[Callable[[pd.DataFrame], pd.DataFrame], str]] = {
    "kilograms": (
        halved("load [N]", slice(None), 1 / 9.81),
        "drawbar_pull is above the load in rows 2, 3, 4 and 2 more: are loads in kilograms?",
    ),
    "one pull ten times": (
        halved(PULL, slice(3, 4), 10.0),
        "drawbar_pull is above the load in row 4: is the unit of one of them wrong?",
    ),
    "moment in N cm": (
        halved(MOMENT, slice(None), 100.0),
        "resistance_moment is more than the load can hold in rows 1, 2, 3 and 3 more: is it in N m?",
    ),
    "moment in kN cm": (
        halved(MOMENT, slice(None), 0.1),
        "the pull gives more power than the moment puts in, in rows 1, 2, 3 and 3 more: are units and slip right?",
    ),
    "pull against": (
        halved(PULL, slice(None), -1.0),
        "drawbar_pull is negative beyond slip 0.2: it counts as positive where the wheel drives",
    ),
    "moment against": (
        halved(MOMENT, slice(None), -1.0),
        "resistance_moment is negative beyond slip 0.2: it counts as positive where the wheel drives",
    ),
    "a row copied": (
        lambda data: pd.concat([data, data.iloc[[1]]]),
        "row 7 repeats row 2 to the last digit: was it copied?",
    ),
    "one value filled in": (
        lambda data: data.assign(**{SINKAGE: 9.5}),
        "sinkage is 9.5 mm in every row: was the column filled in?",
    ),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_mistake_is_named_with_row_and_mend(fault: str) -> None:
    """One sentence says it; a table without it says nothing."""
    change, sentence = FAULTS[fault]
    rows = pd.concat([table(), table().iloc[3:].assign(slip=[0.35, 0.5, 0.55])]) if "against" in fault else table()
    assert study(rows).warnings == ()
    assert sentence in study(change(rows.reset_index(drop=True).copy())).warnings


def test_loads_in_kilograms_beside_normal_forces() -> None:
    """The two are the same thing in different units."""
    data = table().rename(columns={"load [N]": "normal_force [N]"}).assign(**{"load [N]": 80.0 / 9.81})
    noise = {"normal_force": 2.0, "drawbar_pull": 1.0, "resistance_moment": 0.3}
    found = study(data, drive="sinkage", noise=noise).warnings
    sentence = "normal forces are 9.8 times the loads: are loads in kilograms? Write the unit, e.g. load [kg]"
    assert sentence in found


def test_slips_in_percent_are_refused_with_the_mend() -> None:
    """As a fraction is meant where no unit is given."""
    with pytest.raises(StudyError, match=r"\(got 30, .*row 4\): percent stand in a column 'slip \[%\]'"):
        study(table().assign(slip=[0.05, 0.1, 0.2, 30.0, 0.4, 0.5]))
    data = table().assign(**{"slip [%]": 100 * SLIPS}).drop(columns="slip")
    assert study(data).observations.slip == pytest.approx(SLIPS)


def test_lugs_with_a_height_need_a_count() -> None:
    """As a wheel without lugs has height 0."""
    bare = replace(WHEEL, lug_count=0)
    assert study(table(), bare).warnings == ("wheel A has lugs of a height, and a count of 0: is 'lug_count' missing?",)


def test_rows_that_are_not_in_the_fit_and_limits_say_nothing() -> None:
    """What is left out may be wrong; a limit is no number."""
    data = table().assign(use=[1, 1, 1, 0, 1, 1])
    data.loc[3, PULL] = 900.0
    assert study(data).warnings == ()
    cells = pd.Series([*table()[PULL].round(2)[:5], ">900"], dtype=object)
    assert study(table().assign(**{PULL: cells})).warnings == ()
    assert study(table().assign(use=0), prior_only=True).warnings == ()


def test_sound_tables_are_silent() -> None:
    """With noise: soils from soft to firm through both models, loads from 20 to 200 N."""
    alarms: list[str] = []
    rng = default_rng(1)
    for load in (20.0, 80.0, 200.0):
        for model in (M1(), M2()):
            for soil in (SOIL, replace(SOIL, Ks=8e5, phi=0.42), replace(SOIL, Ks=8e6, c=1500.0)):
                plain = table(load, soil, model)
                for _ in range(12):
                    noisy = plain.copy()
                    for name, size in ((SINKAGE, 1.0), (PULL, 1.5), (MOMENT, 0.3)):
                        noisy[name] += size * rng.standard_normal(len(noisy))
                    alarms += study(noisy.round(1)).warnings
    assert alarms == []


SHIPPED = sorted(path for path in STUDIES.rglob("study.toml") if "calibration" not in path.parts)
"""Studies of the repository: those that a calibration writes hold placeholders for readings."""


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.parent.name)
def test_studies_that_come_with_the_package_are_silent(path: Path) -> None:
    """Measured and digitised ones above all."""
    assert bt.load_study(path).warnings == ()


def test_check_fit_and_report_say_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A warning each, before notes; the first screen of a report has it in its box."""
    data = FAULTS["kilograms"][0](table())
    data.to_csv(tmp_path / "measurements.csv", index=False)
    (tmp_path / "study.toml").write_text(
        """
[data]
file = "measurements.csv"
slip_reference = "shearing"
kind = "simulated"
[wheels.A]
radius = "157.35 mm"
width = "165 mm"
lug_height = "10 mm"
lug_count = 30
shearing_radius_coefficient = 0.65
[noise]
sinkage = "1 mm"
drawbar_pull = "1 N"
resistance_moment = "0.3 N m"
[priors]
set = "paper-box"
""",
        encoding="utf-8",
    )
    for command in ("check", "fit"):
        with suppress(SystemExit):
            main([command, str(tmp_path)])
        printed = " ".join(capsys.readouterr().out.split())
        assert f"Warning: {FAULTS['kilograms'][1]}" in printed

    made = SimpleNamespace(study=bt.load_study(tmp_path), record={}, draws={}, converged=True, verdicts=())
    assert "are loads in kilograms?" in warning(cast("bt.Result", made))


def repeated(scatter: float, number: int = 4, seed: int = 1) -> pd.DataFrame:
    """Every condition driven some times, pulls scattered by ``scatter`` N, slips by less than counts."""
    data, rng = pd.concat([table()] * number, ignore_index=True), default_rng(seed)
    for name, size in ((SINKAGE, 1.0), (PULL, scatter), (MOMENT, 0.3)):
        data[name] += size * rng.standard_normal(len(data))
    return data.assign(slip=data["slip"] + 0.001 * rng.random(len(data)))


def test_repeats_estimate_the_noise() -> None:
    """Pooled about the means of every condition, by hand; of rows in the fit and of one load only."""
    data = repeated(1.0)
    found = study(data).repeats["drawbar_pull"]
    apart = data.groupby(data["slip"].round(2))[PULL].transform("mean") - data[PULL]
    assert found.freedom == 18
    assert found.sd == pytest.approx(np.sqrt((apart**2).sum() / 18))
    assert found.stated == 1.0
    other = data.assign(**{"load [N]": np.repeat([80.0, 90.0, 100.0, 110.0], 6)})
    assert study(other).repeats == study(table()).repeats == {}
    unknown = data.rename(columns={"load [N]": "normal_force [N]"})  # what a load was is not known then
    assert study(unknown, drive="both", noise={**NOISE, "normal_force": 1.0}).repeats == {}


@pytest.mark.parametrize(("scatter", "warned"), [(0.3, True), (1.0, False), (3.0, True)])
def test_noise_that_repeats_contradict_is_warned_of(scatter: float, warned: bool) -> None:
    """Too small and too large alike, with both figures; the table of readings shows them beside each other."""
    made = study(repeated(scatter))
    found = [line for line in made.warnings if line.startswith("drawbar_pull repeats to")]
    assert len(found) == warned
    assert not warned or "(18 degrees of freedom), and its noise is stated as 1 N" in found[0]
    shown = conditions(made)[0]
    assert isinstance(shown, Table)
    assert shown.rows[-1][0] == "repeats (sd)"
    assert float(str(shown.rows[-1][4])) == pytest.approx(scatter, rel=0.5)
    estimated = study(repeated(scatter), noise={**NOISE, "drawbar_pull": ESTIMATED})
    assert not any(line.startswith("drawbar_pull") for line in estimated.warnings)


def test_a_log_does_not_repeat_one_condition() -> None:
    """Slips that follow one another closely, from 0.05 to 0.6, are many conditions: their trend is no noise."""
    rng, slip = default_rng(3), np.linspace(0.05, 0.6, 400)
    data = pd.DataFrame({name: np.interp(slip, table()["slip"], table()[name]) for name in (SINKAGE, PULL, MOMENT)})
    for name, size in ((SINKAGE, 1.0), (PULL, 1.0), (MOMENT, 0.3)):
        data[name] += size * rng.standard_normal(len(data))
    data["slip"], data["load [N]"] = slip, 80.0
    made = study(data)
    assert not [line for line in made.warnings if "repeats to" in line]
    assert made.repeats["drawbar_pull"].sd == pytest.approx(1.0, rel=0.1)
    assert made.repeats["drawbar_pull"].freedom == 300  # four rows to a condition
