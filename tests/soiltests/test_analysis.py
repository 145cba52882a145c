"""Whole analyses of small soil tests: recovery, verdicts, predictions of left-out tests, folders."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy.stats import spearmanr

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.errors import ResultError, StudyError
from bayesterra.models import Wheel
from bayesterra.report.terminal import show
from bayesterra.report.verdicts import PARTS
from bayesterra.soiltests import analysis as soiltests_analysis
from bayesterra.soiltests import page as soiltests_page
from bayesterra.soiltests.analysis import SoilTestResult, analyse
from bayesterra.soiltests.checks import LeftOut, none_left_out
from bayesterra.soiltests.study import load_soil_test, soil_test
from bayesterra.stats.quantile_law import QuantileLaw
from bayesterra.study.study import Study

from .conftest import PLATE_PRIORS, SOIL, plates

Analysed = Callable[[str], SoilTestResult]
TABLES = ("summary", "least_squares", "identifiability", "left_out", "bands", "readings")
FILES = {"report.html", "draws.nc", "run.json", "SHA256SUMS", "soiltest.toml", *(f"{name}.csv" for name in TABLES)}


def words(result: SoilTestResult) -> dict[str, str]:
    """Verdicts on the soil parameters."""
    table = result.identifiability.set_index("parameter")["verdict"]
    return {name: str(table[name]) for name in result.test.soil}


@pytest.mark.slow
def test_two_radii_give_both_moduli_back_and_one_does_not(analysed: Analysed) -> None:
    """Determined and covered with two; with one only the sum, by the words of wheel studies."""
    two, one = analysed("plates"), analysed("one plate")
    assert two.converged
    assert one.converged
    assert words(two) == dict.fromkeys(SOIL, "determined")
    for name, value in SOIL.items():
        low, high = np.quantile(two.draws["posterior"][name], [0.005, 0.995])
        assert low < value < high
    lost = "structurally not determined"
    assert words(one) == {"kc": lost, "kphi": lost, "n": "determined"}
    assert "only k_c/b + k_φ is determined, at b = 30 mm" in one.sentence
    known = one.summary.set_index("parameter").filter(like="p(", axis=0).iloc[0]
    assert known["sd"] < 0.2 * known["median"]


@pytest.mark.slow
def test_two_stresses_separate_cohesion_from_friction_and_one_does_not(analysed: Analysed) -> None:
    """With one normal stress only the strength there is determined."""
    assert words(analysed("shear"))["phi"] == "determined"
    one = analysed("one stress")
    assert words(one)["c"] == words(one)["phi"] == "structurally not determined"
    assert "only c + σ tan φ is determined, at σ = 15 kPa" in one.sentence


@pytest.mark.slow
def test_a_test_that_is_off_is_outside_its_prediction(analysed: Analysed) -> None:
    """One test twice as stiff as it was: its level leaves the prediction from the others."""
    result = analysed("plates")
    odd = plates(tests=6, scatter=0.02)
    table = odd.table.copy()
    own = table["test"] == "0.06 0"
    table.loc[own, "pressure [Pa]"] *= 2.0
    tables = {"test": "plate", "data": {"file": "x"}, "priors": PLATE_PRIORS, "sampling": odd.sampling}
    found = analyse(soil_test(table, tables)).left_out.set_index("test")["level_pit"].to_dict()
    assert found.pop("0.06 0") > 0.97
    assert all(0.02 < level < 0.98 for level in found.values())
    assert set(result.left_out["test"]) == set(result.test.readings.tests)


BROKEN = {
    "left_out": "leave_out", "evidence": "ensembles_evidence", "fits": "fit",
    "identifiability": "identifiability", "mode": "minimize", "derived": "summary_row",
    "bands": "marginal_sd",
}  # fmt: skip


@pytest.mark.slow
def test_no_check_costs_the_posterior(
    analysed: Analysed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All that comes after the sampling fails: draws and summary stand, page and terminal say what failed."""

    def refuse(*_: object, **__: object) -> float:
        raise ValueError("all tail values are the same")

    sound = analysed("one plate")
    for name in set(BROKEN.values()):
        monkeypatch.setattr(soiltests_analysis, name, refuse)
    monkeypatch.setattr(soiltests_page, "pair", refuse)
    found = analyse(plates((0.03,)), seed=1)
    report = found.save(tmp_path / "out")
    np.testing.assert_array_equal(found.values(), sound.values())
    assert list(found.summary["parameter"]) == list(found.names)
    assert np.isfinite(found.summary[["mode", "median", "r_hat"]]).all(axis=None)
    record = json.loads((report.parent / "run.json").read_text(encoding="utf-8"))
    assert set(record["failures"]) == {*BROKEN, "report: Parameters"}
    assert record["alarm"] is None
    page = report.read_text(encoding="utf-8")
    show(found.overview())
    printed = capsys.readouterr().out
    for part in BROKEN:
        assert f"{PARTS[part]} could not be computed (ValueError: all tail values are the same)" in page
        assert f"{PARTS[part]} could not be computed (ValueError: all tail values are the same)" in printed
    assert "report: Parameters could not be computed" in page
    assert "No soil parameter is determined" not in page + printed
    assert "failures" not in sound.record


def test_a_finding_that_fails_leaves_the_verdicts(monkeypatch: pytest.MonkeyPatch) -> None:
    """The sentence is empty, and the table of verdicts stands."""
    monkeypatch.setattr(soiltests_analysis, "leave_out", lambda *_: none_left_out("plate"))
    monkeypatch.setattr(soiltests_analysis, "finding", lambda *_: dict[str, str]()["nothing"])
    found = analyse(plates((0.03,)), seed=1)
    assert (found.sentence, list(found.record["failures"])) == ("", ["finding"])
    assert words(found)["n"] == "determined"


@pytest.mark.slow
def test_a_misfit_is_the_first_thing_that_a_page_and_a_terminal_say(
    analysed: Analysed, capsys: pytest.CaptureFixture[str]
) -> None:
    """As with wheels: the page opens with it, and one line on standard error warns; else nothing does."""
    sound = replace(analysed("plates"), record={**analysed("plates").record, "alarm": False})
    loud = {**sound.record, "alarm": True, "checks": {"levels of tests uniform": 0.001, "b": 0.4}}
    alarmed = replace(sound, record=loud)
    opening = alarmed.page().html().split("<main>")[1].lstrip()
    said = "these readings: tests are not as the others predict them (levels of tests uniform: p 0.001)"
    assert opening.startswith(f'<p class="warning" role="alert">The model does <b>not fit</b> {said}. ')
    show(alarmed.overview())
    printed = capsys.readouterr().err
    assert printed.startswith(f"warning: the model does not fit {said}; check units, plate sizes or normal")
    assert printed.count("\n") == 1
    show(sound.overview())
    assert capsys.readouterr().err == ""
    assert "<b>not fit</b>" not in sound.page().html()


def test_alarms_need_a_small_p_value_for_the_number_of_checks() -> None:
    """Bonferroni: one in twenty among all of them."""
    assert LeftOut(pd.DataFrame(), {"a": 0.02, "b": 0.5}).alarm
    assert not LeftOut(pd.DataFrame(), {"a": 0.03, "b": 0.5}).alarm
    assert not LeftOut(pd.DataFrame(), {}).alarm


def test_a_result_is_a_whole_folder_that_gives_the_test_back(analysed: Analysed, tmp_path: Path) -> None:
    """All files; draws by name over chain and draw; the written test is the same one."""
    result = analysed("plates")
    report = result.save(tmp_path / "out")
    assert {path.name for path in report.parent.iterdir()} == FILES
    draws = xr.open_datatree(report.parent / "draws.nc", engine="h5netcdf").load()
    assert draws["posterior"]["kc"].dims == ("chain", "draw")
    np.testing.assert_array_equal(draws["posterior"]["n"], result.draws["posterior"]["n"])
    draws.close()
    again = load_soil_test(report.parent)
    assert again.entries == result.test.entries
    assert again.reference == result.test.reference
    np.testing.assert_allclose(again.readings.stress, result.test.readings.stress, rtol=1e-12)
    record = json.loads((report.parent / "run.json").read_text(encoding="utf-8"))
    assert record["verdict"]["converged"] is True
    page = report.read_text(encoding="utf-8")
    assert "Bekker" in page
    assert "http" not in page.replace("http://www.w3.org", "")
    with pytest.raises(ResultError, match="exists already"):
        result.save(tmp_path / "out")


def test_the_posterior_of_plates_is_a_wheels_prior(analysed: Analysed, tmp_path: Path) -> None:
    """A wheel study that names the folder has the moduli's laws and their correlation."""
    result = analysed("plates")
    result.save(tmp_path / "plates")
    take = {"kc": "kc", "kphi": "kphi", "n0": "n"}
    study = Study(
        pd.DataFrame({"slip": [0.1, 0.3], "load [N]": 80.0, "drawbar_pull [N]": [14.0, 22.0]}),
        {"Wh3": Wheel(radius=0.157, width=0.165)},
        slip_reference="rim",
        noise={"drawbar_pull": 1.0},
        priors={"set": "paper-box", "from": [{"result": str(tmp_path / "plates"), "take": take}]},
    )
    draws = result.draws["posterior"].to_dataset().stack(all=("chain", "draw"))
    for name, source in take.items():
        values, law = draws[source].to_numpy(), study.prior.laws[name]
        assert isinstance(law, QuantileLaw)
        assert abs(law.median - np.median(values)) < 0.1 * values.std()
    ranks = float(spearmanr(draws["kc"], draws["kphi"]).statistic)
    prior = study.prior.sample(4000, np.random.default_rng(1))
    kc, kphi = (prior[:, study.prior.names.index(name)] for name in ("kc", "kphi"))
    assert abs(float(spearmanr(kc, kphi).statistic) - ranks) < 0.1


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
    plates(tests=3).table.to_csv(tmp_path / "plates.csv", index=False)
    (tmp_path / "plates.toml").write_text(TOML, encoding="utf-8")
    return tmp_path / "plates.toml"


def test_the_command_writes_a_folder_and_prints_the_finding(
    file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 0, the default name is the file's, the finding on the terminal; nothing is overwritten."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(soiltests_analysis, "leave_out", lambda *_: none_left_out("plate"))
    assert main(["soiltest", str(file), "--quiet"]) == 0
    printed = capsys.readouterr()
    assert "Determined: " in printed.out
    assert "Report: plates-result/report.html" in printed.out
    assert printed.err == ""
    assert {path.name for path in (tmp_path / "plates-result").iterdir()} == FILES
    assert main(["soiltest", str(file), "--quiet"]) == 2
    assert "exists already: add --overwrite" in capsys.readouterr().err


def test_mistakes_from_python_are_said_too() -> None:
    """Without a file the same rules hold; without anything to analyse there is nothing to do."""
    table = plates().table
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
    assert message in str(caught.value)
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
    data = {"file": "x", "pressure_range": (2e3, 10e3), "spacing": 0.5}
    test = plates(data=data)
    readings = test.readings
    assert ((readings.stress >= 2e3) & (readings.stress <= 10e3)).all()
    for number in range(len(readings.tests)):
        assert (np.diff(np.log(readings.path[readings.test == number])) >= 0.5).all()
    assert "readings outside the range that the file gives are left out" in test.notes[0]
    assert "closer than 50 % only the first" in test.notes[1]
