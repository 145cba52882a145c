"""The tables [discrepancy], [ripple] and [slip]: what is read, refused, noted, written and named."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayesterra.analysis.simulation import simulate, write_simulated
from bayesterra.errors import StudyError
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.page import study_overview
from bayesterra.likelihood.posterior import posterior
from bayesterra.report.terminal import show
from bayesterra.runtime.checkpoints import digest
from bayesterra.study.canonical import identity, write_study
from bayesterra.study.study import Study, load_study
from tests.support.joint_rows import CASES, CURVES, ESTIMATED, NOISE, RIPPLE, TABLE, joined

TEXT = """
[discrepancy]
sinkage = { sd = "1 mm", length = 0.3 }
drawbar_pull = { sd = { estimate = { dist = "halfnorm", scale = "2 N" } }, length = 0.2, kernel = "matern52" }
[ripple]
drawbar_pull = { sd = "800 mN", memory = 2, period = 6 }
[slip]
sd = 0.01
"""


def file(folder: Path, tables: str) -> Path:
    """A study file with its measurements."""
    TABLE.to_csv(folder / "measurements.csv", index=False)
    head = """
model = "M2"
[data]
file = "measurements.csv"
slip_reference = "shearing"
[wheels.A]
radius = "135 mm"
width = "165 mm"
[wheels.B]
radius = "135 mm"
width = "110 mm"
[noise]
sinkage = "0.4 mm"
drawbar_pull = "0.5 N"
resistance_moment = "0.1 N m"
"""
    (folder / "study.toml").write_text(head + tables)
    return folder / "study.toml"


def test_the_tables_are_read_with_their_units(tmp_path: Path) -> None:
    """Sizes in SI; an estimated one is a free parameter behind the noises."""
    study = load_study(file(tmp_path, TEXT))
    sinkage, pull = study.errors.discrepancy["sinkage"], study.errors.discrepancy["drawbar_pull"]
    assert sinkage.size.sd == pytest.approx(1e-3)
    assert (sinkage.length, sinkage.kernel) == (0.3, "smooth")
    assert (pull.size.sd, pull.kernel, pull.parameter) == (None, "matern52", "discrepancy_drawbar_pull")
    ripple = study.errors.ripple["drawbar_pull"]
    assert ripple.size.sd == pytest.approx(0.8)
    assert (ripple.memory, ripple.period) == (2.0, 6.0)
    assert study.errors.slip is not None
    assert study.errors.slip.size.sd == 0.01
    assert study.prior.names[-1] == "discrepancy_drawbar_pull"
    assert posterior(study).noise_values(np.arange(9.0)[None]).tolist() == [[8.0]]


CURVE, WAVE = "[discrepancy]\nsinkage = { %s }", "[ripple]\nsinkage = { %s }"


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ("[discrepancy]\npull = { sd = '1 N', length = 0.3 }", "[discrepancy] channel 'pull' is unknown"),
        ("[discrepancy]\nslip = { sd = 0.1, length = 0.3 }", "channel 'slip' is never an outcome"),
        (CURVE % "sd = '1 mm'", "'sinkage' needs a 'length', the slip over which"),
        (CURVE % "length = 0.3", "'sinkage' needs an 'sd', e.g. \"0.02 m\""),
        (CURVE % "sd = '1 N', length = 0.3", "the unit 'N' is not a unit of length"),
        (CURVE % "sd = '0 mm', length = 0.3", "'sinkage' 'sd' must be above 0 (got 0)"),
        (CURVE % "sd = '1 mm', length = 0", "'sinkage.length' must be a slip above 0"),
        (
            CURVE % "sd = '1 mm', length = 0.3, kernel = 'rough'",
            "'sinkage.kernel' must be one of smooth, matern52 (got 'rough')",
        ),
        (CURVE % "sd = '1 mm', lenght = 0.3", "unknown key 'lenght' (did you mean 'length'?)"),
        (
            CURVE % "sd = { estimate = { dist = 'norm', scale = '1 mm' } }, length = 0.3",
            "'sinkage' an estimated 'sd' needs a law of numbers from 0 on, e.g. halfnorm",
        ),
        (
            CURVE % "sd = { dist = 'halfnorm' }, length = 0.3",
            "'sinkage' 'sd' must be a value or { estimate = { dist = ... } }",
        ),
        (WAVE % "sd = '1 mm'", "[ripple] 'sinkage' needs a 'memory', the number of rows"),
        (WAVE % "sd = '1 mm', memory = 0", "'sinkage.memory' must be a number of rows above 0"),
        (WAVE % "sd = '1 mm', memory = 2, period = 1", "'sinkage.period' must be 2 rows or more"),
        ("[slip]\nsd = '1 mm'", "[slip] 'slip.sd'"),
        ("[slip]\nerror = 0.1", "[slip] unknown key 'error'"),
        ("[pooling]\nby = 'run'\nseparate = ['K']\n" + TEXT, "[discrepancy] is one curve per wheel"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path: Path, tables: str, message: str) -> None:
    """Naming table, channel and key, and what must hold."""
    with pytest.raises(StudyError) as error:
        load_study(file(tmp_path, tables))
    assert message in str(error.value)
    assert "\n" not in str(error.value)


def test_heavy_tails_and_latent_loads_go_with_them() -> None:
    """See tests/likelihood/test_sites_heavy_tails.py for the laws."""
    noise = {**NOISE, "drawbar_pull": {"sd": 0.5, "dof": 4}}
    force = {**noise, "normal_force": 2.0}
    assert joined("phi", discrepancy=CURVES, slip={"sd": 0.01}, noise=noise).errors.slip
    assert joined("phi", drive="both", ripple=RIPPLE, noise=force, load_range=["40 N", "120 N"]).errors.ripple


def test_notes_say_what_is_not_used_and_what_is_meant() -> None:
    """A channel that is not measured; several loads under one curve."""
    data = TABLE.drop(columns=["sinkage [mm]"]).assign(**{"load [N]": [60, 70, 80, 80, 80, 80, 80]})
    notes = joined("phi", data=data, discrepancy=CURVES).notes
    assert "discrepancy of sinkage is not used, as it is not a measured outcome of the drive 'load'" in notes
    assert "the discrepancy of A is one curve over slip for all of its loads, 60 to 80 N" in notes


@pytest.mark.parametrize("tables", CASES.values(), ids=CASES)
def test_a_saved_study_is_the_same_study(tmp_path: Path, tables: dict[str, Any]) -> None:
    """Written out and read again: the same fingerprint, the same density."""
    study = joined("phi", "n0", **tables)
    write_study(study, tmp_path)
    again = load_study(tmp_path)
    assert again.fingerprint["study"] == study.fingerprint["study"]
    assert again.errors == study.errors
    x = posterior(study).prior.quantile(np.full((1, len(study.prior.names)), 0.45))
    np.testing.assert_allclose(
        posterior(again).log_density(x), posterior(study).log_density(x), rtol=1e-9, equal_nan=False
    )


def test_fingerprint_and_identity_know_of_them() -> None:
    """A run does not go on with another discrepancy; without one nothing changes."""
    plain, curved = joined("phi"), joined("phi", discrepancy=CURVES)
    longer = {**CURVES, "sinkage": {"sd": 1e-3, "length": 0.4}}
    other = joined("phi", discrepancy=longer)
    assert len({study.fingerprint["study"] for study in (plain, curved, other)}) == 3
    assert identity(curved, 1) != identity(other, 1)
    assert digest(identity(joined("phi", **CASES["all"]), 1)) != digest(identity(curved, 1))
    assert not [name for name in identity(plain, 1) if "discrepancy" in name]
    assert type(posterior(plain).likelihood) is Likelihood


def test_check_says_them(capsys: pytest.CaptureFixture[str]) -> None:
    """A line each."""
    curves = {**CURVES, "drawbar_pull": {"sd": ESTIMATED, "length": 0.2}}
    show(study_overview(joined("phi", discrepancy=curves, ripple=RIPPLE, slip={"sd": 0.01})))
    shown = " ".join(capsys.readouterr().out.replace("│", " ").split())
    assert "one for each wheel: z (sd 1 mm, over slips of 0.3) and FDP (sd estimated, over slips of 0.2" in shown
    assert "MDR (sd 0.2 N m, correlation falling to 1/e over 3 rows, crests 4 rows apart)" in shown
    assert "Slips are read with an error of sd 0.01" in shown
    assert "taken to first order" not in shown
    data = TABLE.assign(slip=TABLE["slip"].replace(0.35, 0.49))
    show(study_overview(joined("phi", data=data, slip={"sd": 0.01})))
    shown = " ".join(capsys.readouterr().out.split())
    assert "Note: errors of slip (sd 0.01) are taken to first order, which is doubtful in row 3 within" in shown


def test_simulated_readings_hang_together(tmp_path: Path) -> None:
    """Readings of many seeds have the spread of noise and discrepancy; the folder states both again."""
    study = joined("phi", discrepancy=CURVES)
    tables = [simulate(study, {"phi": 0.5}, seed) for seed in range(300)]
    pull = np.array([one["drawbar_pull [N]"].to_numpy() for one in tables])
    assert pull[:, 0].std() == pytest.approx(np.hypot(2.0, 0.5), rel=0.15)
    assert np.corrcoef(pull[:, 0], pull[:, 1])[0, 1] > 0.6  # slips 0.1 and 0.2 of one wheel
    assert abs(np.corrcoef(pull[:, 1], pull[:, 4])[0, 1]) < 0.2  # the same slip of another wheel
    estimated = joined("phi", discrepancy={"drawbar_pull": {"sd": ESTIMATED, "length": 0.2}})
    made = write_simulated(estimated, tmp_path / "made", truth={"discrepancy_drawbar_pull": 1.5})
    assert made.values["discrepancy_drawbar_pull"] == 1.5
    again = load_study(tmp_path / "made")
    assert again.errors == estimated.errors
    assert again.truth is not None
    assert again.truth.values["discrepancy_drawbar_pull"] == 1.5


def test_an_empty_table_tells_nothing() -> None:
    """As the template has them."""
    assert not joined("phi", discrepancy={}, ripple={}, slip={}).errors


def test_objects_pass_as_they_are() -> None:
    """What a study holds can be given to another one."""
    first = joined("phi", **CASES["all"])
    errors = first.errors
    second: Study = joined("phi", discrepancy=errors.discrepancy, ripple=errors.ripple, slip=errors.slip)
    assert second.fingerprint == first.fingerprint
    assert isinstance(second.observations.rows, tuple)
    assert pd.DataFrame(TABLE).shape[0] == len(second.observations)
