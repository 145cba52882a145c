"""The command design: folders, what is printed, what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from bayesterra.__main__ import main
from bayesterra.design.choosing import Design
from bayesterra.design.recommendation import recommend
from bayesterra.study.result import Result
from bayesterra.study.study import Study
from tests.support.pages import plain_pages
from tests.support.thinned import thinned

pytestmark = pytest.mark.usefixtures("little_adaptation")

Captured = pytest.CaptureFixture[str]
HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"


@pytest.fixture(scope="module")
def saved(small_result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A result folder of few draws, whose page is one line."""
    folder = tmp_path_factory.mktemp("design") / "hit-result"
    with plain_pages():
        replace(small_result, draws=thinned(small_result.draws)).save(folder)
    return folder


def test_a_result_is_built_on(saved: Path, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch) -> None:
    """Ranking, plan, plot, page and record are written, the best is printed with errors; not twice."""
    monkeypatch.chdir(tmp_path)
    asked = ["design", str(saved), "--about", "c,phi", "--slip", "0.1,0.3", "--load", "60 N", "-n", "2"]
    assert main(asked) == 0
    printed = capsys.readouterr().out
    assert "Recommended: wheel Wh32, 60 N, slip" in printed
    assert "sd of φ from" in printed
    assert "±" in printed
    folder = tmp_path / "hit-design"
    table = pd.read_csv(folder / "design.csv")
    assert table["gain [bit]"].is_monotonic_decreasing
    assert set(table["slip"]) == {0.1, 0.3}
    assert len(pd.read_csv(folder / "plan.csv")) == 2
    assert (folder / "design.png").read_bytes().startswith(b"\x89PNG")
    assert json.loads((folder / "design.json").read_text("utf-8"))["source"] == "posterior"
    page = (folder / "report.html").read_text("utf-8")
    assert "next drive" in page
    assert "2 drives" in page
    assert main(asked) == 2
    assert "'hit-design' exists already: add --overwrite" in capsys.readouterr().err


def test_a_study_speaks_from_its_prior(tmp_path: Path, capsys: Captured) -> None:
    """A study is judged by its prior alone, and that is said."""
    out = tmp_path / "d"
    assert main(["design", str(HIT), "--about", "phi", "--slip", "0.2", "--out", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "From the prior alone, no readings used" in printed
    assert "slip 0.2" in printed.split("Recommended")[0]
    assert "channels" not in printed  # the same for all
    assert Design.RECORD.read(out / Design.MARK)["source"] == "prior"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "nowhere: no such study file"),
        (["{}", "--about", "fi"], "unknown parameter 'fi'"),
        (["{}", "--load", "80"], "'load' needs a unit"),
        (["{}", "--slip", "fast"], "'slip' must be numbers with commas"),
        (["{}", "--channel", "normal_force=1 N"], "unknown channel 'normal_force'"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(
    arguments: list[str], message: str, saved: Path, capsys: Captured, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Bad input ends with 2 and one line that names it; no folder appears."""
    monkeypatch.chdir(tmp_path)
    assert main(["design", *(argument.format(saved) for argument in arguments)]) == 2
    printed = capsys.readouterr().err
    assert message in printed
    assert printed.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_deviations_before_are_those_of_the_draws_of_each_parameter(two_free: Study) -> None:
    """φ in degrees and K in mm, each with its own; after a drive there is less of the one asked about."""
    found = recommend(two_free, slips=[0.1, 0.3], seed=2)
    draws = found.situation.draws
    assert found.about == ("phi", "K")
    for i, (column, scale) in enumerate((("sd_phi [deg]", np.radians(1.0)), ("sd_K [mm]", 1e-3))):
        for table in (found.table, found.plan):
            np.testing.assert_allclose(table[column], draws[:, i].std(ddof=1) / scale, rtol=1e-9)
            assert (table[f"{column} after"] < table[column]).all()
