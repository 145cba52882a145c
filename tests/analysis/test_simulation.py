"""Simulated measurements."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from bayesterra.__main__ import main
from bayesterra.analysis.simulation import simulate, true_values, write_simulated
from bayesterra.errors import ResultError, StudyError, SupportError
from bayesterra.likelihood.posterior import posterior
from bayesterra.models import MODELS, Soil, Wheel
from bayesterra.stats.laws import Law
from bayesterra.study.study import Study, load_study

HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"
SOIL = {"Ks": 2.5e6, "n0": 0.8, "n1": 1.0, "c": 250.0, "phi": 0.5, "K": 0.011, "c1": 0.4, "c2": -0.1, "c3": 0.0}
WHEEL = Wheel(0.15735, 0.165, 0.015, 30, 0.75)


def study(rows: int = 4, **tables: Any) -> Study:
    """A study with all channels at several slips; the readings themselves do not matter."""
    table = pd.DataFrame({"slip": np.linspace(0.1, 0.6, rows), "load [N]": 80.0, "sinkage [mm]": 10.0})
    table = table.assign(**{"drawbar_pull [N]": 10.0, "resistance_moment [N m]": 5.0})
    noise = {"sinkage": 1e-3, "drawbar_pull": 1.0, "resistance_moment": 0.2, "normal_force": 2.0}
    given = {"noise": noise, "priors": {"set": "paper-box"}, **tables}
    return Study(table, {"A": WHEEL}, slip_reference="shearing", **given)


def nearly_noiseless(**tables: Any) -> Study:
    """The same with noise far below what the comparison resolves."""
    channels = ("sinkage", "drawbar_pull", "resistance_moment", "normal_force")
    return study(noise=dict.fromkeys(channels, 1e-13), **tables)


@pytest.mark.parametrize("model", ["M1", "M2", "M3"])
def test_without_noise_the_load_drive_returns_the_model(model: str) -> None:
    """Sinkage carries the load; drawbar pull and moment are those at that sinkage."""
    table = simulate(nearly_noiseless(model=model), SOIL)
    forces = MODELS[model]().forces(
        Soil(**SOIL), WHEEL, table["slip"].to_numpy(), table["sinkage [mm]"].to_numpy() / 1e3
    )
    assert_allclose(forces.normal, 80.0, rtol=1e-8)
    assert_allclose(forces.drawbar_pull, table["drawbar_pull [N]"], atol=1e-7)
    assert_allclose(forces.resistance_moment, table["resistance_moment [N m]"], atol=1e-7)


@pytest.mark.parametrize("model", ["M1", "M2", "M3"])
def test_without_noise_the_sinkage_drive_returns_the_model(model: str) -> None:
    """The sinkage stays as it was; the forces are those at that sinkage."""
    table = simulate(nearly_noiseless(model=model, drive="sinkage"), SOIL)
    assert_allclose(table["sinkage [mm]"], 10.0)
    forces = MODELS[model]().forces(Soil(**SOIL), WHEEL, table["slip"].to_numpy(), 0.010)
    assert_allclose(forces.normal, table["normal_force [N]"], rtol=1e-9)
    assert_allclose(forces.drawbar_pull, table["drawbar_pull [N]"], atol=1e-9)


def test_the_noise_is_that_of_the_study() -> None:
    """Over many rows the scatter about the model has the standard deviation asked for."""
    many = study(rows=4000)
    exact = simulate(
        study(rows=4000, noise=dict.fromkeys(("sinkage", "drawbar_pull", "resistance_moment"), 1e-12)), SOIL
    )
    scatter = simulate(many, SOIL, seed=3) - exact
    for column, sd in (("sinkage [mm]", 1.0), ("drawbar_pull [N]", 1.0), ("resistance_moment [N m]", 0.2)):
        assert abs(scatter[column].std() / sd - 1) < 4 / np.sqrt(2 * 4000)
        assert abs(scatter[column].mean()) < 4 * sd / np.sqrt(4000)


def test_estimated_noise_is_simulated_at_its_value() -> None:
    """The scatter follows noise_<channel>, by default the median of its prior."""
    law = {"estimate": {"dist": "uniform", "lower": "1 N", "upper": "9 N"}}
    noise = {"sinkage": 1e-3, "drawbar_pull": law, "resistance_moment": 0.2}
    noisy = study(rows=4000, noise=noise)
    known = simulate(study(rows=4000), SOIL, seed=1)["drawbar_pull [N]"]
    wide = simulate(noisy, {**SOIL, "noise_drawbar_pull": 7.0})["drawbar_pull [N]"]
    assert (wide - known).std() == pytest.approx(6.0, rel=0.05)  # same seed: (7 - 1) standard normals
    assert true_values(study(noise=noise), SOIL).values["noise_drawbar_pull"] == pytest.approx(5.0, rel=0.1)


def test_same_seed_same_readings() -> None:
    """Readings depend on the seed alone."""
    pd.testing.assert_frame_equal(simulate(study(), SOIL, seed=5), simulate(study(), SOIL, seed=5))
    assert not simulate(study(), SOIL, seed=5).equals(simulate(study(), SOIL, seed=6))


def test_missing_readings_stay_missing() -> None:
    """A cell that was not measured is not simulated, and a row out of use stays so."""
    base = load_study(HIT)
    gap = base.observations.values["drawbar_pull"].copy()
    gap[2] = np.nan
    table = simulate(base.with_data({"drawbar_pull": gap}))
    assert table["drawbar_pull [N]"].isna().tolist() == [False, False, True, False, False, False]
    assert table["use"].tolist() == [0, 1, 1, 1, 1, 1]


def test_where_true_values_come_from() -> None:
    """Given before [truth] before fixed before [published] before the median of the prior."""
    tables: dict[str, Any] = {
        "priors": {"set": "paper-box", "c": "1 kPa"},
        "published": {"source": "x", "c": 5.0, "n0": 0.7},
    }
    origins = true_values(study(**tables), {"phi": "30 deg"}).origins
    assert (origins["phi"], origins["c"], origins["n0"], origins["K"]) == (
        "given",
        "fixed",
        "published",
        "prior median",
    )
    told = true_values(study(**tables, truth={"c": 2.0}))
    assert (told.values["c"], told.origins["c"], told.origins["n0"]) == (2.0, "truth", "prior median")


def test_the_prior_median_is_one_of_the_cut_prior() -> None:
    """The box's own centre, c1 = c2 = 0, has no contact angle; the median used has."""
    base = study()
    values = true_values(base).values
    density = posterior(base)
    centre = np.array([[law.median for law in base.prior.laws.values()]])
    assert density.reasons(centre)[0] != 0
    assert density.reasons(np.array([[values[name] for name in density.names]]))[0] == 0


def test_values_without_an_answer_are_refused() -> None:
    """The reason is named; a name or unit that is wrong, too."""
    with pytest.raises(SupportError, match="nothing can be simulated with these values: θm outside"):
        simulate(study(), {**SOIL, "c1": 1.5})
    with pytest.raises(StudyError, match=r"unknown parameter 'Phi' \(did you mean 'phi'\?\)"):
        simulate(study(), {"Phi": 0.5})


@pytest.mark.parametrize("drive", ["load", "sinkage"])
def test_a_simulated_study_reads_back_as_the_same_study(tmp_path: Path, drive: str) -> None:
    """Model, wheels, noise and priors survive the file; the truth stands in it."""
    phi = Law("truncnorm", {"a": -2.0, "b": 2.0, "loc": 0.5, "scale": 0.1})
    noise = {"drawbar_pull": {"estimate": {"dist": "halfnorm", "scale": 1.0}}, "normal_force": 2.0, "sinkage": 1e-3}
    noise["resistance_moment"] = {"fraction": 0.03, "floor": 0.1}
    base = study(
        drive=drive,
        noise=noise,
        model="M2",
        priors={"set": "paper-box", "phi": phi, "c3": -0.1},
        least_squares={"hold": {"Ks": 2.5e6}},
        title='A "quoted" title',
        model_options={"shear_start": "rim"},
    )
    truth = write_simulated(base, tmp_path / "new", seed=4, truth={**SOIL, "c3": -0.1})
    again = load_study(tmp_path / "new")
    assert (again.kind, again.model, again.drive, again.title) == (
        "simulated",
        base.model,
        drive,
        'A "quoted" title, simulated',
    )
    assert again.truth is not None
    assert again.truth.values == truth.values
    assert again.fingerprint["study"] == base.fingerprint["study"]
    assert again.prior.names == base.prior.names
    assert again.prior.laws["phi"].shape == pytest.approx(dict(phi.shape))
    assert again.noise.keys() == base.noise.keys()
    assert again.least_squares.hold == {"Ks": 2.5e6}
    assert_allclose(again.observations.slip, base.observations.slip)


def test_simulated_folders_appear_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """An existing folder is left alone; a failure half-way leaves no folder of that name."""
    base = study()
    (tmp_path / "old").mkdir()
    with pytest.raises(ResultError, match=r"old' exists already: give another folder with --out"):
        write_simulated(base, tmp_path / "old", truth=SOIL)
    with pytest.raises(ResultError, match=r"cannot be made: the folder '.*missing' does not exist"):
        write_simulated(base, tmp_path / "missing" / "new", truth=SOIL)
    monkeypatch.setattr("bayesterra.analysis.simulation.write_text", full_disk(1))
    with pytest.raises(ResultError, match="cannot be written: No space left"):
        write_simulated(base, tmp_path / "new", truth=SOIL)
    assert not (tmp_path / "new").exists()


def full_disk(after: int) -> Callable[[Path, str], None]:
    """A writer that fails after a number of files."""
    written: list[Path] = []

    def write(path: Path, text: str) -> None:
        if len(written) == after:
            raise OSError(28, "No space left on device")
        written.append(path)
        path.write_text(text)

    return write


def test_the_command_writes_a_study_that_checks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Through the command line: the values used are shown, and the new folder is a good study."""
    out = tmp_path / "new"
    assert main(["simulate", str(HIT), "--out", str(out), "--seed", "7", "--set", "phi=30 deg"]) == 0
    shown = capsys.readouterr().out
    assert "given" in shown
    assert "published" in shown
    assert "30 deg" in shown
    study_file = load_study(out)
    assert study_file.truth is not None
    assert study_file.truth.values["phi"] == pytest.approx(np.radians(30))
    assert main(["simulate", str(HIT), "--out", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_deviations_of_single_readings_come_back_in_their_unit() -> None:
    """A column of standard deviations is simulated as it was stated, in mm and in N."""
    made = study()
    table = pd.DataFrame({"slip": made.observations.slip, "load [N]": 80.0, "sinkage [mm]": 10.0})
    sd = {"sinkage_sd [mm]": [0.5, 1.0, 1.5, 2.0], "drawbar_pull_sd [N]": [1.0, 2.0, 3.0, 4.0]}
    given = Study(
        pd.DataFrame({**table, "drawbar_pull [N]": 10.0, **sd}), {"A": WHEEL}, slip_reference="shearing",
        noise={"sinkage": 1e-3, "drawbar_pull": 1.0}, priors={"set": "paper-box"},
    )  # fmt: skip
    found = simulate(given, SOIL)
    for name, values in sd.items():
        assert_allclose(found[name], values, rtol=1e-12)
