"""Every command on a study of a wheel with plates, and on plates alone: it works, or says why not and what then."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence, default_rng

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.checking.short_runs import Fitted
from bayesterra.likelihood.posterior import draw_cut_prior
from bayesterra.stats.mixture import systematic
from bayesterra.study.canonical import write_study
from bayesterra.study.study import Study
from tests.support.adaptation import HALF, little_adaptation, little_leaving_out
from tests.support.pages import plain_pages
from tests.support.shared import Shared
from tests.support.soil_tests import KNOWN, SOIL, both, plates, wheel_table

MODULI = {"kc": SOIL["kc"], "kphi": bt.Law("uniform", lower=2e5, upper=2e6)}
KINDS: dict[str, Callable[[], Study]] = {
    "both": lambda: both(priors=MODULI),
    "alone": lambda: plates(priors={**MODULI, "n": bt.Law("uniform", lower=0.5, upper=1.8)}, noise=KNOWN),
}
ABOUT_WHEELS = "is about wheels, and this study has soil tests only: add [data] and [wheels], or take their posterior"


@pytest.fixture(scope="session")
def results(shared: Shared, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], Path]:
    """Folder with a study, and its result where a command asks for it, by kind."""

    def run(kind: str) -> bt.Result:
        with little_adaptation(HALF), little_leaving_out():
            return bt.run(KINDS[kind](), seed=1)

    folders: dict[str, Path] = {}

    def folder(kind: str, command: str) -> Path:
        if kind not in folders:
            folders[kind] = tmp_path_factory.mktemp(kind)
            (folders[kind] / "study").mkdir()
            write_study(KINDS[kind](), folders[kind] / "study")
            wheel_table().to_csv(folders[kind] / "rows.csv", index=False)
        if "R" in command.split() and not (folders[kind] / "result").exists():
            with plain_pages():
                shared(f"commands, {kind}", lambda: run(kind)).save(folders[kind] / "result")
        return folders[kind]

    return folder


def called(folder: Path, command: str, capsys: pytest.CaptureFixture[str], tmp_path: Path) -> tuple[int, str]:
    """Exit code of a command, in which S is the study, R the result and O a new folder; what it printed on errors."""
    places = {"S": folder / "study", "R": folder / "result", "O": tmp_path / "out", "D": folder / "rows.csv"}
    with little_adaptation(HALF), little_leaving_out():
        code = main([str(places.get(word, word)) for word in command.split()])
    return code, capsys.readouterr().err


ALWAYS = ["check S", "simulate S --out O", "identify R --out O --quiet", "identify S --prior-only"]
OF_WHEELS = {
    "fit S": "fit", "run S --prior-only --out O": "run --prior-only", "predict R --out O": "predict",
    "compare R R --out O": "compare", "design R --slip 0.1,0.5 --out O --quiet": "design",
    "holdout S --out O --quiet --by slip": "holdout", "follow R --data D --quiet --out O": "follow",
}  # fmt: skip
SLOW = ("predict", "holdout", "design", "compare", "identify R", "follow", "run S")


def marked(command: str, *values: str) -> object:
    """A case, slow where it takes some seconds."""
    marks = [pytest.mark.slow] if command.startswith(SLOW) else []
    return pytest.param(command, *values, marks=marks, id=command)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("command", [marked(command) for command in ALWAYS])
def test_commands_that_take_every_study(
    results: Callable[[str, str], Path], kind: str, command: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Exit code 0, nothing on standard error."""
    assert called(results(kind, command), command, capsys, tmp_path) == (0, "")


@pytest.mark.parametrize("command", [marked(command) for command in OF_WHEELS])
def test_commands_about_wheels_take_a_study_with_a_wheel(
    results: Callable[[str, str], Path], command: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """Exit code 0: soil tests beside a wheel change nothing of that."""
    code, errors = called(results("both", command), command, capsys, tmp_path)
    assert (code, errors) == (0, "")


@pytest.mark.parametrize(("command", "name"), OF_WHEELS.items(), ids=OF_WHEELS.values())
def test_commands_about_wheels_say_what_plates_alone_lack(
    results: Callable[[str, str], Path], command: str, name: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """One line with the reason and the mend, and nothing is written."""
    code, errors = called(results("alone", command), command, capsys, tmp_path)
    assert code == 2
    assert f"'{name}' {ABOUT_WHEELS}" in errors
    assert errors.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_a_stream_begins_from_the_posterior_of_soil_tests(
    results: Callable[[str, str], Path], capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """From the study alone, whose prior knows no tests, it is refused with the mend."""
    code, errors = called(results("both", "follow S --data D --quiet"), "follow S --data D --quiet", capsys, tmp_path)
    assert code == 2
    assert "run the study first and follow its result" in errors


def by_weights(study: Study, seed: SeedSequence) -> Fitted:
    """The posterior of a study by weights of draws of its prior."""
    rng, target = default_rng(seed), bt.posterior(study)
    x = draw_cut_prior(target, 40_000, rng).x
    level = target.log_prior_and_likelihood(x)[1]
    weights = np.exp(level - level.max())
    return Fitted(x[systematic(weights / weights.sum(), 400, rng)], 400.0, 1.0, True)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
def test_studies_with_soil_tests_are_calibrated(kind: str) -> None:
    """Readings of wheel and plates are simulated anew; quantities of the wheel where there is one."""
    n0, phi = SOIL["n"], 0.54
    study = (
        both(priors={**MODULI, "n0": n0, "phi": phi})
        if kind == "both"
        else plates(priors={**MODULI, "n": n0}, noise=KNOWN)
    )
    found = bt.calibrate(study, n=20, fit=by_weights)
    assert set(found.table["status"]) == {"converged"}
    assert ("sinkage_at_largest_slip" in found.quantities) == (kind == "both")
    assert found.tests.set_index("quantity")["p_value"].min() > 1e-4


def test_simulated_studies_have_tests_of_their_own(results: Callable[[str, str], Path], tmp_path: Path) -> None:
    """Truth in the file, other readings at the same sinkages, for the wheel and the plates; said to be simulated."""
    for kind in KINDS:
        assert main(["simulate", str(results(kind, "simulate S") / "study"), "--out", str(tmp_path / kind)]) == 0
        made, given = bt.load_study(tmp_path / kind), KINDS[kind]()
        for name, test in made.soil_tests.items():
            np.testing.assert_allclose(test.readings.path, given.soil_tests[name].readings.path)
            assert not np.allclose(test.readings.stress, given.soil_tests[name].readings.stress)
            assert test.stated.kind == made.kind == "simulated"
        assert made.truth is not None
        assert np.isfinite(bt.posterior(made).log_density(np.array([[made.truth.values[n] for n in made.prior.names]])))
        table = pd.DataFrame(made.observations.values)
        assert len(table) == (5 if kind == "both" else 0)
