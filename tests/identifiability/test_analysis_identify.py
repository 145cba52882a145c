"""Tables, units and words of an identifiability analysis, for studies of every kind."""

import math
import re

import numpy as np
import pandas as pd
import pytest

from bayesterra.errors import StudyError
from bayesterra.identifiability.analysis import Identified, foresee, identify
from bayesterra.identifiability.verdicts import group_columns
from bayesterra.parameters import PARAMETERS
from bayesterra.study.result import Result
from bayesterra.study.study import Study

from .conftest import VARIANTS, analysed, trial

pytestmark = pytest.mark.usefixtures("little_adaptation")

TABLES = {
    "collinearity", "combinations", "compensation", "coupling",
    "coupling_of_groups", "directions", "groups", "importance", "information", "local", "local_at_best",
    "profile_points", "profiles", "spectrum", "structure", "verdicts",
}  # fmt: skip
SENTENCES = {
    "one parameter": "These data determine φ on its own and fix 1 of 1 independent combination.",
    "noise only": "These data determine no parameter on its own and fix none of 1 independent combination.",
    "offset and c3": "These data determine φ on its own and fix 1 of 3 independent combinations; c3 repeats",
    "unknown load": "These data determine no parameter on its own and fix 1 of 2 independent combinations; c"
    " and φ are known only in combination.",
    "tied": "These data determine n0 and c on their own and fix 2 of 2 independent combinations.",
    "one slip": "These data determine no parameter on its own and fix 1 of 3 independent combinations; K_s"
    " repeats its prior; no data of this design can determine n0 and n1.",
}


def shown(html: str) -> str:
    """A page without its pictures and tags."""
    return re.sub(r"<[^>]+>", " ", re.sub(r"<style>.*?</style>|<svg.*?</svg>", "", html, flags=re.DOTALL))


@pytest.mark.usefixtures("plain_pictures")
@pytest.mark.parametrize("name", SENTENCES)
def test_every_kind_of_study_has_its_sentence_and_page(name: str) -> None:
    """Ties, an offset, a free c3, unknown loads, one parameter, noise alone: words, no NaN on the page."""
    made = analysed(VARIANTS[name]())
    assert made.sentence.startswith(SENTENCES[name])
    text = shown(made.page().html())
    assert not re.search(r"\b(nan|inf|NaN|NaT)\b", text)
    assert set(made.tables()) == TABLES


@pytest.mark.usefixtures("plain_pictures")
def test_one_wheel_width_hides_the_moduli(moduli: Identified) -> None:
    """Of k_c and k_φ under one width only a sum counts: verdicts, sentence, combinations and page say so."""
    words = moduli.verdicts.set_index("parameter")["verdict"]
    assert words[["kc", "kphi"]].tolist() == ["structurally not determined"] * 2
    assert moduli.sentence.endswith("no data of this design can determine k_c and k_φ.")
    last = moduli.found.combinations.iloc[-1]
    assert last["combination"].startswith("only k_c + 0.165 k_φ is determined")
    assert math.isnan(last["contraction"])
    text = shown(moduli.page().html())
    assert "Rank 3 of 4" in text
    assert not re.search(r"\bnan\b", text)


def test_tables_have_the_units_that_they_say(moduli: Identified) -> None:
    """Ends of profiles and standard deviations are in the unit of their row, paths in their header's."""
    found, written = moduli.found, moduli.tables()
    scale = {name: PARAMETERS[name].scale for name in found.names}
    local = written["local"].set_index("parameter")
    assert local.loc["kphi", "unit"] == "kPa/m^N"
    np.testing.assert_allclose(
        local["prior_sd"] * pd.Series(scale), found.spread.table.set_index("parameter")["prior_sd"]
    )
    verdicts = written["verdicts"].set_index("parameter")
    assert verdicts.loc["noise_sinkage", "unit"] == "mm"
    assert 0.5 < verdicts["prior_sd"]["noise_sinkage"] < 2.0
    profiles = written["profiles"]
    assert profiles[profiles["parameter"] == "kphi"]["best"].between(500, 5000).all()
    points = written["profile_points"]
    own = points[points["profile"] == "kphi"]
    np.testing.assert_allclose(own["value"], own["kphi [kPa/m^N]"], rtol=1e-9)
    assert own["value"].max() == pytest.approx(5000.0)
    assert set(own["unit"]) == {"kPa/m^N"}
    assert "n0" in points


def test_tables_are_complete(moduli: Identified) -> None:
    """Every parameter has its row, every pair, subset and profile too, and indices that a reader can join."""
    written, names = moduli.tables(), list(moduli.found.names)
    for name in ("verdicts", "information", "local", "local_at_best", "structure"):
        assert written[name]["parameter"].tolist() == names
    assert len(written["coupling"]) == 6
    assert sorted(written["profiles"]["parameter"]) == sorted(2 * names)
    assert written["compensation"].columns.tolist() == ["profile", *names]
    assert written["spectrum"].shape[1] == 4
    assert written["combinations"].dtypes["contraction"] == np.float64


def test_a_study_and_its_result_agree(pair: Result) -> None:
    """Sampled here or read from a result, words and counts are the same, and both name their draws."""
    fresh, read = identify(pair.study, seed=2), identify(pair)
    assert fresh.found.verdicts["verdict"].tolist() == read.found.verdicts["verdict"].tolist()
    assert fresh.sentence == read.sentence
    assert (fresh.record["draws_from"], read.record["draws_from"]) == ("here", "the result")
    assert read.record["draws"] == len(pair.values())


def test_the_same_seed_gives_the_same_answer(pair: Result) -> None:
    """All tables again, number by number; another seed moves what is estimated from draws."""
    once, again, other = (identify(pair, seed=seed).tables() for seed in (3, 3, 4))
    for name, table in once.items():
        pd.testing.assert_frame_equal(table, again[name])
    assert not once["coupling"]["null"].equals(other["coupling"]["null"])


def test_nothing_free_is_refused() -> None:
    """Where every parameter is fixed there is nothing to identify."""
    with pytest.raises(StudyError, match="every parameter is fixed"):
        identify(trial())
    with pytest.raises(StudyError, match="every parameter is fixed"):
        foresee(trial())


def test_a_design_is_judged_without_its_readings() -> None:
    """Readings change nothing in what is foreseen; a design of one slip cannot part n0 from n1."""
    study = VARIANTS["one slip"]()
    empty = Study(
        pd.DataFrame({"slip": [0.3], "load [N]": [80.0]}), study.wheels, slip_reference="shearing",
        prior_only=True, noise=dict(study.noise), priors=dict(study.prior.entries),
    )  # fmt: skip
    measured, planned = foresee(study), foresee(empty)
    pd.testing.assert_frame_equal(measured.structure.table, planned.structure.table)
    pd.testing.assert_frame_equal(measured.spread.table, planned.spread.table)
    assert planned.structure.determined == ("Ks",)


def test_every_length_of_the_verdicts_is_in_the_unit_of_its_row(moduli: Identified) -> None:
    """Beside the column ``unit`` no number stays in SI; what has no unit stays as it is."""
    before, after = moduli.found.verdicts, moduli.verdicts
    scale = np.array([PARAMETERS[name].scale for name in before["parameter"]])
    assert after["unit"].tolist() == [PARAMETERS[name].unit for name in before["parameter"]]
    for name in ("lower_95", "upper_95", "prior_sd", "local_sd", "posterior_sd"):
        np.testing.assert_allclose(after[name] * scale, before[name], rtol=1e-12, err_msg=name)
    for name in ("contraction", "shift", "tie", "expected"):
        np.testing.assert_array_equal(after[name], before[name])


def test_the_verdicts_carry_the_figures_of_the_parts(moduli: Identified) -> None:
    """Each column is that of the part it comes from, under its own name, and each file that of its analysis."""
    found, written = moduli.found, moduli.tables()
    verdicts, scale = found.verdicts, np.array([PARAMETERS[name].scale for name in found.names])
    np.testing.assert_array_equal(verdicts["cut_contraction"], found.information.parameters["cut_contraction"])
    for name in ("expected", "local_sd"):
        np.testing.assert_array_equal(verdicts[name], found.spread.table[name])
    profiles = found.profiles.found["likelihood"]
    assert verdicts["profile"].tolist() == [profile.shape for profile in profiles]
    np.testing.assert_array_equal(verdicts[["lower_95", "upper_95"]], [profile.crossings(95) for profile in profiles])
    for file, local in {"local": found.spread, "local_at_best": found.best}.items():
        np.testing.assert_allclose(written[file]["local_sd"] * scale, local.table["local_sd"], rtol=1e-12)
    assert not np.allclose(found.spread.table["local_sd"], found.best.table["local_sd"])
    whole = found.counts[found.counts["scope"] == "all"].iloc[0]
    shares = found.combinations["contraction"].dropna()
    assert whole["effective"] == pytest.approx(shares.clip(0.0, 1.0).sum())
    assert set(found.counts["scope"]) == {"all", *group_columns(found.names)}
