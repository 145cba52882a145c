"""Prior sets: every law of the informative set has a source, and the text stays with the study."""

from pathlib import Path

import numpy as np
import pytest

from bayesterra import parameters
from bayesterra.__main__ import main
from bayesterra.errors import StudyError
from bayesterra.likelihood.page import prior_sources
from bayesterra.parameters import PARAMETERS, SOIL_PARAMETERS
from bayesterra.stats.laws import Law
from bayesterra.study import entries
from bayesterra.study.canonical import write_study
from bayesterra.study.entries import prior_set
from bayesterra.study.study import load_study
from tests.support.folder import Write

INFORMED = ('set = "paper-box"', 'set = "planetary"')
LAWS = {name: entry for name, entry in prior_set("planetary").items() if isinstance(entry, Law)}


def between(name: str, low: float, high: float) -> float:
    """Probability of the planetary law of one parameter between two values in its field unit."""
    ends = np.array([low, high]) * PARAMETERS[name].scale
    return float(np.diff(LAWS[name].cdf(ends))[0])


def test_the_planetary_set_is_complete_and_sourced() -> None:
    """All soil parameters have an entry, and every law a source that is not empty."""
    assert tuple(prior_set("planetary")) == SOIL_PARAMETERS
    assert all(law.source for law in LAWS.values())


def test_laws_without_an_independent_source_are_as_wide_as_the_box() -> None:
    """What nothing speaks for has the flat law of the paper's box."""
    unsourced = {name: law for name, law in LAWS.items() if law.source.startswith("no independent source")}
    assert unsourced == {"n1": prior_set("paper-box")["n1"]}


@pytest.mark.parametrize("name", sorted(set(LAWS) - {"n1"}))
def test_informative_laws_say_more_than_the_box(name: str) -> None:
    """The central 90 % of a sourced law are narrower than those of the box."""
    box = prior_set("paper-box")[name]
    assert isinstance(box, Law)
    widths = [np.diff(law.quantile(np.array([0.05, 0.95])))[0] for law in (LAWS[name], box)]
    assert 0 < widths[0] < widths[1]


@pytest.mark.parametrize(
    ("name", "low", "high", "least"),
    [
        ("phi", 26, 39, 0.7),  # Mars Exploration Rovers, Viking and Pathfinder, drift at Viking aside
        ("phi", 35, 39, 0.2),  # Apollo 12
        ("c", 0, 2, 0.9),  # wheel trenches of the Mars Exploration Rovers
        ("K", 10, 25, 0.5),  # firm to loose sand
        ("n0", 0.79, 1.1, 0.35),  # plates
        ("Ks", 820, 5300, 0.5),  # plates
    ],
)
def test_the_laws_hold_what_their_sources_say(name: str, low: float, high: float, least: float) -> None:
    """The ranges that the sources give have a fair share of the law."""
    assert between(name, low, high) > least


def test_check_and_report_show_the_sources(write: Write, capsys: pytest.CaptureFixture[str]) -> None:
    """A line for every law, and a table in the report; neither for a set without sources."""
    informed = write(INFORMED)
    assert main(["check", str(informed)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    for name, law in LAWS.items():
        assert f"{name}: {law.source}" in shown
    (table,) = prior_sources(load_study(informed))
    assert [row[1] for row in table.rows] == [law.source for law in LAWS.values()]  # type: ignore[union-attr]
    assert prior_sources(load_study(write())) == ()


def test_sources_are_kept_when_a_study_is_written(write: Write, tmp_path: Path) -> None:
    """The written study has the texts, which are no part of its fingerprint."""
    own = 'phi = { dist = "norm", loc = "32 deg", scale = "4 deg", source = "our \\"shear\\" box" }'
    study = load_study(write(INFORMED, ("c3 = 0.0", own)))
    folder = tmp_path / "written"
    folder.mkdir()
    write_study(study, folder)
    again = load_study(folder)
    sources = [{name: law.source for name, law in one.prior.laws.items()} for one in (study, again)]
    assert sources[0] == sources[1]
    assert sources[0]["phi"] == 'our "shear" box'
    silent = load_study(write(INFORMED, ("c3 = 0.0", own.replace('our \\"shear\\" box', ""))))
    assert silent.fingerprint["study"] == study.fingerprint["study"]


def test_a_source_must_be_text(write: Write) -> None:
    """A number is no source."""
    bad = 'phi = { dist = "norm", loc = "32 deg", scale = "4 deg", source = 2011 }'
    with pytest.raises(StudyError, match=r"\[priors\] 'phi\.source' must be text \(got 2011\)"):
        load_study(write(("c3 = 0.0", bad)))


def test_what_is_held_needs_no_unit_in_a_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """A parameter with a dimension may be held by default, in SI, beside any named set."""
    monkeypatch.setattr(parameters, "HELD", {"c3": 0.0, "K": 0.012})
    for name in entries.stated_sets():
        held = entries.prior_set.__wrapped__(name)
        assert (held["c3"], held["K"]) == (0.0, 0.012)
