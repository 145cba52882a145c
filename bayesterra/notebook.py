"""How results show themselves in a notebook: as small HTML tables, to the precision of their intervals."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from markupsafe import Markup

from bayesterra.figures.rows import found_rows, summary_rows
from bayesterra.prediction import PREDICTED, UNANSWERED, Prediction
from bayesterra.report.numbers import given, interval, resolution, rounded
from bayesterra.report.symbols import QUANTITIES, angles, symbol, with_unit
from bayesterra.report.verdicts import sampling_verdict
from bayesterra.results import Result
from bayesterra.side_by_side import Comparison

Cell = str | Markup


def result_table(result: Result) -> str:
    """Verdict on the sampling, then every parameter and derived quantity of a result."""
    found = found_rows(result)
    rows = []
    for name, row in summary_rows(result).items():
        step = resolution(*row.hdi)
        word = found[name].verdict if name in found else ""
        if word == "coupled":
            partner = found[name].coupled_with
            word = f"{word} with {QUANTITIES[partner].symbol if partner else 'several'}"
        values = (rounded(row.median, step), interval(*row.hdi), rounded(row.mode, step))
        rows.append((with_unit(name), angles(QUANTITIES[name].description), *values, word))
    verdict = sampling_verdict(result)
    head = Markup("{}; {} {}: {}").format(
        result.study.title or "Result", verdict.sign, verdict.word, verdict.sentence
    )
    return table(head, ("", "", "median", "90 % HDI", "mode", "from these data"), rows, left=(0, 1, 5))


def prediction_table(prediction: Prediction) -> str:
    """Median and 90 % band at every slip, what cannot be relied on, and notes."""
    bands = prediction.table.set_index(["slip", "quantity"])
    rows = []
    for slip, share in zip(prediction.slip, prediction.unanswered, strict=True):
        mark = Markup("<b>{:.3g} %</b>") if share > UNANSWERED else Markup("{:.3g} %")
        found = (bands.loc[(slip, name)].to_dict() for name in PREDICTED)
        rows.append((f"{slip:.4g}", *(_band(row) for row in found), mark.format(100 * share)))
    head = Markup("Wheel {} under {} N: median (90 %), without measurement noise").format(
        prediction.name, given(round(prediction.load, 1))
    )
    header = (symbol("slip"), *(with_unit(name) for name in PREDICTED), "no answer")
    return table(head, header, rows, prediction.notes)


def _band(row: dict[str, float]) -> str:
    low, high = row["modelled_q05"], row["modelled_q95"]
    step = resolution(low, high)
    return f"{rounded(row['modelled_q50'], step)} ({interval(low, high, step)})"


def comparison_table(comparison: Comparison) -> str:
    """Median and 90 % HDI of every quantity in every result, and what the evidence says."""
    cells: dict[str, dict[str, str]] = {}
    for row in comparison.parameters.to_dict("records"):
        step = resolution(row["hdi90_lo"], row["hdi90_hi"])
        ends = interval(row["hdi90_lo"], row["hdi90_hi"], step)
        cells.setdefault(str(row["quantity"]), {})[str(row["result"])] = (
            f"{rounded(row['median'], step)} ({ends})"
        )
    rows = [
        (with_unit(name), *(found.get(one, "") for one in comparison.names)) for name, found in cells.items()
    ]
    return table("Median (90 % HDI)", ("", *comparison.names), rows, evidence_lines(comparison))


def evidence_lines(comparison: Comparison) -> list[str]:
    """What the evidence says of every result, a line each."""
    lines = []
    for row in comparison.evidences.to_dict("records"):
        value = f"{rounded(row['log_evidence'], 0.01)} ± {rounded(row['error'], 0.01)}"
        word = f": {row['word']}" if row["word"] else ""
        loo = f"{rounded(row['elpd'], 0.1)} ± {rounded(row['elpd_se'], 0.1)}"
        left_out = f"; leaving rows out {loo}" if row["result"] in comparison.loo else ""
        says = f": {row['elpd_word']}" if row["elpd_word"] and left_out else ""
        lines.append(f"{row['result']}: log evidence {value}{word}{left_out}{says}")
    return lines


def table(
    head: Cell,
    header: Sequence[Cell],
    rows: Iterable[Sequence[Cell]],
    notes: Iterable[str] = (),
    *,
    left: Sequence[int] = (0,),
) -> str:
    """A table with a heading and notes, columns ``left`` to the left; what is not HTML is escaped."""
    lines = Markup("").join(Markup("<tr>{}</tr>").format(_cells("td", row, left)) for row in rows)
    below = Markup("").join(Markup("<br>{}").format(note) for note in notes)
    return str(
        Markup(
            "<div><b>{}</b><table><thead><tr>{}</tr></thead><tbody>{}</tbody></table><small>{}</small></div>"
        ).format(head, _cells("th", header, left), lines, below)
    )


def _cells(tag: str, cells: Sequence[Cell], left: Sequence[int]) -> Markup:
    start = Markup('<{} style="text-align:{};padding:2px 10px">{}</{}>')
    sides = ("left" if i in left else "right" for i in range(len(cells)))
    return Markup("").join(
        start.format(tag, side, cell, tag) for side, cell in zip(sides, cells, strict=True)
    )
