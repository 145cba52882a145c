"""Soil tests of a study: mistakes in tables and files, what is left out, what parts of a study share."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import bayesterra as bt
from bayesterra.errors import StudyError
from bayesterra.study import assembly
from bayesterra.study.canonical import write_study
from bayesterra.study.study import load_soil_test, load_study
from tests.support.soil_tests import PLATE_PRIORS, both, plate_table, plates, shear

TOML = """title = "two plates"
test = "plate"
[data]
file = "plates.csv"
kind = "simulated"
[priors]
kc = { dist = "uniform", lower = "-500 kPa m", upper = "500 kPa m" }
kphi = { dist = "uniform", lower = "-20000 kPa", upper = "20000 kPa" }
n = { dist = "uniform", lower = 0.3, upper = 2.0 }
[sampling]
target_ess = 400
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    """A soil-test file with its readings."""
    plate_table(tests=3).to_csv(tmp_path / "plates.csv", index=False)
    (tmp_path / "plates.toml").write_text(TOML, encoding="utf-8")
    return tmp_path / "plates.toml"


def test_mistakes_from_python_are_said_too() -> None:
    """Without a file the same rules hold; without anything to analyse there is nothing to do."""
    table = plate_table()
    with pytest.raises(StudyError, match="'test' must be 'plate' or 'shear'"):
        bt.soil_test(data=table, kind="vane", priors=PLATE_PRIORS)
    with pytest.raises(StudyError, match=r"\[priors\] needs 'kphi', e.g. kphi = "):
        bt.soil_test(data=table, kind="plate", priors={"kc": 0.0})
    fixed = {"kc": 0.0, "kphi": 1e6, "n": 1.0}
    with pytest.raises(StudyError, match="every parameter is fixed"):
        bt.soil_test(data=table, kind="plate", priors=fixed, noise={"independent": True, "scatter": 0.1})
    with pytest.raises(TypeError, match="takes a file"):
        bt.soil_test()


KIND = 'kind = "simulated"'


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('test = "plate"', 'test = "vane"', "'test' must be 'plate' or 'shear' (got 'vane')"),
        ("[priors]", "[prior]", "unknown key 'prior' (did you mean 'priors'?)"),
        ("kphi = {", "kfi = {", "[priors] unknown parameter 'kfi'"),
        ("n = { dist", "K = { dist", "needs a unit"),
        (KIND, "spacing = -1", "[data] 'spacing' must be greater than or equal to 0 (got -1)"),
        (KIND, 'pressure_range = ["9 kPa", "2 kPa"]', "'pressure_range' must rise"),
        (KIND, 'displacement_range = ["1 mm", "2 mm"]', "'displacement_range' does not go with plate tests"),
        ("n = {", 'reference_sinkage = "0 mm"\nn = {', "'reference_sinkage' must be above 0 (got 0 m)"),
        ("[sampling]", "[noise]\nmemory = 0.0\n[sampling]", "[noise] 'memory' must be above 0 (got 0)"),
        ('"plates.csv"', '"other.csv"', "no such file of measurements"),
    ],
)
def test_mistakes_in_a_file_are_one_line(file: Path, old: str, new: str, message: str) -> None:
    """Every message names the file, the key and the rule."""
    file.write_text(TOML.replace(old, new), encoding="utf-8")
    with pytest.raises(StudyError) as caught:
        load_soil_test(file)
    assert message in str(caught.value).replace("-1.0)", "-1)")  # as older pydantic writes it
    assert "\n" not in str(caught.value)
    assert str(file.parent) in str(caught.value)


PLATE = "test,plate_diameter [mm],sinkage [mm],force [N]"


@pytest.mark.parametrize(
    ("header", "row", "message"),
    [
        ("test,plate_diameter [mm],sinkage [mm]", "a,60,1", "one column of 'force [N]' and 'pressure [kPa]'"),
        (PLATE.replace("diameter [mm]", "diameter"), "a,60,1,2", "needs a unit, e.g. 'plate_diameter [mm]'"),
        (PLATE, "a,-60,1,2", "'plate_diameter' must be from 0.001 mm to 1 km (got -60, row 1)"),
        (PLATE, "a,1e-200,1,2", "'plate_diameter' must be from 0.001 mm to 1 km (got 1e-200, row 1)"),
        (PLATE, "a,60,1,2\nb,1e200,1,2", "'plate_diameter' must be from 0.001 mm to 1 km (got 1e200, row 2)"),
        (PLATE, "a,60,1,1e306", "must be a stress below 1 TPa (got 1e306, row 1)"),
        (PLATE, ",60,1,2", "'test' must be given in every row (empty in row 1)"),
        (PLATE, "a,60,,2", "'sinkage' must be given in every row (empty in row 1)"),
        (PLATE, "a,60,1,2\na,80,2,3", "must be the same in all rows of a test (got 60 mm and another"),
        (f"{PLATE},slip", "a,60,1,2,0", "unknown column 'slip' of plate tests"),
        (f"{PLATE},use", "a,60,1,2,yes", "'use' must be"),
        (f"{PLATE},use", "a,60,1,2,0", "must hold at least one reading that is used"),
    ],
)
def test_mistakes_in_a_table_are_one_line(file: Path, header: str, row: str, message: str) -> None:
    """Every message names the column, the rule and the row."""
    (file.parent / "plates.csv").write_text(f"{header}\n{row}\n", encoding="utf-8")
    with pytest.raises(StudyError) as caught:
        load_soil_test(file)
    assert message in str(caught.value)
    assert "plates.csv" in str(caught.value)


def test_readings_are_thinned_and_ranged_and_said_to_be() -> None:
    """Readings outside the range or too close together are left out, with a note each."""
    study = plates(data={"pressure_range": (2e3, 10e3), "spacing": 0.5})
    readings = study.soil_tests["plate"].readings
    assert ((readings.stress >= 2e3) & (readings.stress <= 10e3)).all()
    for number in range(len(readings.tests)):
        assert (np.diff(np.log(readings.path[readings.test == number])) >= 0.5).all()
    assert "readings outside the range that the file gives are left out" in study.notes[0]
    assert "closer than 50 % only the first" in study.notes[1]


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"priors": {"K.rng": 0.01}}, "no wheel or soil test of this study reads it: unknown parameter 'K.rng'"),
        ({"priors": {"n": 1.0}}, "no wheel or soil test of this study reads it: unknown parameter 'n'"),
        ({"priors": {"reference_sinkage": 0.0}}, "'reference_sinkage' must be above 0 (got 0 m)"),
        ({"soil_tests": {"mean": {"test": "plate"}}}, "a word other than mean and spread (got 'mean')"),
        ({"soil_tests": {"a b": {"test": "plate"}}}, "the name of a soil test must be a word"),
        ({"soil_tests": {"a": {"test": "plate"}}}, "[soil_tests.a] needs 'file', its table of readings"),
        ({"soil_tests": {"a": {"test": "plate", "tie": {"n": "c1"}}}}, "must be tied to a parameter of the soil"),
        ({"soil_tests": {"a": {"test": "plate", "tie": {"m": "n0"}}}}, "[soil_tests.a] tie: unknown parameter 'm'"),
        ({"soil_tests": {"a": {"test": "plate", "noise": {"mass": 1}}}}, "unknown parameter 'mass'"),
        ({"soil_tests": {"a": {"test": "plate", "fil": "x"}}}, "unknown key 'fil' (did you mean 'file'?)"),
        ({"soil_tests": {"a": {"test": "plate", "tie": {"kc": "K"}}}}, "'kc' must be tied to a parameter of the soil"),
        ({"pooling": {"shared": ["phi"]}}, "[pooling] does not go with [soil_tests]: run the tests alone"),
    ],
)
def test_mistakes_in_the_tables_are_one_line(tables: dict[str, Any], message: str) -> None:
    """Beside a wheel: every message names the table, the key and the rule."""
    for name, stated in tables.get("soil_tests", {}).items():
        if message.endswith("readings"):
            continue
        tables = {"soil_tests": {name: {"table": plate_table(), **stated}}}
    with pytest.raises(StudyError) as caught:
        both(**tables)
    assert message in str(caught.value)


def test_a_sinkage_of_laws_is_that_of_the_wheels_exponent() -> None:
    """With a wheel the plates' n must be n0, or the laws of the shared moduli mean two things."""
    own = {"test": "plate", "table": plate_table()}
    with pytest.raises(StudyError, match=r"'reference_sinkage' with wheels needs 'tie = "):
        both(reference=True, priors={"n": PLATE_PRIORS["n"]}, soil_tests={"plates": own})
    with pytest.raises(StudyError, match="goes with plate tests whose kc, kphi and n all have laws"):
        both(reference=True, priors={"n0": 1.1})


@pytest.mark.parametrize("name", ["kc", "kphi", "n"])
def test_a_sinkage_of_laws_is_not_that_of_earlier_draws(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """An earlier result's moduli would be read as theirs times z to the n, off by a factor of a hundred at 10 mm."""
    stated = assembly.with_soil_tests

    def taken(soil: Any, *rest: Any, **more: Any) -> Any:
        return stated(replace(soil, taken=(SimpleNamespace(laws={name: None}),)), *rest, **more)

    monkeypatch.setattr(assembly, "with_soil_tests", taken)
    with pytest.raises(StudyError, match=r"'reference_sinkage' is for stated laws: leave it out where 'from' gives kc"):
        plates()


def test_parameters_are_shared_by_name_and_tie() -> None:
    """c, φ and the moduli by name, n0 by its tie; the ring's K and all scatter are their own."""
    study = both(ring=True)
    assert study.prior.names == (
        "kc", "kphi", "n0", "c", "phi", "K.ring", "scatter.plates", "scatter.ring",
    )  # fmt: skip
    assert study.soil_tests["plates"].soil == ("kc", "kphi", "n0")
    assert study.soil_tests["ring"].soil == ("c", "phi", "K.ring")


def test_a_study_that_is_written_is_the_same_study(tmp_path: Path) -> None:
    """Tables, readings, ties and fingerprint; of a wheel with tests, and of tests alone."""
    for i, study in enumerate((both(ring=True, reference=True), plates(), shear())):
        write_study(study, make(tmp_path / str(i)))
        again = load_study(tmp_path / str(i))
        assert again.prior.entries == study.prior.entries
        assert again.prior.reference == study.prior.reference
        assert again.fingerprint["study"] == study.fingerprint["study"]
        for name, test in study.soil_tests.items():
            np.testing.assert_allclose(again.soil_tests[name].readings.stress, test.readings.stress, rtol=1e-12)
            assert dict(again.soil_tests[name].names) == dict(test.names)


def make(folder: Path) -> Path:
    """A new folder."""
    folder.mkdir()
    return folder
