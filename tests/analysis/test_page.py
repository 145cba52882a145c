"""The report is one self-contained, escaped, reproducible file whose words follow the figures."""

import copy
import re
from collections.abc import Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from markupsafe import Markup, escape

from bayesterra.analysis import findings_page
from bayesterra.analysis.closing_page import prior_section, say
from bayesterra.analysis.findings_page import mode_outside
from bayesterra.analysis.page import (
    Page,
    _chains,
    data_section,
    driving,
    posterior_section,
    reached,
    run_page,
    slip_table,
    warning,
)
from bayesterra.design.recommendation import recommend
from bayesterra.likelihood.forward import reference_load
from bayesterra.parameters import CHANNELS
from bayesterra.report import symbols
from bayesterra.report.blocks import Gallery, Table
from bayesterra.report.numbers import interval, resolution
from bayesterra.report.sections import render
from bayesterra.report.symbols import in_symbols
from bayesterra.report.terminal import show
from bayesterra.report.verdicts import SIGNS, Verdict, sampling_verdict
from bayesterra.study.page import _lanes
from bayesterra.study.result import Result, identifiability_rows, summary_rows

NASTY = '<script>alert(1)</script> & "it" $x_1$'


@pytest.fixture(scope="module")
def content(small_result: Result) -> Page:
    """What the report of the small result shows."""
    return run_page(small_result)


@pytest.fixture(scope="module")
def html(content: Page) -> str:
    """The report of the small result."""
    return render(content)


class _Reader(HTMLParser):
    """Collects tags, attributes and text."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.unbalanced: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep every tag; void ones are not closed."""
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "link", "br"):
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Keep tags that close themselves."""
        self.tags.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        """Note what does not close what was opened last."""
        if not self.open or self.open.pop() != tag:
            self.unbalanced.append(tag)


def _changed(result: Result, **verdict: object) -> Result:
    record = copy.deepcopy(result.record)
    record["verdict"].update(verdict)
    return replace(result, record=record)


def _plain(text: object) -> str:
    return re.sub(r"<[^>]+>", "", str(text))


def test_report_is_one_file_that_fetches_nothing(html: str) -> None:
    """No script, no link to another file, no address but data and anchors; below 5 MB."""
    tags = _Reader(html).tags
    assert not [tag for tag, _ in tags if tag in ("script", "link", "iframe", "object")]
    addresses = [value for _, attrs in tags for key, value in attrs.items() if key in ("src", "href")]
    assert addresses
    assert all((a or "").startswith(("data:image/", "#")) for a in addresses)
    assert "url(" not in html
    assert "@import" not in html
    assert len(html.encode()) < 5_000_000


def test_report_is_well_formed(html: str) -> None:
    """Every tag is closed in order, and every picture has words for those who do not see it."""
    reader = _Reader(html)
    assert reader.unbalanced == []
    assert reader.open == []
    pictures = [attrs for tag, attrs in reader.tags if tag == "img"]
    assert len(pictures) > 10
    assert all(attrs.get("alt") for attrs in pictures)


def test_text_from_the_user_is_escaped(content: Page) -> None:
    """Markup in a title is shown, not obeyed."""
    html = render(replace(content, title=NASTY, facts=(NASTY,)))
    assert "<script" not in html
    assert html.count("&lt;script&gt;alert(1)&lt;/script&gt; &amp; &#34;it&#34;") >= 3


def test_names_of_a_study_are_escaped_in_every_block(small_result: Result) -> None:
    """Title, source and wheel of a study pass through tables and captions without becoming markup."""
    study = copy.copy(small_result.study)
    for name, value in (("title", NASTY), ("source", NASTY), ("notes", (NASTY,))):
        object.__setattr__(study, name, value)
    blocks = data_section(replace(small_result, study=study))
    cells = [escape(b.caption if isinstance(b, Table) else b.text) for b in blocks if not isinstance(b, Gallery)]
    assert sum("&lt;script&gt;" in cell for cell in cells) == 2
    assert not any("<script" in cell for cell in cells)


def test_the_page_says_what_it_is_about(content: Page) -> None:
    """Title, wheel and the kind of data stand at the top."""
    assert content.title == "HIT wheel Wh32 on HIT-LSS1"
    assert content.kind == "digitised"
    assert content.facts[0] == "wheel Wh32"


def test_sections_stand_in_the_order_of_the_guidelines(html: str) -> None:
    """Data first, reproduction last."""
    expected = "data sampling posterior checks loo identifiability methods prior words reproduce signing"
    assert re.findall(r'<section id="(\w+)"', html) == expected.split()


@pytest.mark.slow
def test_written_report_is_the_same_bytes_again(small_result: Result, tmp_path: Path, html: str) -> None:
    """Drawing and writing the report of a result once more changes nothing."""
    small_result.save(tmp_path / "out")
    assert (tmp_path / "out" / "report.html").read_text(encoding="utf-8") == html


def test_a_converged_run_says_so_and_warns_of_nothing(small_result: Result) -> None:
    """With all checks passed the verdict is good and there is no warning."""
    sound = _changed(small_result, converged=True)
    assert sampling_verdict(sound.record).word == "converged"
    assert warning(sound) == ""


def test_a_run_that_did_not_converge_says_so_first_with_advice(small_result: Result, content: Page) -> None:
    """The warning names what to do, and the verdict the check that failed."""
    check = {"name": "effective draws", "value": 80.0, "threshold": 400.0, "passed": False, "advice": "run longer"}
    failed = _changed(small_result, converged=False, checks=[check])
    assert sampling_verdict(failed.record).grade == "bad"
    assert "Failed: effective draws" in _plain(sampling_verdict(failed.record).sentence)
    html = render(replace(content, warning=warning(failed), verdicts=failed.verdicts, sentence=failed.sentence))
    assert html.index("Do not use: the sampling has not converged") < html.index("not converged</span>")
    assert "run longer" in html[: html.index(">Fit<")]


def test_every_grade_has_its_own_sign() -> None:
    """Verdicts can be told apart without colour."""
    assert len(set(SIGNS.values())) == 4


def test_words_name_the_strongest_trade(small_result: Result) -> None:
    """Cohesion and friction angle of one load are traded, and a second load is what would part them."""
    assert {"c", "phi"} in [{a, b} for a, b, _ in findings_page.coupled_pairs(small_result)]


def test_the_next_drive_is_said_with_its_figures(small_result: Result) -> None:
    """Nothing is said where nothing was ranked."""
    text = _plain(findings_page.next_measurement(small_result))
    assert f"at slip {small_result.record['next']['slip']:.2f} would tell most" in text
    assert findings_page.next_measurement(replace(small_result, record={**small_result.record, "next": None})) == ""


@pytest.mark.slow
def test_the_next_drive_is_that_of_design(small_result: Result) -> None:
    """Judged by the quick form, which the full one confirms to a tenth of the gain."""
    drive, load = small_result.record["next"], reference_load(small_result.study)
    full = recommend(small_result, loads=[0.5 * load, load, 2.0 * load])
    gains = [estimate.values[1] for estimate in full.ranking.estimates]
    chosen = [
        gain
        for gain, each in zip(gains, full.candidates, strict=True)
        if (each.load[0], each.slip[0]) == pytest.approx((drive["load"], drive["slip"]))
    ]
    assert len(chosen) == 1
    assert chosen[0] > 0.9 * np.nanmax(gains)
    assert 0 < drive["bits"] < 1.1 * chosen[0] / np.log(2)
    assert f"Of {len(full.candidates)} drives" in _plain(findings_page.next_measurement(small_result))


def test_words_say_where_the_mode_leaves_the_bulk(small_result: Result) -> None:
    """The mode of the HIT posterior lies in a corner of the ridge of K_s and n0."""
    assert "Ks" in mode_outside(small_result)
    assert "narrow corner" in _plain(findings_page.about_the_mode(small_result))


def test_words_say_that_a_parameter_was_held(small_result: Result) -> None:
    """The shipped study holds K_s in least squares, as the paper's solver did."""
    text = _plain(findings_page.about_least_squares(small_result))
    assert "held Ks at" in text
    assert "the free mode is denser by Δχ² 0.1" in text


def test_a_mode_on_the_physical_cut_is_marked(small_result: Result, html: str) -> None:
    """HIT: the densest point has θm = θ2 at the smallest slip; the strip, the words and the summary say so."""
    rows = small_result.summary.set_index("parameter")["mode_at"]
    assert rows["c1"] == rows["c2"] == "c1 + 0.1 c2 = 0"
    assert set(rows.drop(["c1", "c2"])) == {"inside"}
    assert "It lies on an edge (†), not on a summit: c1 + 0.1 c2 = 0." in _plain(
        findings_page.about_the_mode(small_result)
    )
    assert len(re.findall(r"†</td>", html)) == 2


def test_words_on_standings_follow_the_record(small_result: Result) -> None:
    """Outside, improbable and inside have their own words."""
    record = copy.deepcopy(small_result.record)
    record["standings"]["IM1"].update(log_density=None, word="outside the prior: θm outside (θ2, θ1)")
    record["standings"]["IM2"].update(log_density=-50.0, credible_level=1.0)
    record["standings"]["IM3"].update(log_density=-3.0, credible_level=0.42)
    text = _plain(findings_page.about_least_squares(replace(small_result, record=record)))
    assert "IM1 lies outside the prior (θm outside (θ2, θ1))" in text
    assert "IM2" in text.split("improbable")[0]
    assert "IM3 lies inside: 42 % of the draws are denser" in text


def test_bounds_that_cut_an_interval_are_named(small_result: Result) -> None:
    """The prior's upper bound of K_s cuts the HIT posterior."""
    assert ("Ks", "upper") in findings_page.bounded(small_result)


def test_a_parameter_that_repeats_its_prior_is_not_said_to_be_cut_off(small_result: Result) -> None:
    """K_s ends where its prior does and is named once, as such; c, which the data narrow, is cut off at 0."""
    text = _plain(findings_page.from_the_prior(small_result))
    repeated, cut = text.split("Cut off by a bound of the prior")
    assert "Ks alone is hardly better known" in repeated
    assert "c at its lower bound" in cut
    assert "Ks" not in cut


def test_driving_table_gives_pull_and_sinkage_at_driven_slips(small_result: Result) -> None:
    """Three of the driven slips, the lowest and the highest among them."""
    found = driving(small_result)
    assert found.heading == "Wheel Wh32 under 80 N"
    assert [row[0] for row in found.slip_rows] == ["0.1", "0.3", "0.6"]
    assert "extrapolated" in found.remark


def test_marks_that_would_overlap_take_different_lanes() -> None:
    """Marks nearer than their width go under one another, others stay in the first lane."""
    assert _lanes([10.0, 12.0, 14.0, 60.0]) == [0, 1, 2, 0]


def test_strip_shows_every_parameter_with_its_estimates(small_result: Result, content: Page) -> None:
    """Each row draws the four methods, the mode with K_s held as they held it, and the published value."""
    rows = content.strip
    assert len(rows) == len(small_result.names)
    assert all(str(row.drawing).count("<title>") == 6 for row in rows)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("Ks", "<i>K</i><sub>s</sub>"),
        ("n0", "<i>n</i><sub>0</sub>"),
        ("phi", "<i>φ</i>"),
        ("drawbar_pull", "<i>F</i><sub>DP</sub>"),
        ("noise_sinkage", "<i>σ</i>(<i>z</i>)"),
    ],
)
def test_symbols_are_set_as_in_the_literature(name: str, expected: str) -> None:
    """Letters in italics, subscripts upright."""
    assert str(symbols.symbol(name)) == expected


def test_lists_read_as_sentences_and_stay_escaped() -> None:
    """Commas, one 'and', and no markup from names."""
    assert str(symbols.listed(["a", "b", "<c>"])) == "a, b and &lt;c&gt;"


def _numbers(html: str) -> Iterator[float]:
    for text in re.findall(r'class="number"[^>]*>(−?\d[\d\u202f.]*)<', html):
        yield _number(text)


def test_medians_of_the_strip_are_those_of_the_summary(html: str, small_result: Result) -> None:
    """What is printed is what was computed, to the digits shown."""
    shown = list(_numbers(html))
    rows = summary_rows(small_result)
    assert len(shown) >= len(small_result.names)
    for name in small_result.names:
        low, high = rows[name].hdi
        assert np.min(np.abs(np.array(shown) - rows[name].median)) < 0.051 * (high - low)


def test_every_number_of_the_posterior_table_is_that_of_the_summary(small_result: Result) -> None:
    """Each in its own column: medians and means of a skew posterior differ by more than they are rounded."""
    table = next(block for block in posterior_section(small_result) if isinstance(block, Table))
    told_apart = 0
    for cells, (name, row) in zip(table.rows, summary_rows(small_result).items(), strict=True):
        shown = dict(zip(table.header[3:], map(str, cells[3:]), strict=True))
        step = resolution(*row.hdi)
        for column in ("mode", "median", "mean"):
            assert _number(shown[column]) == pytest.approx(getattr(row, column), abs=0.51 * step), name
        assert shown["90 % HDI"] == interval(*row.hdi)
        assert _number(shown["sd"]) == pytest.approx(row.sd, rel=0.06)
        for column, value in (("prior mean", row.prior_mean), ("prior sd", row.prior_sd)):
            assert _number(shown[column]) == pytest.approx(value, abs=0.06 * row.prior_sd), name
        told_apart += len({shown["mode"], shown["median"], shown["mean"]}) == 3
    assert told_apart >= 3


def _number(text: str) -> float:
    return float(text.replace("\u202f", "").replace("−", "-"))


def test_sizes_and_errors_of_the_chains_stand_in_their_own_columns(small_result: Result) -> None:
    """Centre and tails have their own effective sizes; each estimate its own Monte Carlo error."""
    table = _chains(small_result)
    columns = ("ess_bulk", "ess_tail", "mcse_mean", "mcse_median", "mcse_sd")
    headed = ("bulk ESS", "tail ESS", "MCSE mean", "MCSE median", "MCSE sd")
    for cells, row in zip(table.rows, summary_rows(small_result).values(), strict=True):
        found = dict(zip(table.header, map(str, cells), strict=True))
        for header, column in zip(headed, columns, strict=True):
            size = getattr(row, column)
            assert _number(found[header]) == pytest.approx(size, rel=0.06 if "MCSE" in header else 0.005)
        assert float(found["R-hat"]) == pytest.approx(row.r_hat, abs=5.1e-5)


def test_bands_at_driven_slips_are_ninety_per_cent_of_the_curves(small_result: Result) -> None:
    """Median and 5 to 95 % of every outcome, interpolated between the points of the curves by hand."""
    table, curves = slip_table(small_result, "Wh32"), small_result.draws["curves"].sel(wheel="Wh32")
    outcomes = [str(name) for name in curves["outcome"].to_numpy()]
    slips = np.unique(small_result.study.observations.used().slip)
    for cells, slip in zip(table.rows, slips, strict=True):
        assert float(str(cells[0])) == pytest.approx(slip)
        for i, name in enumerate(outcomes):
            bands = curves["modelled"].sel(outcome=name) / CHANNELS[name].scale
            at = [float(np.interp(slip, curves["slip"], bands.sel(quantile=q))) for q in (0.05, 0.5, 0.95)]
            step = resolution(at[0], at[2])
            assert cells[2 + 2 * i] == interval(at[0], at[2], step)
            assert _number(str(cells[1 + 2 * i])) == pytest.approx(at[1], abs=0.51 * step)


def test_every_place_says_the_same(small_result: Result, html: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Cards, sentence, terminal, notebook, record and table of one result: the same words and counts."""
    verdicts, shown = small_result.verdicts, " ".join(_plain(Markup(html)).split())  # noqa: S704 (our own)
    assert [verdict.name for verdict in verdicts] == ["Sampling", "Fit", "Prediction", "Soil"]
    show(small_result.overview())
    printed = " ".join(" ".join(capsys.readouterr()).split())
    for verdict, entry in zip(verdicts, small_result.record["verdicts"], strict=True):
        assert f"{verdict.name} {verdict.sign} {verdict.word} {_plain(verdict.html)}" in shown
        assert f"{verdict.name}: {verdict.word}. {verdict.sentence}" in printed
        assert Verdict(**entry) == verdict
    assert small_result.sentence == small_result.record["sentence"]
    assert _plain(in_symbols(small_result.sentence)) in shown
    assert small_result.sentence in printed
    words = list(small_result.identifiability["verdict"])
    assert verdicts[-1].word == f"{words.count('determined')} of {len(words)} determined"
    whole = next(row for row in small_result.record["directions"]["groups"] if row["scope"] == "all")
    assert f"fix {whole['determined'] or 'none'} of {whole['directions']} independent" in printed


def test_every_word_of_the_first_screen_is_defined(small_result: Result, html: str) -> None:
    """Words of the cards and of the parameters, and what stands in the sentences."""
    defined = " ".join(str(word) for word, _ in say.rows("words"))
    first = html[: html.index('<nav aria-label="Contents">')]
    words = {row.word for row in identifiability_rows(small_result).values()}
    words |= {verdict.word for verdict in small_result.verdicts[:3]}
    words |= {
        word for word in ("posterior", "prior", "R-hat", "mode", "90 % HDI", "IM1", "combination") if word in first
    }
    assert {"R-hat", "90 % HDI", "converged", "fits", "predicts"} <= words
    for word in words:
        assert word in defined, word
    for word in (
        "too narrow",
        "too wide",
        "one-sided",
        "moved",
        "repeats its prior",
        "weakly determined",
        "coupled with",
    ):
        assert word in defined


def test_a_greatest_pull_at_the_end_of_the_search_is_not_reached() -> None:
    """In words, on page and terminal alike; an interval that ends there is open."""
    assert reached("peak_pull_slip", 0.8, 0.8, "0.80", "0.80", "0.80") == ("–", "–", "not reached below 0.8")
    assert reached("peak_efficiency_slip", 0.31, 0.8, "0.50", "0.31–0.80") == ("0.50", "0.31 or more")
    assert reached("peak_pull_slip", 0.3, 0.7, "0.50", "0.3–0.7") == ("0.50", "0.3–0.7")
    assert reached("peak_pull", 9.0, 9.0, "9.0", "9.0") == ("9.0", "9.0")


def test_a_result_tells_what_it_is_in_ten_lines(small_result: Result) -> None:
    """Title, sentence, verdicts, draws and where to go on; nothing of its tables."""
    lines = repr(small_result).splitlines()
    assert len(lines) <= 10
    assert lines[0] == f"RunResult: {small_result.study.title} ({small_result.study.kind} data)"
    assert lines[1] == f"  {small_result.sentence}"
    assert lines[2:6] == [f"  {v.name}: {v.word} ({v.grade})" for v in small_result.verdicts]
    assert "chains × " in lines[6]
    assert lines[6].endswith("of Ks, n0, n1, c, phi, K, c1, c2")
    assert max(map(len, lines)) < 130


def test_half_and_double_noise_stand_beside_the_stated_one(small_result: Result) -> None:
    """HIT's noise is a guess: narrower and wider intervals, from the summary, and the first screen says so."""
    blocks = [block for block in prior_section(small_result) if isinstance(block, Table)]
    rows = summary_rows(small_result)
    assert blocks[-1].header[2:] == ("as stated", "half", "double")
    for cells, name in zip(blocks[-1].rows, small_result.names, strict=True):
        ends = (rows[name].hdi, rows[name].hdi_with("half"), rows[name].hdi_with("double"))
        assert cells[2:] == tuple(interval(*pair) for pair in ends), name
    widths = {key: np.ptp(rows["K"].hdi_with(key)) / np.ptp(rows["K"].hdi) for key in ("half", "double")}
    assert widths["half"] < 0.85 < 1.2 < widths["double"]
    assert "Stated, not estimated" in _plain(findings_page.about_the_noise(small_result))
