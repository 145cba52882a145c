"""Studies: what is filled in, what the drive makes of the columns, and what is refused."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from bayesterra.errors import StudyError
from bayesterra.likelihood.page import noise_text, study_overview
from bayesterra.models import M1, M2, MODELS, Wheel
from bayesterra.models.geometry import shearing_radius_coefficient
from bayesterra.report.terminal import show
from bayesterra.stats.laws import Law
from bayesterra.study.canonical import write_study
from bayesterra.study.entries import prior_set
from bayesterra.study.noise import Noise
from bayesterra.study.schema import SamplingOptions, json_schema
from bayesterra.study.study import Study, load_study
from tests.support.folder import TABLE, Write

HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"
WHEEL = Wheel(0.15735, 0.165, 0.010, 30, 0.65)


def made(columns: dict[str, Any] | None = None, **tables: Any) -> Study:
    """A study from Python with two good rows, unless told otherwise."""
    data = {"slip": [0.1, 0.3], "load [N]": [80, 80], "sinkage [mm]": [5.0, 10.0]}
    given = {"noise": {"sinkage": 0.001}, "priors": {"set": "paper-box"}, **tables}
    given.setdefault("wheels", {"A": WHEEL})
    given.setdefault("slip_reference", "shearing")
    return Study(pd.DataFrame({**data, **(columns or {})}), **given)


def test_the_shipped_study_is_read() -> None:
    """HIT Wh32: five rows in the fit, the row at zero slip beside them, Table 10 with c2 = -0.017."""
    study = load_study(HIT)
    assert (study.title, study.model, study.drive) == (
        "HIT wheel Wh32 on HIT-LSS1",
        M1(transition_slips=(0.1, 0.5)),
        "load",
    )
    assert study.wheels == {"Wh32": WHEEL}
    assert study.observations.use.tolist() == [False, True, True, True, True, True]
    assert_allclose(study.observations.values["sinkage"], np.array([4.5, 5, 7.5, 10.5, 14, 27]) * 1e-3)
    assert {n: noise.sd for n, noise in study.noise.items()} == {
        "sinkage": pytest.approx(0.001),
        "drawbar_pull": 1.5,
        "resistance_moment": 0.3,
    }
    assert study.prior.entries == prior_set("paper-box")
    assert study.published is not None
    assert study.published.values["c2"] == -0.017
    assert study.published.values["phi"] == pytest.approx(np.radians(29.3))
    assert (study.kind, study.notes, study.least_squares.hold) == ("digitised", (), {"Ks": 2.5e6})


def test_the_schema_says_what_every_model_is() -> None:
    """By the words of its class, equations of the paper included."""
    said = json.loads(json_schema())["properties"]["model"]["description"]
    assert all(f"``{name}`` {kind.equations}" in said for name, kind in MODELS.items())


def test_texts_on_what_was_driven_go_wherever_the_study_goes(
    tmp_path: Path, write: Write, capsys: pytest.CaptureFixture[str]
) -> None:
    """Soil and day are printed with the data, and written out so that reading gives them back."""
    study = load_study(write(("[data]", 'soil = "LSS1"\ndate = 2011-03-04\n\n[data]')))
    assert study.described == {"soil": "LSS1", "date": "2011-03-04"}
    show(study_overview(study))
    assert "LSS1 · 2011-03-04" in capsys.readouterr().out
    (tmp_path / "again").mkdir()
    write_study(study, tmp_path / "again")
    assert load_study(tmp_path / "again").described == study.described


def test_a_folder_and_its_file_are_the_same_study(write: Write) -> None:
    """The path may be the folder that holds study.toml or any study file."""
    file = write()
    assert load_study(file).fingerprint == load_study(file.parent).fingerprint
    assert load_study(str(file)).path == file


def test_files_and_python_make_the_same_study(write: Write) -> None:
    """A DataFrame with objects and SI numbers gives the fingerprint of the file with text."""
    table = {"slip": [0.1, 0.2, 0.4], "load [N]": [80.0] * 3, "sinkage [mm]": [5.0, 7.5, 14.0]}
    table["drawbar_pull [N]"] = [14.0, 20.0, np.nan]
    study = made(
        table, noise={"sinkage": 0.001, "drawbar_pull": Noise("drawbar_pull", sd=1.5)}, priors=prior_set("paper-box")
    )
    assert study.fingerprint == load_study(write()).fingerprint


def test_the_fingerprint_follows_what_results_depend_on(write: Write) -> None:
    """Noise changes the study's fingerprint, a reading the data's, the title neither."""
    base = load_study(write()).fingerprint
    noise = load_study(write(('sinkage = "1 mm"', 'sinkage = "2 mm"'))).fingerprint
    data = load_study(write(("0.1,80,5.0,14.0", "0.1,80,5.0,14.5"))).fingerprint
    title = load_study(write(("Small study", "Other title"))).fingerprint
    assert (noise["study"] != base["study"], noise["data"] == base["data"]) == (True, True)
    assert (data["study"] == base["study"], data["data"] != base["data"]) == (True, True)
    assert title == base


def test_prior_entries_override_their_set() -> None:
    """A law, a truncated law in field units and fixed values stand in for the set's."""
    phi = {"dist": "norm", "loc": "32 deg", "scale": "4 deg", "lower": "20 deg", "upper": "50 deg"}
    study = made(priors={"set": "paper-box", "phi": phi, "K": Law("norm", {"loc": 0.01, "scale": 0.002}), "c": "1 kPa"})
    assert study.prior.entries["phi"] == Law(
        "norm", {"loc": np.radians(32), "scale": np.radians(4)}, np.radians(20), np.radians(50)
    )
    assert study.prior.entries["K"] == Law("norm", {"loc": 0.01, "scale": 0.002})
    assert study.prior.fixed == {"c": 1000.0, "c3": 0.0}
    assert study.prior.names == ("Ks", "n0", "n1", "phi", "K", "c1", "c2")


def test_shape_arguments_of_laws_have_no_unit() -> None:
    """A lognormal's s is a pure number, its scale has the parameter's unit."""
    study = made(priors={"set": "paper-box", "K": {"dist": "lognorm", "s": 0.5, "scale": "10 mm"}})
    assert study.prior.entries["K"] == Law("lognorm", {"s": 0.5, "scale": 0.01})


def test_a_missing_prior_set_is_taken_and_noted() -> None:
    """Without a set the paper's box fills in what has no entry, and says so; with all entries it does not."""
    assert "prior set 'paper-box' taken for Ks, n0" in made(priors={}).notes[0]
    assert not any("prior set" in note for note in made(priors=prior_set("paper-box")).notes)


def test_a_constant_exponent_holds_n1() -> None:
    """With N = n0 there is no n1 to estimate."""
    study = made(model_options={"constant_exponent": True})
    assert study.prior.fixed["n1"] == 0.0
    with pytest.raises(StudyError, match=r"\[priors\] 'n1' must be left out or 0, as 'constant_exponent'"):
        made(model_options={"constant_exponent": True}, priors={"set": "paper-box", "n1": 0.5})


def test_a_model_object_stands_for_its_name_and_options() -> None:
    """Options of the object are kept."""
    assert made(model=M2(transition_slips=(0.1, 0.4))).model == M2(transition_slips=(0.1, 0.4))


def test_the_coefficient_of_equation_2_is_taken_at_the_prior_median() -> None:
    """Where it is left out: once, at the median of phi, with a note; every later step sees the number."""
    study = made(wheels={"A": Wheel(0.15735, 0.165, 0.015, 30)})
    expected = shearing_radius_coefficient(0.15735, 0.015, 30, np.radians(25.0))
    assert study.wheels["A"].shearing_radius_coefficient == pytest.approx(expected, rel=1e-12)
    assert "from (2) at φ = 25°" in " ".join(study.notes)
    with pytest.raises(StudyError, match=r"\[wheels\.A\] 'shearing_radius_coefficient' from equation \(2\)"):
        made(wheels={"A": Wheel(0.135, 0.165, 0.001, 24)})


def test_estimated_noise_becomes_a_parameter() -> None:
    """Its law joins the prior; 'lower' is a tenth of the scale unless given."""
    study = made(noise={"sinkage": {"estimate": {"dist": "halfnorm", "scale": "2 mm"}}})
    assert study.prior.names[-1] == "noise_sinkage"
    assert study.prior.laws["noise_sinkage"].lower == pytest.approx(2e-4)
    assert study.noise["sinkage"].parameter == "noise_sinkage"


def test_noise_may_stand_in_the_table() -> None:
    """A standard deviation beside every reading replaces the entry in [noise]."""
    study = made({"sinkage_sd [mm]": [0.5, 1.0]}, noise={})
    assert_allclose(study.observations.given_sd["sinkage"], [5e-4, 1e-3])
    with pytest.raises(StudyError, match=r"\[noise\] needs an entry for the measured channel 'sinkage'.*\"1 mm\""):
        made({"sinkage_sd [mm]": [0.5, None]}, noise={})


def test_the_load_drive_conditions_on_the_load() -> None:
    """Sinkage is an outcome; noise of the load is accepted, unused, and noted."""
    study = made(noise={"sinkage": "1 mm", "load": "1 N"})
    assert tuple(study.noise) == ("sinkage",)
    assert study.notes[0] == "noise of load is not used, as the drive 'load' conditions on it"


def test_without_load_the_normal_force_is_the_load() -> None:
    """Drive load, no load column."""
    table = pd.DataFrame({"slip": [0.1], "normal_force [N]": [75], "drawbar_pull [N]": [10]})
    study = Study(table, {"A": WHEEL}, slip_reference="shearing", noise={"drawbar_pull": 1.0})
    assert_allclose(study.observations.load, [75.0])
    assert "the measured normal force is the load" in " ".join(study.notes)


def test_the_sinkage_drive_conditions_on_sinkage() -> None:
    """The load stands for the measured normal force, with its noise, where there is no such column."""
    study = made(drive="sinkage", noise={"load": "2 N", "sinkage": "1 mm"})
    assert_allclose(study.observations.values["normal_force"], [80.0, 80.0])
    assert study.noise["normal_force"] == Noise("normal_force", sd=2.0)
    assert "noise of sinkage is not used, as the drive 'sinkage' conditions on it" in study.notes


def test_a_load_beside_a_normal_force_is_not_used_with_the_sinkage_drive() -> None:
    """And that is noted, as it is with the drive ``both``."""
    forces = {"normal_force [N]": [79.0, 81.0]}
    study = made(forces, drive="sinkage", noise={"normal_force": "2 N"})
    assert_allclose(study.observations.values["normal_force"], [79.0, 81.0])
    assert "load is not used, as the drive 'sinkage' conditions on the sinkage" in study.notes
    both = made(forces, drive="both", noise={"normal_force": "2 N", "sinkage": "1 mm"})
    assert "load is not used, as the drive 'both' infers it from the readings" in both.notes


def test_a_row_in_use_without_a_reading_is_noted() -> None:
    """Not one that is out of use, nor rows of a plan."""
    note = "no reading in row 2: it only excludes soils without an answer there"
    assert note in made({"sinkage [mm]": [5.0, None]}).notes
    assert note not in made({"sinkage [mm]": [5.0, None], "use": [1, 0]}).notes
    assert not any("no reading" in text for text in made().notes)


def test_outcomes_without_a_reading_in_use_are_no_outcomes() -> None:
    """A column that is empty in all rows in use needs no noise."""
    assert tuple(made({"drawbar_pull [N]": [None, None]}).noise) == ("sinkage",)


def test_sinkage_may_be_negative_within_its_noise() -> None:
    """Three standard deviations where it is an outcome, never where it is conditioned on."""
    assert_allclose(made({"sinkage [mm]": [-2.9, 5]}).observations.values["sinkage"], [-0.0029, 0.005])
    with pytest.raises(StudyError, match=r"'sinkage' must not be negative by more.*got -0\.0031 m.*row 1"):
        made({"sinkage [mm]": [-3.1, 5]})
    with pytest.raises(StudyError, match=r"'sinkage' must be above 0 in every row.*\(got 0 m from the rim, row 2\)"):
        made({"sinkage [mm]": [5, 0]}, drive="sinkage", noise={"normal_force": 1.0})


def test_few_readings_are_noted_and_none_refused() -> None:
    """A posterior can bear fewer readings than parameters, but not none at all."""
    assert "2 readings for 8 free parameters" in made().notes[-1]
    with pytest.raises(StudyError, match="the rows in use must hold at least one reading of sinkage"):
        made({"use": [0, 0]})


def test_other_data_in_the_same_study() -> None:
    """with_data replaces outcomes, leaves the rest and the original alone, and checks names and shapes."""
    study = made()
    other = study.with_data({"sinkage": np.array([0.006, 0.011])})
    assert_allclose(other.observations.values["sinkage"], [0.006, 0.011])
    assert_allclose(study.observations.values["sinkage"], [0.005, 0.010])
    assert other.prior is study.prior
    with pytest.raises(ValueError, match="'drawbar_pull' must be a measured channel of 2 rows"):
        study.with_data({"drawbar_pull": np.zeros(2)})
    with pytest.raises(ValueError, match="'sinkage' must be a measured channel of 2 rows"):
        study.with_data({"sinkage": np.zeros(3)})


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"slip_reference": "hub"}, r"\[data\] 'slip_reference' must be 'rim', 'tip' or 'shearing' \(got 'hub'\)"),
        ({"model": "M4"}, r"'model' must be 'M1', 'M2', 'M3', 'M2L', 'wong-reece' or 'bekker-janosi' \(got 'M4'\)"),
        ({"drive": "neither"}, r"'drive' must be 'load', 'sinkage' or 'both' \(got 'neither'\)"),
        ({"transition_slips": [0.1, 0.5]}, r"'transition_slips' \(it belongs in \[model_options\]\)"),
        ({"sampling": {"drive": "load"}}, r"\[sampling\] unknown key 'drive' \(it belongs at the top"),
        ({"NOISE": {}}, r"unknown key 'NOISE' \(did you mean 'noise'\?\)"),
        ({"wheels": {"A": {"radius": {}, "width": 1}}}, r"^\[wheels\.A\] 'radius' must be text with a unit"),
        ({"modl": "M1"}, r"unknown key 'modl' \(did you mean 'model'\?\)"),
        ({"wheels": {}}, r"\[wheels\] needs at least one wheel"),
        ({"wheels": {"A": {"width": 0.1}}}, r"\[wheels\.A\] needs 'radius'"),
        ({"wheels": {"A": {"radius": -0.1, "width": 0.1}}}, r"\[wheels\.A\] 'radius' must be positive \(got -0\.1\)"),
        ({"noise": {"sinkage": -1.0}}, r"\[noise\] noise of 'sinkage' must be above 0 \(got -1\)"),
        ({"noise": {"sinkage": {"fraction": 0.1}}}, r"\[noise\] 'sinkage' must be \"1 mm\", .*\(got fraction\)"),
        ({"noise": {"sinkage": {"estimate": {"dist": "expon"}}}}, r"'sinkage\.estimate' needs a 'lower' above 0"),
        ({"noise": {"drawbar": 1.0}}, r"\[noise\] unknown channel 'drawbar' \(did you mean 'drawbar_pull'\?\)"),
        ({"priors": {"set": "moon"}}, r"\[priors\] unknown prior set 'moon' \(known: paper-box"),
        ({"priors": {"fi": 0.5}}, r"\[priors\] unknown parameter 'fi'"),
        ({"priors": {"kc": 1.0}}, r"\[priors\] 'kc' needs 'kphi' beside it, as K_s = kc/b \+ kphi"),
        ({"priors": {"set": "paper-box", "phi": "60 deg"}}, r"'phi' must be fixed inside .* 0 deg to 50 deg \(got 60"),
        ({"priors": {**prior_set("paper-box"), "K": -0.01}}, r"\[priors\] 'K' must be positive \(got -0\.01\)"),
        ({"priors": {"phi": {"dist": "nrm"}}}, r"\[priors\] 'phi': 'dist' must be a continuous.*'nrm' \(did you mean"),
        ({"priors": {"phi": {"loc": 0.5}}}, r"\[priors\] 'phi' needs a 'dist'"),
        ({"priors": {"phi": {"dist": "norm", "sclae": 1}}}, r"'phi': unknown argument 'sclae' of norm \(did you mean"),
        ({"priors": {"n0": {"dist": "uniform", "lower": 1, "upper": 0}}}, r"'n0': 'lower' must be below 'upper'"),
        ({"priors": {"n0": {"dist": "lognorm"}}}, r"\[priors\] 'n0': lognorm needs its argument 's'"),
        ({"sampling": {"ensembles": 2}}, r"\[sampling\] 'ensembles' must be greater than or equal to 4 \(got 2\)"),
        ({"sampling": {"walkers": 12}}, r"\[sampling\] 'walkers' must be .* equal to 32 \(got 12\)"),
        ({"least_squares": {"hold": {"Kc": 1.0}}}, r"\[least_squares\.hold\] unknown parameter 'Kc'"),
        ({"least_squares": {"methods": ["IM4"]}}, r"'IM1', 'IM2', 'IM3' or 'joint' \(got 'IM4'\)"),
        ({"published": {"phii": 0.5}}, r"\[published\] unknown parameter 'phii' \(did you mean 'phi'\?\)"),
        ({"model_options": {"transition_slips": [0.5, 0.1]}}, r"\[model_options\] 'transition_slips' must rise"),
        ({"model_options": {"transition_slips": [0.5]}}, r"\[model_options\] 'transition_slips' must be two slips"),
        ({"title": 3}, r"'title' must be a valid string \(got 3\)"),
        ({"sampling": 3}, r"'sampling' must be a table \(got 3\)"),
    ],
)
def test_wrong_tables_are_refused(tables: dict[str, Any], message: str) -> None:
    """One line that names table and key, what must hold and the value got."""
    with pytest.raises(StudyError, match=message) as caught:
        made(**tables)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            [('"1 mm"', "1")],
            r"study\.toml: \[noise\] 'sinkage' needs a unit: text with a unit, e\.g\. \"12 mm\" \(got 1\)",
        ),
        ([('"1 mm"', '"1 N"')], r"study\.toml: \[noise\] 'sinkage': the unit 'N' is not a unit of length"),
        ([('"157.35 mm"', "0.15735")], r"study\.toml: \[wheels\.A\] 'radius' needs a unit.*\(got 0\.15735\)"),
        (
            [("lug_height", "lug_hight")],
            r"study\.toml: \[wheels\.A\] unknown key 'lug_hight' \(did you mean 'lug_height'",
        ),
        ([("[priors]", "[piors]")], r"study\.toml: unknown key 'piors' \(did you mean 'priors'\?\)"),
        ([('slip_reference = "shearing"', "")], r"study\.toml: \[data\] needs 'slip_reference'"),
        ([('title = "Small study"', "title = Small study")], r"study\.toml: must be TOML: .*line 1"),
        ([("lug_count = 30", 'lug_count = "30"')], r"\[wheels\.A\] 'lug_count' must be a valid integer \(got '30'\)"),
        ([("c3 = 0.0", 'phi = "60 deg"')], r"study\.toml: \[priors\] 'phi' must be fixed inside"),
        ([("c3 = 0.0", "phi = 0.5")], r"study\.toml: \[priors\] 'phi' needs a unit"),
        ([("measurements.csv", "other.csv")], r"other\.csv: no such file of measurements$"),
        (
            [("0.2,80,7.5,20.0", "1.2,80,7.5,20.0")],
            r"measurements\.csv: 'slip' must lie in \[0, 1\) \(got 1\.2, row 2\)$",
        ),
        (
            [("0.2,80,7.5,20.0", "0.2,80,200,20.0")],
            r"measurements\.csv: 'sinkage' must be below the wheel radius.*row 2",
        ),
        ([("0.2,80,7.5,20.0", "0.2,80,inf,20.0")], r"measurements\.csv: 'sinkage' must be finite.*\(got inf, row 2\)$"),
        ([("0.2,80,7.5,20.0", "0.2,,7.5,20.0")], r"measurements\.csv: 'load' must be above 0 in every row.*row 2"),
        ([("drawbar_pull [N]\n", "sinkage [mm]\n")], r"measurements\.csv: column 'sinkage' must appear once"),
        ([("load [N]", "weight [N]")], r"measurements\.csv: unknown column 'weight \[N\]'"),
        ([('drawbar_pull = "1.5 N"', "")], r"study\.toml: \[noise\] needs an entry for .* 'drawbar_pull'"),
    ],
)
def test_errors_of_files_begin_with_the_file(write: Write, changes: list[tuple[str, str]], message: str) -> None:
    """The file where the mistake is comes first, once, then table or row."""
    file = write(*changes)
    with pytest.raises(StudyError, match=message) as caught:
        load_study(file)
    assert str(caught.value).startswith(str(file.parent))
    assert str(caught.value).count(str(file.parent)) == 1
    assert "\n" not in str(caught.value)


def test_an_empty_table_is_refused(write: Write) -> None:
    """A header alone is not a table of measurements."""
    file = write(table=TABLE.splitlines()[0] + "\n")
    with pytest.raises(StudyError, match=r"measurements\.csv: must hold a header and at least one row"):
        load_study(file)


def test_a_missing_study_is_refused(tmp_path: Path) -> None:
    """No file, and a folder without study.toml."""
    with pytest.raises(StudyError, match=r"nowhere\.toml: no such study file"):
        load_study(tmp_path / "nowhere.toml")
    with pytest.raises(StudyError, match=r"study\.toml: no such study file"):
        load_study(tmp_path)


def test_many_draws_ask_for_more_walkers() -> None:
    """Beyond 10 000 effective draws ensembles have twice the walkers, unless the study says how many."""
    cases = {4000: 64, 10_000: 64, 10_001: 128}
    for target, walkers in cases.items():
        assert made(sampling={"target_ess": target}).sampling.walkers == walkers
        assert SamplingOptions(target_ess=target).walkers == walkers
    assert made(sampling={"target_ess": 20_000, "walkers": 32}).sampling.walkers == 32


def test_a_table_of_normal_forces_keeps_its_fingerprint(write: Write, tmp_path: Path) -> None:
    """The load that stands in for them is exact before and after it was written."""
    study = load_study(write(("load [N]", "normal_force [N]")))
    write_study(study, tmp_path)
    assert load_study(tmp_path).fingerprint == study.fingerprint


def test_a_load_with_an_error_is_taken_as_exact_and_that_is_noted(write: Write) -> None:
    """By the drives that condition on it."""
    study = load_study(write(("slip,load [N]", "slip,load_sd [N],load [N]"), ("80,", "1,80,")))
    assert "load_sd is not used, as the drive 'load' takes loads as exact" in study.notes
    assert not any("load_sd" in note for note in load_study(write()).notes)


def test_noise_by_row_is_told_as_such(write: Write) -> None:
    """By its ends in the unit, beside what holds for other rows; a part of the reading with its least."""
    table = "slip,load [N],sinkage [mm],sinkage_sd [mm],drawbar_pull [N],drawbar_pull_sd [N]\n"
    study = load_study(write(
        ('drawbar_pull = "1.5 N"', 'drawbar_pull = { fraction = 0.03, floor = "0.5 N" }'),
        table=f"{table}0.1,80,5,0.1,14,\n0.2,80,7.5,9,20,2\n0.3,80,9,1,21,2\n"))  # fmt: skip
    assert noise_text(study, "sinkage") == "by row, 0.1 to 9"
    assert noise_text(study, "drawbar_pull", " N") == "by row, 2 N, else 3 %, at least 0.5 N"
    assert noise_text(study, "load") == "given"
    some = load_study(write(table=f"{table}0.1,80,5,0.1,14,\n0.2,80,,,20,2\n0.3,80,9,1,21,2\n"))
    assert noise_text(some, "sinkage") == "by row, 0.1 to 1"
