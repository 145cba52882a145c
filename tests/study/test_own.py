"""Models of one's own in studies: what a file may load, what is refused, and what becomes known by name."""

import os
import pickle
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats

from bayesterra.errors import StudyError
from bayesterra.parameters import PARAMETERS
from bayesterra.stats.laws import Law
from bayesterra.study.canonical import identity, write_study
from bayesterra.study.own import allowing_code, own_model
from bayesterra.study.study import Study, load_study
from tests.support.one_wheel import WHEEL, MakeTable
from tests.support.own_laws import Loud, PaperLaw, Plate, Pressing, TwoForces

PLATE = 'use = "tests.support.own_laws:Plate"'
NOISE = {"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3}


def plate_study(make_table: MakeTable, **options: Any) -> Study:
    """Readings of a wheel under the law of a stranger."""
    given: dict[str, Any] = {"model": Plate(), "priors": {}, **options}
    return Study(make_table(), {"Wh32": WHEEL}, slip_reference="shearing", noise=NOISE, **given)


def test_a_law_from_python_is_a_model_of_a_study(make_table: MakeTable) -> None:
    """Its own parameter is flat on its range, in its unit; those that the package knows come from the set."""
    study = plate_study(make_table, priors={"c": 200.0})
    assert study.prior.names == ("phi", "K", "stiffness")
    assert study.prior.laws["stiffness"].range == (0.0, 50e6)
    assert PARAMETERS["stiffness"].header == "stiffness [kPa/mm]"
    assert study.prior.laws["stiffness"].source == "flat on its range in the model Plate"


def test_a_file_that_names_code_runs_it_only_where_allowed(make_table: MakeTable, tmp_path: Path) -> None:
    """Written and read back it is the same study; without leave it is refused, and says what it would run."""
    study = plate_study(make_table)
    write_study(study, tmp_path)
    assert PLATE in (tmp_path / "study.toml").read_text()
    with pytest.raises(
        StudyError, match=r"runs the code of the module 'tests.support.own_laws': allow it by --allow-code"
    ):
        load_study(tmp_path)
    again = load_study(tmp_path, allow_code=True)
    assert again.fingerprint == study.fingerprint
    with allowing_code():
        assert load_study(tmp_path).model.name == "Plate"
    with pytest.raises(StudyError, match="--allow-code"):
        load_study(tmp_path)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (
            'use = "wong-reese"',
            r"'use' must be \"module:Class\" or an installed model \(got 'wong-reese'\) \(did you mean",
        ),
        ('use = "tests.support.nowhere:Plate"', r"cannot be loaded \(ModuleNotFoundError: No module named"),
        ('use = "tests.support.own_laws:Plates"', r"cannot be loaded \(AttributeError: .*has no attribute 'Plates'"),
        (f"{PLATE}\nwidth = 3", r"cannot be loaded \(TypeError: Plate\(\) takes no arguments\)"),
        ('use = "tests.support.own_laws:Path"', r"cannot be loaded|needs 'parameters'"),
        ("use = 3", r"needs 'use', \"module:Class\" or the name of an installed model \(got 3\)"),
        ('model = "M1"', r"needs 'use'"),
    ],
)
def test_what_is_no_model_is_refused_in_one_line(
    table: str, message: str, make_table: MakeTable, tmp_path: Path
) -> None:
    """Each with the place, the reason and, where there is one, the near name."""
    write_study(plate_study(make_table), tmp_path)
    file = tmp_path / "study.toml"
    file.write_text(file.read_text().replace(PLATE, table))
    with pytest.raises(StudyError, match=message):
        load_study(tmp_path, allow_code=True)


def test_parameters_that_are_wrong_are_refused(make_table: MakeTable) -> None:
    """A misspelt name, the name of another quantity, a prior for what the model has not, no prior and no range."""
    with pytest.raises(
        StudyError, match=r"model Loud has an unknown parameter 'stifness'.*describe it by ModelParameter"
    ):
        own_model(Loud())
    with pytest.raises(StudyError, match="'sinkage' of a model has the name of another quantity"):
        own_model(Pressing())
    with pytest.raises(StudyError, match=r"'n1' is no parameter of the model Plate \(it has c, phi, K, stiffness\)"):
        plate_study(make_table, priors={"n1": 1.0})
    with pytest.raises(StudyError, match=r"\[model_options\] belong to the models of Ding et al. 2015"):
        plate_study(make_table, model_options={"shear_start": "rim"})
    with pytest.raises(StudyError, match=r"the model TwoForces fails \(ValueError: .*must return F_N, F_DP and M_DR"):
        plate_study(make_table, model=TwoForces())
    with pytest.raises(StudyError, match="the model int needs 'parameters', a tuple of names, and a method 'forces'"):
        plate_study(make_table, model=3)


def test_options_of_a_dataclass_are_kept(make_table: MakeTable, tmp_path: Path) -> None:
    """A law made with arguments is made with the same ones again; a resumed run notes another code or option."""
    study = plate_study(make_table, model=PaperLaw("M3"), priors={"set": "paper-box"})
    write_study(study, tmp_path)
    again = load_study(tmp_path, allow_code=True)
    assert again.model.options == {"use": "tests.support.own_laws:PaperLaw", "model": "M3"}
    other = plate_study(make_table, model=PaperLaw("M2"), priors={"set": "paper-box"})
    changed = {name for name, value in identity(study, 1).items() if identity(other, 1).get(name) != value}
    assert changed == {"[model] {} {{}}".format("model")}
    assert len(identity(study, 1)["code of the model"]) == 64


def test_another_process_knows_the_parameters(make_table: MakeTable, tmp_path: Path) -> None:
    """A study that is sent to a worker brings its parameters along."""
    (tmp_path / "study").write_bytes(pickle.dumps(plate_study(make_table)))
    code = "import pickle, sys; s = pickle.load(open(sys.argv[1], 'rb')); import bayesterra as bt;"
    code += (
        " x = s.prior.sample(3, __import__('numpy').random.default_rng(1)); print(bt.posterior(s).log_density(x).shape)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "study")],
        capture_output=True, text=True, check=True, env={**os.environ, "PYTHONPATH": "."},
    )  # fmt: skip
    assert done.stdout.strip() == "(3,)"


@pytest.mark.parametrize(
    ("frozen", "same"),
    [
        (stats.norm(200.0, 50.0), Law("norm", {"loc": 200.0, "scale": 50.0})),
        (stats.gamma(2.0, scale=100.0), Law("gamma", {"a": 2.0, "scale": 100.0})),
        (stats.uniform(10.0, 40.0), Law("uniform", lower=10.0, upper=50.0)),
        (stats.loguniform(10.0, 400.0), Law("loguniform", lower=10.0, upper=400.0)),
    ],
    ids=lambda of: getattr(getattr(of, "dist", None), "name", ""),
)
def test_a_frozen_law_is_a_prior(frozen: Any, same: Law, make_table: MakeTable) -> None:
    """One of scipy.stats, by its own arguments in their order or by name."""
    law = plate_study(make_table, priors={"c": frozen}).prior.laws["c"]
    assert law == same
    at = np.array([0.1, 0.5, 0.9])
    assert law.quantile(at) == pytest.approx(frozen.ppf(at))


@pytest.mark.parametrize("path", ["np.load", "WongReece.__init__.__globals__", "np.random.default_rng"])
def test_what_our_modules_import_is_not_ours(path: str, make_table: MakeTable, tmp_path: Path) -> None:
    """A file reaches no function through the module of a model that needs no leave."""
    write_study(plate_study(make_table), tmp_path)
    file, marker = tmp_path / "study.toml", tmp_path / "code.npy"
    np.save(marker, np.array([print], dtype=object))  # a pickle
    keys = f'use = "bayesterra.models.examples:{path}"\nfile = "{marker}"\nallow_pickle = true'
    file.write_text(file.read_text().replace(PLATE, keys))
    with pytest.raises(StudyError, match=r"runs the code of the module 'bayesterra.models.examples': allow it by"):
        load_study(tmp_path)
