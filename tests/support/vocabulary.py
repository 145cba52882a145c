"""One vocabulary: cards, sentence, tables, CSV files, record and terminal of a result say one thing."""

import re
from html import unescape
from pathlib import Path

import pandas as pd

from bayesterra.parameters import PARAMETERS
from bayesterra.report.numbers import interval, resolution, rounded
from bayesterra.report.verdicts import SIGNS
from bayesterra.runtime.reading import read_json
from tests.support.matrix import Kind


def _plain(html: str) -> str:
    return " ".join(unescape(re.sub(r"<[^>]+>", "", html)).replace("\u2009", " ").split())


def _rows(html: str, caption: str) -> list[list[str]]:
    """Cells of the table whose caption begins with some words."""
    tables = re.findall(r'<figure class="table.*?</figure>', html, re.S)
    chosen = next(table for table in tables if caption in _plain(table[: table.index("</figcaption>")]))
    return [
        [_plain(cell) for cell in re.findall(r"<td.*?</td>", row, re.S)]
        for row in re.findall(r"<tr>.*?</tr>", chosen[chosen.index("<tbody>") :], re.S)
    ]


def says_one_thing(kind: Kind, out: Path, printed: str) -> None:
    """Verdicts, sentence, counts and words of the parameters of a run, in its folder and as it ``printed`` them."""
    html, record = (out / "report.html").read_text(encoding="utf-8"), read_json(out / "run.json")
    shown, told = _plain(html), " ".join(printed.split())
    assert record["sentence"] in told
    assert record["sentence"] in shown
    for verdict in record.get("verdicts", ()):
        sign = SIGNS[verdict["grade"]]
        assert f"{verdict['name']} {sign} {verdict['word']}" in shown
        assert f"{verdict['name']}: {verdict['word']}. {' '.join(verdict['sentence'].split())}" in told
    if kind["groups"] != "none":
        assert [verdict["name"] for verdict in record["verdicts"]] == ["Sampling", "Fit", "Prediction"]
        return
    assert [verdict["name"] for verdict in record["verdicts"]] == ["Sampling", "Fit", "Prediction", "Soil"]
    table = pd.read_csv(out / "identifiability.csv")
    alone = int((table["verdict"] == "determined").sum())
    soil = record["verdicts"][3]
    assert soil["word"] == f"{alone} of {len(table)} determined"
    assert soil["figures"]["determined"] == alone
    strip = re.findall(r'<td class="word">(.*?)</td>', html, re.S)
    assert len(strip) == len(table)
    for said, known in zip(strip, table.to_dict("records"), strict=True):
        assert known["verdict"].replace("determined", "") in _plain(said)
        assert f" {PARAMETERS[known['parameter']].symbol} " in f" {told} "
    summary = pd.read_csv(out / "summary.csv").set_index("parameter")
    posterior = _rows(html, "Posterior of parameters and derived quantities")
    assert len(posterior) == len(summary)
    for cells, (name, row) in zip(posterior, summary.iterrows(), strict=True):
        if name in PARAMETERS:
            step = resolution(row["hdi90_lo"], row["hdi90_hi"])
            figures = [rounded(row[column], step) for column in ("mode", "median")]
            assert cells[3:5] == [str(figure) for figure in figures]
            assert cells[7] == interval(row["hdi90_lo"], row["hdi90_hi"])
