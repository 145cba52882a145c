"""The page of an identifiability analysis, and what a run's own report says of it, new and old."""

import copy
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from numpy.random import default_rng

from bayesterra.analysis import page as analysis_pages
from bayesterra.analysis.findings_page import strip
from bayesterra.analysis.inference import Analysis
from bayesterra.analysis.run import load_result
from bayesterra.identifiability import evidence_page
from bayesterra.identifiability.analysis import Identified
from bayesterra.identifiability.page import identifiability_page
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.report.blocks import Table
from bayesterra.report.sections import VerdictPage
from bayesterra.report.verdicts import Failures
from bayesterra.study.result import Result, identifiability_rows
from tests.support.pages import undrawn

from .conftest import VARIANTS
from .test_analysis_identify import shown

VOID = {"meta", "img", "link", "br"}


@pytest.fixture(scope="module")
def page(moduli: Identified) -> VerdictPage:
    """What the page shows."""
    with undrawn():
        return identifiability_page(moduli)


def objecting(made: Identified, *against: str) -> VerdictPage:
    """The page with these objections, to the first parameters."""
    table = made.found.verdicts.assign(against="")
    for i, text in enumerate(against):
        table.loc[i, "against"] = text
    return identifiability_page(replace(made, found=replace(made.found, verdicts=table)))


def test_the_first_card_is_the_finding_in_symbols(moduli: Identified, page: VerdictPage) -> None:
    """The sentence of terminal and record, with its symbols set."""
    card = page.verdicts[0]
    assert card.word == "1 of 4 fixed"
    assert "determine <i>k</i><sub>c</sub> and <i>k</i><sub>φ</sub>." in card.sentence
    plain = re.sub(r"<[^>]+>", "", str(card.sentence))
    assert plain == moduli.sentence.replace("k_c", "kc").replace("k_φ", "kφ")


def test_the_second_card_sorts_the_parameters(page: VerdictPage) -> None:
    """What is determined first, then every other word with its parameters."""
    card = page.verdicts[1]
    assert card.word == "1 of 4 determined"
    assert str(card.sentence).startswith("<i>n</i><sub>0</sub> on its own; one-sided: <i>σ</i>(<i>z</i>);")
    assert "structurally not determined: <i>k</i><sub>c</sub> and" in card.sentence


@pytest.mark.usefixtures("plain_pictures")
def test_objections_are_counted_in_english(moduli: Identified) -> None:
    """None, one, several; more than two are only named on the card, and all stand below the table."""
    assert objecting(moduli).verdicts[2].word == "agree"
    one = objecting(moduli, "the profile is flat").verdicts[2]
    assert one.word == "1 objection"
    assert str(one.sentence).endswith("<i>k</i><sub>c</sub>: the profile is flat.")
    three = objecting(moduli, "a", "b", "c")
    assert three.verdicts[2].word == "3 objections"
    assert "see below" in three.verdicts[2].sentence
    assert "<b><i>n</i><sub>0</sub></b> (determined): c." in str(three.sections[0])


@pytest.mark.usefixtures("plain_pictures")
def test_points_of_a_profile_that_were_not_solved_are_counted(moduli: Identified) -> None:
    """Beside the trust, where there are any."""
    first, *others = moduli.found.profiles.found["likelihood"]
    profiles = []
    for count in (0, 2):
        lost = replace(first, failed=np.arange(len(first.values)) >= len(first.values) - count)
        found = {**moduli.found.profiles.found, "likelihood": (lost, *others)}
        profiles.append(replace(moduli.found.profiles, found=found))
    pages = [identifiability_page(replace(moduli, found=replace(moduli.found, profiles=one))) for one in profiles]
    assert [re.findall(r"\d+ %, (\d+) not solved", str(page.sections)) for page in pages] == [[], ["2"]]


@pytest.mark.usefixtures("plain_pictures")
def test_draws_that_did_not_converge_are_warned_of(moduli: Identified, page: VerdictPage) -> None:
    """The page of converged draws warns of nothing."""
    assert page.warning == ""
    poor = replace(moduli, record={**moduli.record, "converged": False})
    assert "not converge" in identifiability_page(poor).warning


@pytest.mark.usefixtures("plain_pictures")
def test_names_of_a_study_are_escaped(moduli: Identified) -> None:
    """Markup in a title is shown, not obeyed."""
    study = copy.copy(moduli.study)
    object.__setattr__(study, "title", "<script>alert(1)</script>")
    html = replace(moduli, study=study).page().html()
    assert "<script" not in html
    assert "&lt;script&gt;" in html


class _Reader(HTMLParser):
    """Collects what is wrong with a page."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.wrong: list[str] = []
        self.pictures: list[dict[str, str | None]] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Void tags are not closed; addresses are data or anchors."""
        held = dict(attrs)
        self.wrong += [
            str(held[key])[:40]
            for key in ("src", "href")
            if key in held and not str(held[key]).startswith(("data:image/", "#"))
        ]
        if tag == "img":
            self.pictures.append(held)
        if tag not in VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        """Note what does not close what was opened last."""
        if not self.open or self.open.pop() != tag:
            self.wrong.append(f"</{tag}>")


def test_the_page_is_one_well_formed_file(moduli: Identified, page: VerdictPage) -> None:
    """Every tag is closed, nothing is fetched, pictures have words, rows as many cells as their header."""
    html = moduli.page().html()
    reader = _Reader(html)
    assert reader.wrong == []
    assert reader.open == []
    assert len(reader.pictures) == 5 - 1  # two groups are needed for the coupling of groups
    assert all(picture["alt"] for picture in reader.pictures)
    tables = [block for section in page.sections for block in section.blocks if isinstance(block, Table)]
    for table in tables:
        assert {len(row) for row in table.rows} == {len(table.header)} == {len(table.align)}
    assert moduli.page().html() == html


@pytest.mark.usefixtures("plain_pictures")
def test_a_run_opens_with_the_same_sentence(pair: Result) -> None:
    """The card of a run's report counts the group's directions and names what its data leave open."""
    card = pair.verdicts[-1]
    assert str(card.sentence) == (
        "These data determine no parameter on its own and fix 1 of 2 independent combinations; c and φ are"
        " known only in combination."
    )
    assert card.word == "0 of 2 determined"
    groups = pair.record["directions"]["groups"]
    assert [row["scope"] for row in groups] == ["all", "P_II"]
    text = shown(pair.page().html())
    assert "shearing P II unknown 1 of 2" in re.sub(r"\s+", " ", text)
    assert "bayesterra identify DIR" in text


def test_a_run_says_what_its_design_cannot_tell(pair: Result) -> None:
    """A null direction in the record reaches card and section, with its verdict's meaning."""
    table = pair.identifiability.assign(verdict="structurally not determined", structural=False)
    record = copy.deepcopy(pair.record)
    record["directions"]["unseen"] = ["only c + 2 phi is determined <b>"]
    found = replace(pair, identifiability=table, record=record)
    card = found.verdicts[-1]
    assert card.html.endswith("no data of this design can determine <i>c</i> and <i>φ</i>.")
    said = str(evidence_page.identifiability_section(found))
    assert "By the design: Only <i>c</i> + 2 phi is determined &lt;b&gt;." in said
    assert "could tell it, however many and good" in said


def test_a_run_judges_its_design() -> None:
    """Moduli under one wheel width: verdict, groups and the reason, whatever the draws say."""
    study = VARIANTS["moduli"]()
    target = posterior(study)
    x = draw_cut_prior(target, 2000, default_rng(1)).x
    kept = SimpleNamespace(flat=x[::2])
    prior = SimpleNamespace(x=x)
    drawn = SimpleNamespace(study=study, posterior=target, prior=prior, kept=kept, failures=Failures())
    table, findings = Analysis.identifiability(cast(Analysis, drawn), default_rng(2))
    words, record = table.set_index("parameter")["verdict"], findings["directions"]
    assert words[words == "structurally not determined"].index.tolist() == ["kc", "kphi"]
    assert record["unseen"][0].startswith("only k_c + 0.165 k_φ is determined")
    assert [(row["scope"], row["directions"]) for row in record["groups"][:2]] == [("all", 4), ("P_I", 3)]


def test_coupled_with_one_or_with_several(pair: Result) -> None:
    """A strong correlation names its partner; where it takes all together, no single one is named."""
    table = pair.identifiability.assign(verdict="coupled", tied_to=["phi", "c"], tie=[-0.95, 0.3])
    found = replace(pair, identifiability=table)
    one, several = strip(found)
    assert str(one.remark).startswith("with <i>φ</i>")
    assert str(several.remark).startswith("with several others")
    assert [analysis_pages._verdict(row) for row in identifiability_rows(found).values()] == [
        "coupled with φ",
        "coupled with several",
    ]
    assert "coupled with several" in found._repr_html_()


@pytest.mark.usefixtures("plain_pictures")
def test_folders_of_older_versions_still_report(pair: Result, pair_folder: Path) -> None:
    """Without the counts of groups and the columns of ties the old sentence stands, and nothing is NaN."""
    record = copy.deepcopy(pair.record)
    for key in ("groups", "unseen"):
        del record["directions"][key]
    new = ["tied_to", "tie", "multiple", "given_others", "structural"]
    old = replace(load_result(pair_folder), record=record)
    old = replace(old, identifiability=old.identifiability.drop(columns=new))
    card = old.verdicts[-1]
    assert f"fix {record['directions']['determined']} of 2 independent" in str(card.sentence)
    text = shown(old.page().html())
    assert "coupled" in text
    assert not re.search(r"\bnan\b", text)
