"""Exported files are those of the page, under its numbers; texts are safe for LaTeX; what is cited is listed."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from markupsafe import Markup

from bayesterra.analysis.export import Export, latex, methods_text, references, text_of
from bayesterra.errors import ResultError
from bayesterra.report.blocks import Gallery, Table
from bayesterra.runtime.reading import read_json
from bayesterra.runtime.tables import read_csv
from bayesterra.study.result import Result
from tests.support.pages import undrawn


@pytest.fixture(scope="module")
def whole(small_result: Result) -> Export:
    """Everything of the small result."""
    asked = {"figures": ["svg", "pdf"], "tables": ["latex", "csv"], "to": ["csv", "json"]}
    return Export(result=small_result, asked=asked, methods=True, bibtex=True)


@pytest.fixture(scope="module")
def saved(whole: Export, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of it."""
    folder = tmp_path_factory.mktemp("export") / "out"
    whole.save(folder)
    return folder


def test_files_have_the_numbers_and_captions_of_the_page(whole: Export, saved: Path) -> None:
    """Numbers run without a gap; every table in both formats, every picture of a figure in both."""
    with undrawn():
        html = whole.result.page().html()
    for word, kind in (("Table", Table), ("Figure", Gallery)):
        numbers = [block.number for block in whole.numbered.values() if isinstance(block, kind)]
        assert numbers == [*range(1, len(numbers) + 1)]
        assert numbers == [int(number) for number in re.findall(rf"<b>{word} (\d+)\.</b>", html)]
        assert len(numbers) > 3
    captions = read_json(saved / "export.json")["captions"]
    for name, block in whole.numbered.items():
        assert captions[name] == text_of(block.caption)
        if isinstance(block, Table):
            assert all((saved / f"{name}.{kind}").is_file() for kind in ("tex", "csv"))
        else:
            assert len([*saved.glob(f"{name}*.pdf")]) == len(block.pictures)
            assert all(file.read_bytes().startswith(b"%PDF") for file in saved.glob(f"{name}*.pdf"))
            assert all(b"<svg" in file.read_bytes() for file in saved.glob(f"{name}*.svg"))


def test_a_table_is_read_back_as_the_page_shows_it(whole: Export, saved: Path) -> None:
    """Cells and columns in their order."""
    name, block = next((n, b) for n, b in whole.numbered.items() if isinstance(b, Table) and "Posterior" in b.caption)
    assert isinstance(block, Table)
    back = read_csv(saved / f"{name}.csv")
    assert back.shape == (len(block.rows), len(block.header))
    assert back.iloc[:, 0].tolist() == [text_of(row[0]) for row in block.rows]


def test_draws_are_those_of_the_result(whole: Export, saved: Path) -> None:
    """To the last digit, as JSON and as CSV, with their units."""
    table = whole.result.to_dataframe()
    content = json.loads((saved / "draws.json").read_text())
    back = read_csv(saved / "draws.csv")
    for name in whole.result.names:
        np.testing.assert_array_equal(content["draws"][name], table[name])
        np.testing.assert_array_equal(back[name], table[name])
    assert set(content["units"]) == set(whole.result.names)
    assert content["kind"] == whole.result.study.kind


def test_latex_takes_no_sign_of_a_text_for_a_command() -> None:
    """Special signs are escaped, symbols set; marks of HTML become those of LaTeX."""
    cells = (r"50 % & $x$ #1 a_b {c} \d ~ ^", Markup("<i>K</i><sub>s</sub> &lt; 3 kPa/m<sup>N</sup>"), "φ −1 ± 2°")
    text = latex(Table("A <b>caption</b>", "lrr", ("", "a", "b"), (cells,), 7))
    assert r"50 \% \& \$x\$ \#1 a\_b \{c\} \textbackslash{}d \textasciitilde{} \textasciicircum{}" in text
    assert r"K\textsubscript{s} $<$ 3 kPa/m\textsuperscript{N}" in text
    assert r"$\varphi$ $-$1 $\pm$ 2$^\circ$ \\" in text
    assert r"\caption{A $<$b$>$caption$<$/b$>$}" in text
    assert r"\label{tab:7}" in text


def test_what_the_methods_cite_is_in_the_references(small_result: Result) -> None:
    """Name and year of every citation; the figures are the record's."""
    text = methods_text(small_result)
    keys = re.findall(r"@article\{(\w+),", references())
    cited = re.findall(r"([A-Z][a-z]+(?:-[A-Z][a-z]+)?)(?: et al\.| and [A-Z]\w+)? \(?(\d{4})", text)
    assert len(cited) == 6
    assert {f"{name.replace('-', '').lower()}{year}" for name, year in cited} == set(keys)
    assert f"seed {small_result.record['seed']}" in text
    assert f"{small_result.record['verdict']['ess']:.0f} effective draws" in text
    assert small_result.sentence in text
    assert small_result.study.kind in text
    assert "did not converge" not in text
    verdict = {**small_result.record["verdict"], "converged": False}
    assert "did not converge" in methods_text(replace(small_result, record={**small_result.record, "verdict": verdict}))


def test_formats_are_refused_by_name(small_result: Result) -> None:
    """The option, what it may be, and what it was."""
    with pytest.raises(ResultError, match=r"^'--figures' must be of svg, pdf, png \(got 'gif'\)$"):
        Export(result=small_result, asked={"figures": ["svg", "gif"]})
    with pytest.raises(ResultError, match=r"^'--to' must be of csv, json, chrono-scm \(got 'xml'\)$"):
        Export(result=small_result, asked={"to": ["xml"]})
