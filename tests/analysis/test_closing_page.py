"""What the wheel adds: shown where a prior comes from an earlier result, in words that follow the figures."""

from copy import copy
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from bayesterra.analysis.closing_page import _total, added_sections, methods_section
from bayesterra.analysis.page import data_section, run_overview
from bayesterra.checking.validation import estimates
from bayesterra.likelihood.page import prior_sources
from bayesterra.parameters import PARAMETERS, field_values
from bayesterra.report.blocks import Table, Text
from bayesterra.report.figures import MARKS
from bayesterra.report.numbers import interval, resolution, rounded
from bayesterra.stats.dependence import MixtureCopula
from bayesterra.stats.diagnostics import hdi
from bayesterra.stats.quantile_law import QuantileLaw
from bayesterra.study.page import law_text
from bayesterra.study.priors import Prior
from bayesterra.study.result import Result, summary_rows
from tests.support.soil_tests import KNOWN, plates

LAW = QuantileLaw(
    lower=0.0,
    upper=1.5,
    source="posterior of 'Shear box' (box-result), 4000 effective draws",
    scores=(-1.0, 0.0, 1.0),
    values=(0.4, 0.5, 0.6),
)


@pytest.fixture
def built_upon(small_result: Result) -> Result:
    """The small result as if its φ and K had come from an earlier one."""
    study = copy(small_result.study)
    entries = {**study.prior.entries, "phi": LAW, "K": LAW}
    object.__setattr__(study, "prior", Prior(entries, study.prior.width, {"phi, K": 0.3}))
    return replace(small_result, study=study)


def test_a_prior_of_ones_own_has_no_such_section(small_result: Result) -> None:
    """Nothing is shown where every law was stated by the study itself."""
    assert added_sections(small_result) == ()


def test_words_and_tables_follow_the_figures(built_upon: Result) -> None:
    """The sentence has the gain and the narrowed parameters; tables show before beside after."""
    (section,) = added_sections(built_upon)
    assert section.title == "What the wheel adds"
    sentence, parameters, correlations = section.blocks
    assert isinstance(sentence, Text)
    assert isinstance(parameters, Table)
    assert isinstance(correlations, Table)
    prior, draws = (built_upon.values(group) for group in ("prior", "posterior"))
    i, j = (built_upon.names.index(name) for name in ("phi", "K"))
    ratios = draws.std(axis=0) / prior.std(axis=0)
    assert f"<i>φ</i> to {100 * ratios[i]:.0f} %" in sentence.text
    assert "bit to what was known before" in sentence.text
    assert [row[6] for row in parameters.rows] == [f"{ratios[k]:.2f}" for k in (i, j)]
    assert "posterior of 'Shear box'" in str(parameters.caption).replace("&#39;", "'")
    found = np.corrcoef(draws[:, i], draws[:, j])[0, 1]
    assert f"{abs(found):.2f}" in str(correlations.rows[0][2])


def test_what_moves_far_is_doubted(built_upon: Result) -> None:
    """A posterior three standard deviations of the prior away is said to disagree with the earlier result."""
    summary = built_upon.summary.copy()
    at = summary["parameter"] == "phi"
    summary.loc[at, "prior_mean"] = summary.loc[at, "mean"] - 3 * summary.loc[at, "prior_sd"]
    (section,) = added_sections(replace(built_upon, summary=summary))
    warning = section.blocks[1]
    assert isinstance(warning, Text)
    assert "disagree about <i>φ</i>, which moved by more than 2 standard deviations" in str(warning.text)


def test_the_prior_table_names_law_and_source(built_upon: Result) -> None:
    """A tabulated law is shown by its median and 90 %; parameters of one source share a line."""
    assert str(law_text("phi", LAW)) == "tabulated (median 28.65, 90 % in 18.97 to 38.07&nbsp;deg)"
    (table,) = prior_sources(built_upon.study)
    assert isinstance(table, Table)
    assert [str(row[0]) for row in table.rows] == ["<i>φ</i> and <i>K</i>"]


def test_what_was_known_before_stands_before(built_upon: Result) -> None:
    """Median and interval of the prior's draws, then those of the posterior's, each rounded to its step."""
    (section,) = added_sections(built_upon)
    table = next(block for block in section.blocks if isinstance(block, Table))
    assert table.header[2:6] == ("before", "90 % HDI", "after", "90 % HDI")
    for cells, name in zip(table.rows, ("phi", "K"), strict=True):
        i = built_upon.names.index(name)
        for group, (median, ends) in (("prior", cells[2:4]), ("posterior", cells[4:6])):
            draws = field_values(name, built_upon.values(group)[:, i])
            low, high = hdi(draws, 0.9)
            step = resolution(low, high)
            assert (median, ends) == (rounded(float(np.median(draws)), step), interval(low, high, step))


def test_point_estimates_stand_beside_median_and_mode_in_this_order(small_result: Result) -> None:
    """Every column of the methods is that of its header, in the digits of the posterior."""
    table = next(block for block in methods_section(small_result) if isinstance(block, Table))
    assert table.header[2:5] == ("median", "mode", "90 % HDI")
    points, told_apart = estimates(small_result), 0
    assert table.header[5:] == tuple(MARKS[method].label for method in points)
    rows = summary_rows(small_result)
    for cells, name in zip(table.rows, small_result.names, strict=False):
        row, step = rows[name], resolution(*rows[name].hdi)
        assert cells[2:5] == (rounded(row.median, step), rounded(row.mode, step), interval(*row.hdi))
        told_apart += cells[2] != cells[3]
        for cell, values in zip(cells[5:], points.values(), strict=True):
            value = values.get(name)
            expected = "–" if value is None else rounded(value / PARAMETERS[name].scale, step)
            assert str(cell).removeprefix("= ").removeprefix("| ") == expected
    assert told_apart >= 3


def test_the_overview_of_a_run_names_the_earlier_result(built_upon: Result, small_result: Result) -> None:
    """Once for all parameters of one source, with what it says of the joint law; nothing without one."""
    lines = [block.text for block in run_overview(built_upon) if isinstance(block, Text)]
    assert lines.count(f"Prior: {LAW.source}.") == 1
    others = [block.text for block in run_overview(small_result) if isinstance(block, Text)]
    assert not [line for line in others if str(line).startswith("Prior: ")]


def test_a_bent_joint_law_is_named_beside_the_stated_laws(built_upon: Result) -> None:
    """The caption of the laws counts the normal laws of the mixture."""
    study = copy(built_upon.study)
    bent = MixtureCopula((0.5, 0.5), ((-0.5, 0.0), (0.5, 0.0)), (((0.7, 0.5), (0.5, 1.0)),) * 2)
    object.__setattr__(study, "prior", replace(study.prior, correlation={}, mixtures={"phi, K": bent}))
    tables = [block for block in data_section(replace(built_upon, study=study)) if isinstance(block, Table)]
    captions = [str(table.caption) for table in tables]
    assert any("joined by a mixture of 2 normal laws of the scores of phi, K" in text for text in captions)


def test_the_gain_counts_soil_tests(built_upon: Result) -> None:
    """Their readings are in the evidence, and so in the mean log likelihood: the gain is that of the whole density."""
    study = built_upon.study.having(soil_tests=plates(noise=KNOWN).soil_tests)
    levels = np.full(100, -700.0)
    whole = SimpleNamespace(log_prior_and_likelihood=lambda x: (levels, levels))
    entry = {"reliable": True, "log_z": -700.0 - 8.0 * np.log(2.0), "error": 0.01} | dict.fromkeys(
        ("log_share", "log_share_error"), 0.0
    )
    tested = replace(built_upon, study=study, record={**built_upon.record, "evidence": entry})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("bayesterra.analysis.closing_page.posterior", lambda study: whole)
        assert _total(tested).startswith("8.00")
