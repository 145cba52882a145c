"""Soils for simulators: read back by the simulator's own words, the wheel on them by quadrature, the error as it is."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad

from bayesterra.analysis.export import SOILS, Export, chrono_scm, on_scm, projection
from bayesterra.errors import ResultError
from bayesterra.likelihood.forward import reference_load
from bayesterra.models import Conditions, Wheel
from bayesterra.prediction.prediction import spread
from bayesterra.study.result import Result

ARGUMENTS = (
    "Bekker Kphi", "Bekker Kc", "Bekker n exponent", "Mohr cohesive limit", "Mohr friction limit",
    "Janosi shear coefficient", "Elastic stiffness", "Damping",
)  # fmt: skip
"""Of ``SCMTerrain::SetSoilParameters``, by the names that Chrono's node for co-simulation looks up."""


def set_soil_parameters(text: str) -> list[float]:
    """What Chrono would read from a file."""
    table = json.loads(text)["Soil parameters"]
    assert set(table) == set(ARGUMENTS)
    return [float(table[name]) for name in ARGUMENTS]


def test_files_hold_the_draws(small_result: Result, tmp_path: Path) -> None:
    """Every file is one draw of the posterior, its exponent at the slip; the number and names are told."""
    made = Export(result=small_result, asked={"to": ["chrono-scm"]}, slips=(0.1, 0.4))
    made.save(tmp_path / "out")
    files = sorted((tmp_path / "out").glob("scm-slip-0.4-*.json"))
    assert 50 < len(files) <= SOILS
    prior, draws = small_result.study.prior, small_result.draws["posterior"].to_dataset()
    for file in files[:: len(files) // 5]:
        content = json.loads(file.read_text())["bayesterra"]
        x = np.array([[float(draws[name][content["chain"], content["draw"]]) for name in small_result.names]])
        value = {name: float(prior.column(name, x)[0]) for name in ("Ks", "n0", "n1", "c", "phi", "K")}
        expected = [value["Ks"], 0.0, value["n0"] + 0.4 * value["n1"], value["c"], np.degrees(value["phi"]), value["K"]]
        read = set_soil_parameters(file.read_text())
        assert read[:6] == pytest.approx(expected, rel=1e-12)
        assert read[6] > read[0]
    assert "SCM soils projected at slip 0.4 are off the model by: wheel sinkage" in str(made.overview()[-1])


def test_the_error_is_that_of_a_wheel_on_such_a_soil(small_result: Result) -> None:
    """Normal force and pull of SCM's laws integrated along the arc at the sinkage found, one draw at a time."""
    slip = 0.3
    wheel, load = next(iter(small_result.study.wheels.values())), reference_load(small_result.study)
    r, b = wheel.radius, wheel.width
    draws, _ = spread(small_result, SOILS)
    rows = Conditions.of(Wheel(r, b), np.array([slip]))
    found = on_scm(small_result, draws, slip, rows, np.array([load]))[:, 0]
    for text, (depth, pull, _) in zip(list(chrono_scm(small_result, (slip,)).values())[:4], found, strict=False):
        k, _, n, c, phi, K, *_ = set_soil_parameters(text)
        front = np.arccos(1 - depth / r)

        def force(angle: float, which: int) -> float:
            normal = k * (r * (np.cos(angle) - np.cos(front))) ** n  # noqa: B023
            travel = r * (front - angle - (1 - slip) * (np.sin(front) - np.sin(angle)))  # noqa: B023
            shear = (c + normal * np.tan(np.radians(phi))) * (1 - np.exp(-travel / K))  # noqa: B023
            cos, sin = np.cos(angle), np.sin(angle)
            return float(r * b * (normal * cos + shear * sin, shear * cos - normal * sin)[which])

        assert quad(force, 0, front, args=(0,))[0] == pytest.approx(load, rel=1e-6)
        assert quad(force, 0, front, args=(1,))[0] == pytest.approx(pull, rel=1e-6)
    table = projection(small_result, (slip,)).set_index("quantity")
    assert table["answered"].min() == 1.0
    assert table.loc["sinkage", "scm"] == pytest.approx(1e3 * np.median(found[:, 0]), rel=0.1)
    assert table["error_05"].lt(table["error_50"]).all()
    assert (table["scm"] - table["model"]).between(table["error_05"] - 1, table["error_95"] + 1).all()


def test_what_a_posterior_lacks_is_said(small_result: Result) -> None:
    """A study whose model has no deformation modulus makes no SCM soil."""
    study = small_result.study
    entries = {name: entry for name, entry in study.prior.entries.items() if name != "K"}
    prior = replace(study.prior, entries=entries, reads=())
    with pytest.raises(
        ResultError, match="chrono-scm needs K, which this posterior lacks: add a soil test that tells it"
    ):
        chrono_scm(replace(small_result, study=study.having(prior=prior)))


def test_slips_that_are_none_are_refused(small_result: Result) -> None:
    """Outside [0, 1), and without a simulator to take them."""
    with pytest.raises(ResultError, match=r"^'slip' must lie in \[0, 1\) \(got 1.5\)$"):
        Export(result=small_result, asked={"to": ["chrono-scm"]}, slips=(0.2, 1.5)).tables()
    with pytest.raises(ResultError, match=r"^'--slip' goes with '--to chrono-scm'$"):
        Export(result=small_result, slips=(0.2,))
