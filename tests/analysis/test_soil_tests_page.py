"""Whole analyses of small soil tests, alone and beside a wheel: recovery, verdicts, page, folders."""

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
from bayesterra.analysis import inference
from bayesterra.analysis.figures import _limits as corner_limits
from bayesterra.analysis.figures import corner
from bayesterra.errors import ResultError
from bayesterra.identifiability.evidence_page import combinations
from bayesterra.likelihood.page import study_overview
from bayesterra.parameters import PARAMETERS
from bayesterra.report.terminal import show
from bayesterra.stats.quantile_law import QuantileLaw
from bayesterra.study.page import axis
from bayesterra.study.result import Result
from bayesterra.study.study import Study
from tests.support.adaptation import HALF, little_adaptation, little_leaving_out
from tests.support.pages import plain_pages, undrawn
from tests.support.shared import Shared
from tests.support.soil_tests import KNOWN, SOIL, WHEEL, both, plate_table, plates, shear

Analysed = Callable[[str], Result]
ALONE = {
    "report.html", "draws.nc", "run.json", "SHA256SUMS", "study.toml", "summary.csv", "least_squares.csv",
    "identifiability.csv", "new_tests.csv", "bands.csv",
}  # fmt: skip


@pytest.fixture(scope="session")
def analysed(shared: Shared) -> Analysed:
    """Results by kind of study, each analysed once."""
    made: dict[str, Callable[[], Study]] = {
        "plates": plates,
        "plates of one memory": lambda: plates(noise=KNOWN),
        "one plate": lambda: plates((0.03,)),
        "shear": shear,
        "one stress": lambda: shear((15e3,)),
        "both": lambda: both(ring=True),
    }

    def result(kind: str) -> Result:
        with little_adaptation(HALF), little_leaving_out():
            return bt.run(made[kind](), seed=1)

    return lambda kind: shared(f"soil test, {kind}", lambda: result(kind))


def test_moduli_at_a_sinkage_are_drawn_where_they_are(analysed: Analysed) -> None:
    """Their laws are about parts of a pressure: axes, panels and combinations take the moduli themselves."""
    result = analysed("plates")
    for name in ("kc", "kphi"):
        along, prior, draws = axis(result, name), result.column(name, "prior"), result.column(name)
        assert (np.quantile(prior, [0.01, 0.99]) >= along.low).all()
        assert (np.quantile(prior, [0.01, 0.99]) <= along.high).all()
        assert along.low <= draws.min() < draws.max() <= along.high
    assert axis(result, "n").bounds == result.study.prior.laws["n"].range
    for low, high in corner_limits(result, result.values() / [PARAMETERS[name].scale for name in result.names]):
        assert low < high
    assert corner(result).patches or corner(result).artists
    drawn = [text.get_text() for text in combinations(result).get_yticklabels()]
    record = result.record["directions"]
    assert drawn == [f"{share:.2f}" for share in np.clip(record["contractions"], 0.0, 1.0)]


@pytest.mark.slow
def test_identify_says_of_moduli_at_a_sinkage_what_the_run_says(analysed: Analysed) -> None:
    """Both hold what the laws are about against the laws' ranges; the moduli lie far beyond these."""
    result = analysed("plates")
    told = bt.identify(result, seed=1).verdicts.set_index("parameter")["verdict"]
    assert {name: told[name] for name in ("kc", "kphi", "n")} == words(result)


def words(result: Result) -> dict[str, str]:
    """Verdicts on the soil parameters."""
    table = result.identifiability.set_index("parameter")["verdict"]
    (test,) = result.study.soil_tests.values()
    return {name: str(table[name]) for name in test.soil}


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
    assert any("all plates have the radius 30 mm" in unseen for unseen in one.record["directions"]["unseen"])


@pytest.mark.slow
def test_two_stresses_separate_cohesion_from_friction_and_one_does_not(analysed: Analysed) -> None:
    """With one normal stress only the strength there is determined."""
    assert words(analysed("shear"))["phi"] == "determined"
    one = analysed("one stress")
    assert words(one)["c"] == words(one)["phi"] == "structurally not determined"
    assert any("all tests the normal stress 15 kPa" in unseen for unseen in one.record["directions"]["unseen"])


@pytest.mark.slow
def test_a_wheel_with_plates_and_a_ring_is_one_posterior(analysed: Analysed, tmp_path: Path) -> None:
    """Truth inside, all verdicts, one page with a section for the tests, and a folder that gives it back."""
    result = analysed("both")
    truth = {"kc": -1e3, "kphi": 900e3, "n0": 1.1, "K.ring": 0.009}
    for name, value in truth.items():
        low, high = np.quantile(result.draws["posterior"][name], [0.001, 0.999])
        assert low < value < high, name
    assert [verdict.name for verdict in result.verdicts] == ["Sampling", "Soil tests", "Fit", "Prediction", "Soil"]
    assert "failures" not in result.record
    report = result.save(tmp_path / "out")
    page = report.read_text(encoding="utf-8")
    for said in ('id="soil-tests"', "Bekker", "Janosi", "4 plate tests plates", 'id="checks"', "K</i>.ring"):
        assert said in page
    again = bt.load_result(tmp_path / "out")
    np.testing.assert_array_equal(again.values(), result.values())
    assert again.names == result.names
    pd.testing.assert_frame_equal(again.new_tests, result.new_tests)
    assert set(again.study.soil_tests) == {"plates", "ring"}
    density = bt.posterior(again.study).log_density(again.values()[:50])
    np.testing.assert_allclose(again.draws["sample_stats"]["lp"].to_numpy().ravel()[:50], density, rtol=1e-9)


def test_checks_that_fail_cost_no_posterior(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Draws and summary stand; page and terminal say what is not known."""

    def refuse(*_: object, **__: object) -> float:
        raise ValueError("all tail values are the same")

    monkeypatch.setattr(inference, "new_tests", refuse)
    monkeypatch.setattr(inference, "rows_of_tests", refuse)
    with little_adaptation(HALF), little_leaving_out():
        result = bt.run(plates((0.03,), noise=KNOWN), seed=1)
    assert set(result.record["failures"]) == {"left_out", "fits"}
    page = result.save(tmp_path / "out").read_text(encoding="utf-8")
    assert page.count("tests left out could not be computed (ValueError: all tail values are the same)") >= 1
    assert bt.load_result(tmp_path / "out").names == result.names


def test_a_misfit_is_the_first_thing_that_a_page_and_a_terminal_say(
    analysed: Analysed, capsys: pytest.CaptureFixture[str]
) -> None:
    """As with wheels: the page opens with it, and one line on standard error warns; else nothing does."""
    sound = analysed("plates of one memory")
    quiet = {"checks": {"levels of tests uniform": 0.3}, "alarm": False}
    loud = {"checks": {"levels of tests uniform": 0.001, "b": 0.4}, "alarm": True}
    alarmed = replace(sound, record={**sound.record, "soil_tests": loud})
    with undrawn():
        opening = alarmed.page().html().split("<main>")[1].lstrip()
    assert opening.startswith('<p class="quotable bad">Do not use: soil tests are not as the others predict them')
    assert '<p class="warning" role="alert">The model does <b>not fit</b> these readings: Soil tests' in opening
    show(alarmed.overview())
    printed = capsys.readouterr().err
    assert printed.startswith("warning: Soil tests: not as predicted.")
    assert printed.count("\n") == 1
    assert "(levels of tests uniform: p < 0.01)" in alarmed.sentence
    sound = replace(sound, record={**sound.record, "soil_tests": quiet})
    show(sound.overview())
    assert capsys.readouterr().err == ""
    with undrawn():
        assert "<b>not fit</b>" not in sound.page().html()


def test_a_check_says_where_the_laws_of_moduli_are_stated(capsys: pytest.CaptureFixture[str]) -> None:
    """At the reference sinkage, where one is given; else it is silent, as they are about the moduli."""
    show(study_overview(plates()))
    assert "Laws of kc and kφ are stated for kc z^n and kφ z^n, the parts of the pressure, at z = 10 mm." in (
        " ".join(capsys.readouterr().out.split())
    )
    show(study_overview(both()))
    assert "are stated for" not in capsys.readouterr().out


def test_a_result_of_tests_alone_is_a_whole_folder(analysed: Analysed, tmp_path: Path) -> None:
    """All files and none about wheels; draws by name over chain and draw; what is written is the same study."""
    result = analysed("plates of one memory")
    report = result.save(tmp_path / "out")
    assert {path.name for path in report.parent.iterdir()} == {*ALONE, "soil-test-plate.csv"}
    draws = xr.open_datatree(report.parent / "draws.nc", engine="h5netcdf").load()
    assert draws["posterior"]["kc"].dims == ("chain", "draw")
    np.testing.assert_array_equal(draws["posterior"]["n"], result.draws["posterior"]["n"])
    draws.close()
    for again in (bt.load_study(report.parent), bt.load_result(report.parent).study):
        assert again.prior.entries == result.study.prior.entries
        assert again.prior.reference == result.study.prior.reference
    record = json.loads((report.parent / "run.json").read_text(encoding="utf-8"))
    assert (record["verdict"]["converged"], record["model"]) == (True, "")
    page = report.read_text(encoding="utf-8")
    assert "Bekker" in page
    assert "http" not in page.replace("http://www.w3.org", "")
    with pytest.raises(ResultError, match="exists already"):
        result.save(tmp_path / "out")


def test_the_posterior_of_plates_is_a_wheels_prior(analysed: Analysed, tmp_path: Path) -> None:
    """A wheel study that names the folder has the moduli's laws and their correlation."""
    result = analysed("plates of one memory")
    with plain_pages():
        result.save(tmp_path / "plates")
    take = {"kc": "kc", "kphi": "kphi", "n0": "n"}
    study = Study(
        pd.DataFrame({"slip": [0.1, 0.3], "load [N]": 80.0, "drawbar_pull [N]": [14.0, 22.0]}),
        {"Wh3": WHEEL},
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


def test_the_command_writes_a_folder_and_prints_the_finding(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Exit code 0, the default name is the file's, the verdicts on the terminal; nothing is overwritten."""
    monkeypatch.chdir(tmp_path)
    plate_table(tests=3).to_csv(tmp_path / "plates.csv", index=False)
    moduli = 'kc = { dist = "uniform", lower = "-20 kPa m", upper = "20 kPa m" }\nkphi = "900 kPa"\n'
    text = f'test = "plate"\n[data]\nfile = "plates.csv"\n[priors]\n{moduli}n = 1.1\n'
    noise = '[noise]\nmemory = 2.0\nseating = "0.1 mm"\nsinkage_offset = "0 mm"\n'
    text = f"{text}{noise}[sampling]\ntarget_ess = 400\n"
    (tmp_path / "plates.toml").write_text(text, encoding="utf-8")
    with little_adaptation(HALF), little_leaving_out():
        assert main(["soiltest", "plates.toml", "--quiet"]) == 0
    printed = capsys.readouterr()
    assert "Soil tests: " in printed.out
    assert "Report: plates-result/report.html" in printed.out
    assert printed.err == ""
    assert {path.name for path in (tmp_path / "plates-result").iterdir()} == {*ALONE, "soil-test-plate.csv"}
    assert main(["soiltest", "plates.toml", "--quiet"]) == 2
    assert "exists already: add --overwrite" in capsys.readouterr().err
