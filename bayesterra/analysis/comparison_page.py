"""Comparison as a page, a notebook table and a terminal table."""

from collections.abc import Callable, Hashable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.axes import Axes

from bayesterra.analysis.comparison import BARE, MOVED, Comparison, outcomes_of
from bayesterra.arrays import FloatArray
from bayesterra.checking.loo import INDISTINCT
from bayesterra.checking.validation import Validation, fit_verdict
from bayesterra.likelihood.page import noise_text, stated_law
from bayesterra.parameters import CHANNELS, DERIVED, PARAMETERS
from bayesterra.prediction.prediction import PREDICTED, quantiles
from bayesterra.report.blocks import Blocks, Cell, Gallery, Overview, Table, Text, drawing
from bayesterra.report.figures import DATA, INK, Axis, density, label, literal, own_axes, styled
from bayesterra.report.numbers import NOTHING, estimate, given, plain, probability, rounded, signed, with_error
from bayesterra.report.sections import Prose, Section, VerdictPage
from bayesterra.report.symbols import angles, listed, quantity_of, symbol, symbols, with_unit
from bayesterra.report.verdicts import Verdict
from bayesterra.study.page import axis
from bayesterra.study.result import Result, summary_rows
from bayesterra.study.study import Study

say = Prose("comparison")


def comparison_page(comparison: Comparison) -> VerdictPage:
    """Put the page together."""
    titles = dict.fromkeys(result.study.title for result in comparison.results.values())
    kinds = dict.fromkeys(result.study.kind for result in comparison.results.values())
    first = next(iter(comparison.results.values()))
    curve = comparison.curves[comparison.names[0]]
    return VerdictPage(
        title=next(iter(titles)) if len(titles) == 1 else f"{len(comparison.names)} results side by side",
        facts=(
            f"{', '.join(kinds)} data",
            *keys(comparison),
            f"{driven_by(comparison)}, {given(round(curve.load, 1))} N",
        ),
        warning=say("warning", [name for name, result in comparison.results.items() if not result.converged]),
        verdicts=(_readings(comparison), _evidence(comparison), _moves(comparison)),
        sections=(
            Section("parameters", "Parameters", parameters_section(comparison)),
            Section("predictions", "Predictions", predictions_section(comparison)),
            Section("studies", "What is compared", compared_section(comparison)),
            Section("evidence", "Evidence, cross-validation, fit and sampling", judged_section(comparison)),
            Section("repeat", "Reproduce this", repeat_section(comparison)),
        ),
        version=first.record["versions"]["bayesterra"],
        template="contrast.html",
    )


def _readings(comparison: Comparison) -> Verdict:
    first, *others = comparison.names
    apart = [name for name in others if not comparison.comparable(first, name)]
    if apart:
        studies = ((name, comparison.results[name].study) for name in (first, *apart))
        explained = listed(Markup("{}: {}").format(name, _counted(study)) for name, study in studies)
        return Verdict("Readings explained", "not the same", "doubtful", say("apart", explained))
    sentence = Markup("All explain the same readings: {}.").format(_counted(comparison.results[first].study))
    return Verdict("Readings explained", "the same", "good", sentence)


def _counted(study: Study) -> Markup:
    rows = study.observations.used()
    counts = [int((~np.isnan(rows.values[name])).sum()) for name in study.noise]
    return Markup("{} of {}").format(sum(counts), symbols(study.noise))


def _evidence(comparison: Comparison) -> Verdict:
    names, evidence = _alike(comparison), comparison.evidence
    if len(names) < 2:
        return Verdict("Evidence", "not comparable", "doubtful", say("no_evidence"))
    errors = {name: with_error(evidence[name].value, evidence[name].error) for name in names}
    values = listed(Markup("{} {} ± {}").format(name, *pair) for name, pair in errors.items())
    best, second = sorted(names, key=lambda name: -evidence[name].value)[:2]
    word, difference = comparison.word(second, best), rounded(comparison.difference(second, best)[0], 0.1)
    left_out = comparison.left_out_word(second, best) if comparison.left_out(second, best) is not None else ""
    sentence = say("evidence", values, word, BARE, best, second, difference, left_out)
    if word.startswith("not "):
        return Verdict("Evidence", word.partition(":")[0], "doubtful", sentence)
    return Verdict("Evidence", f"{best} favoured", "good", sentence)


def _alike(comparison: Comparison) -> list[str]:
    """The largest group of results with known evidence that explain the same readings."""
    groups: dict[str, list[str]] = {}
    for name, evidence in comparison.evidence.items():
        if np.isfinite(evidence.value):
            groups.setdefault(evidence.outcomes, []).append(name)
    return max(groups.values(), key=len, default=[])


def _moves(comparison: Comparison) -> Verdict:
    """Parameters and derived quantities that move from the first result to the others."""
    table, first = comparison.parameters, comparison.names[0]
    moved = table[(table["shift"].abs() >= MOVED) & (table["result"] != first)]
    moved = moved.reindex(moved["shift"].abs().sort_values(ascending=False).index)
    count = table[table["result"] == first]["quantity"].nunique()
    shifts = [
        Markup("{} ({} in {})").format(symbol(row["quantity"]), shift(row["shift"]), row["result"])
        for row in moved.head(4).to_dict("records")
    ]
    word = "agree" if moved.empty else f"{moved['quantity'].nunique()} of {count} move"
    sentence = say("moves", MOVED, first, shifts, len(moved) > len(shifts))
    return Verdict("Conclusions", word, "good" if moved.empty else "doubtful", sentence)


def comparison_overview(comparison: Comparison) -> Overview:
    """Median and 90 % HDI of every quantity in every result, and what the evidence says."""
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for row in comparison.parameters.to_dict("records"):
        middle, ends = estimate(row["median"], row["hdi90_lo"], row["hdi90_hi"])
        key = (str(row["quantity"]).replace("_", " "), str(row["unit"]))
        cells.setdefault(key, {})[str(row["result"])] = f"{middle} ({ends})"
    rows = [(*key, *(entries.get(name, "") for name in comparison.names)) for key, entries in cells.items()]
    header = ("median (90 % HDI)", "unit", *comparison.names)
    table = Table("", "ll" + "r" * len(comparison.names), header, tuple(rows))
    return (table, *map(Text, evidence_lines(comparison)))


def evidence_lines(comparison: Comparison) -> list[str]:
    """Evidence of every result in words, a line each."""
    lines = []
    for row in comparison.evidences.to_dict("records"):
        value = f"{rounded(row['log_evidence'], 0.01)} ± {rounded(row['error'], 0.01)}"
        word = f": {row['word']}" if row["word"] else ""
        loo = f"{rounded(row['elpd'], 0.1)} ± {rounded(row['elpd_se'], 0.1)}"
        left_out = f"; leaving rows out {loo}" if row["result"] in comparison.loo else ""
        says = f": {row['elpd_word']}" if row["elpd_word"] and left_out else ""
        lines.append(f"{row['result']}: log evidence {value}{word}{left_out}{says}")
    return lines


SLIPS = 4
"""Slips in the table of predictions, at most."""
_KEY = Markup('<span class="named"><span class="swatch drawn" style="background:{}"></span>{}</span>')


def keys(comparison: Comparison) -> tuple[Markup, ...]:
    """Every result's name with its colour."""
    return tuple(_KEY.format(colour, name) for name, colour in zip(comparison.names, COLOURS, strict=False))


def driven_by(comparison: Comparison) -> str:
    """Name of the wheel that the predictions are for."""
    wheels = {curve.wheel: curve.name for curve in comparison.curves.values()}
    return f"wheel {next(iter(wheels.values()))}" if len(wheels) == 1 else "each result with its own wheel"


def shift(value: float) -> str:
    """A shift to a tenth, without a sign where nothing is left of it."""
    text = signed(value, 1)
    return "0.0" if text in ("+0.0", "−0.0") else text


def parameters_section(comparison: Comparison) -> Blocks:
    """Densities, intervals and shifts of parameters and derived quantities."""
    free = {name for result in comparison.results.values() for name in result.names}
    rows = [_row(comparison, name) for name in PARAMETERS if name in free]
    derived = [_row(comparison, name) for name in DERIVED if _cells(comparison, name)]
    header = ("", "", "median, 90 % HDI", "shift", "width")
    caption = say("parameters", Markup(" ").join(keys(comparison)), comparison.names[0])
    curve = comparison.curves[comparison.names[0]]
    other = say("parameters_other", given(round(curve.load, 1)), driven_by(comparison))
    blocks = [Table(caption, "lllrr", header, tuple(rows)), Table(other, "lllrr", header, tuple(derived))]
    return tuple(block for block in blocks if block.rows)


def _cells(comparison: Comparison, name: str) -> list[tuple[Markup, str, str]]:
    """Median with interval, shift and width of every result that has the quantity."""
    table = comparison.parameters
    cells = []
    for row in table[table["quantity"] == name].to_dict("records"):
        middle, ends = estimate(row["median"], row["hdi90_lo"], row["hdi90_hi"])
        text = coloured(comparison, row["result"], f"{middle} ({ends})")
        first = row["result"] == comparison.names[0]
        cells.append((text, "" if first else shift(row["shift"]), "" if first else plain(row["width"], 2)))
    return cells


def coloured(comparison: Comparison, name: str, text: str) -> Markup:
    """Text with the colour of a result."""
    return _KEY.format(COLOURS[comparison.names.index(name)], text)


def _row(comparison: Comparison, name: str) -> tuple[Cell, ...]:
    draw = contrast_derived if name in DERIVED else contrast
    described = quantity_of(name).description
    picture = drawing(draw(comparison, name), f"{described} in all results")
    image = Markup('<img class="drawn" src="{}" alt="{}" width="{}">').format(picture.data, picture.alt, picture.width)
    cells = _cells(comparison, name) + list(_fixed(comparison, name))
    columns = (Markup("<br>").join(column) for column in zip(*cells, strict=True))
    return (Markup("{}<small>{}</small>").format(with_unit(name), angles(described)), image, *columns)


def _fixed(comparison: Comparison, name: str) -> Iterator[tuple[Markup, str, str]]:
    """Values of results that hold the parameter."""
    for result_name, result in comparison.results.items():
        if name in result.study.prior.fixed:
            value = given(result.study.prior.fixed[name] / PARAMETERS[name].scale)
            yield coloured(comparison, result_name, f"fixed at {value}"), "", ""


def predictions_section(comparison: Comparison) -> Blocks:
    """Predictions of the results for driving under one load."""
    pictures = tuple(
        drawing(contrast_prediction(comparison, name), f"{quantity.description} over slip in all results")
        for name, quantity in PREDICTED.items()
    )
    curve = comparison.curves[comparison.names[0]]
    caption = say("predictions", given(round(curve.load, 1)), Markup(" ").join(keys(comparison)))
    notes = [Text(Markup("Note ({}): {}.").format(n, note)) for n, p in comparison.points.items() for note in p.notes]
    return (Gallery("half", pictures, caption), _predicted(comparison), *notes)


def _predicted(comparison: Comparison) -> Table:
    slips = comparison.points[comparison.names[0]].slip
    few = slips[np.unique(np.linspace(0, len(slips) - 1, SLIPS).round().astype(int))]
    table = comparison.predictions
    rows = []
    for slip in few:
        at = table[table["slip"] == slip]
        columns = (_bands(comparison, at, name) for name in PREDICTED)
        rows.append((f"{slip:.3g}", *columns, _unanswered(at)))
    heads = map(with_unit, PREDICTED)
    return Table(say("predicted"), "l" * (len(PREDICTED) + 2), (symbol("slip"), *heads, "no answer"), tuple(rows))


def _bands(comparison: Comparison, table: pd.DataFrame, name: str) -> Markup:
    lines = []
    for row in table[table["quantity"] == name].to_dict("records"):
        low, middle, high = (float(row[f"modelled_q{level}"]) for level in ("05", "50", "95"))
        lines.append(coloured(comparison, row["result"], "{} ({})".format(*estimate(middle, low, high))))
    return Markup("<br>").join(lines)


def _unanswered(table: pd.DataFrame) -> str:
    """The greatest share of draws without an answer, marked where it is more than one in twenty."""
    worst = max(table.to_dict("records"), key=lambda row: int(row["no_answer"]))
    if not worst["no_answer"]:
        return NOTHING
    share = f"{100 * worst['no_answer'] / worst['draws']:.1f} % of {worst['result']}"
    return f"{share}: unreliable" if worst["marked"] else share


def compared_section(comparison: Comparison) -> Blocks:
    """Entries that the studies have in common, and those in which they differ."""
    rows = []
    for what, described in _ASPECTS.items():
        rows.append((what, *_same([described(result) for result in comparison.results.values()])))
    for name in PARAMETERS:
        entries = [result.study.prior.entries.get(name) for result in comparison.results.values()]
        cells = ["" if entry is None else stated_law(name, entry) for entry in entries]
        if any(cells):
            rows.append((Markup("prior of {}").format(symbol(name)), *_same(cells)))
    rows.sort(key=lambda row: row[-1] == "same")
    caption = "The studies: first, in bold, where they differ; then what all share."
    header = ("", *keys(comparison))
    return (Table(caption, "l" * len(header), header, tuple(rows)),)


def _same(cells: list[Cell]) -> tuple[Cell, ...]:
    """The cells, the later ones as a word where all agree."""
    if any(cell != cells[0] for cell in cells):
        return tuple(Markup("<b>{}</b>").format(cell or NOTHING) for cell in cells)
    return (cells[0] or NOTHING, *("same" for _ in cells[1:]))


def _rows(result: Result) -> str:
    rows = result.study.observations
    slip = rows.used().slip
    return f"{int(rows.use.sum())} of {len(rows)} in the fit, slip {slip.min():.3g} to {slip.max():.3g}"


def _noise(result: Result) -> Markup:
    return Markup("; ").join(
        Markup("{} {}").format(symbol(name), noise_text(result.study, name)) for name in result.study.noise
    )


def _wheels(result: Result) -> str:
    texts = []
    for name, wheel in result.study.wheels.items():
        sizes = (wheel.radius, wheel.width, wheel.lug_height, float(wheel.shearing_radius()))
        r, b, h, rs = (given(round(1e3 * size, 2)) for size in sizes)
        texts.append(f"{name}: r {r}, b {b}, h {h}, r_s {rs} mm, {wheel.lug_count} lugs")
    return "; ".join(texts)


_ASPECTS: dict[str, Callable[[Result], Cell]] = {
    "title": lambda result: result.study.title,
    "data": lambda result: f"{result.study.kind}; {result.study.source}",
    "model": lambda result: result.study.model.name,
    "options": lambda result: "; ".join(f"{n.replace('_', ' ')} {v}" for n, v in result.study.model.options.items()),
    "drive": lambda result: result.study.drive,
    "wheels": _wheels,
    "rows": _rows,
    "noise": _noise,
}


def judged_section(comparison: Comparison) -> Blocks:
    """Evidence, cross-validation, fit and sampling of every result."""
    rows = [_judged(comparison, row) for row in comparison.evidences.to_dict("records")]
    return (say.table("judged", rows, comparison.names[0]), *_left_out(comparison))


def _judged(comparison: Comparison, row: Mapping[Hashable, Any]) -> tuple[Cell, ...]:
    name = str(row["result"])
    result = comparison.results[name]
    verdict = result.record["verdict"]
    evidence = " ± ".join(with_error(float(row["log_evidence"]), float(row["error"])))
    fit = fit_verdict(Validation.from_record(result.record).checks)
    p = [Markup(", <i>p</i> {}").format(probability(value)) for value in list(fit.figures.values())[:1]]
    return (
        coloured(comparison, name, name),
        evidence if row["reliable"] else f"{evidence}*",
        _difference(comparison, name, row["difference"], row["difference_error"]),
        str(row["word"]),
        "yes" if result.converged else Markup("<b>no</b>"),
        plain(verdict["r_hat"], 4),
        plain(verdict["ess"]),
        Markup("{}{}").format(fit.word, *(p or [Markup("")])),
    )


def _left_out(comparison: Comparison) -> tuple[Table, ...]:
    """Cross-validation of the results: how well they predict rows that they have not seen."""
    if not comparison.loo:
        return ()
    rows = []
    for row in comparison.evidences.to_dict("records"):
        name, elpd = str(row["result"]), " ± ".join(with_error(float(row["elpd"]), float(row["elpd_se"])))
        change = _difference(comparison, name, row["elpd_difference"], row["elpd_difference_se"])
        rows.append((coloured(comparison, name, name), elpd, change, str(row["elpd_word"])))
    return (say.table("left_out", rows, INDISTINCT),)


def _difference(comparison: Comparison, name: str, value: float, error: float) -> str:
    """A difference from the first result and its error; nothing for the first itself."""
    if name == comparison.names[0] or not np.isfinite(value):
        return "" if name == comparison.names[0] else NOTHING
    return " ± ".join(with_error(float(value), float(error)))


def repeat_section(comparison: Comparison) -> Blocks:
    """Origin of the page: everything that it was made of."""
    rows: list[tuple[Cell, ...]] = []
    for name, record in ((name, result.record) for name, result in comparison.results.items()):
        made = (str(record["seed"]), str(record["made"]), str(record["versions"]["bayesterra"]))
        prints = (record["fingerprints"][of][:16] for of in ("study", "data"))
        codes = map(Markup("<code>{}</code>").format, prints)
        rows.append((coloured(comparison, name, name), *made, *codes))
    header = ("", "seed", "made", "bayesterra", "study", "data")
    caption = "The results; fingerprints of study and data (SHA-256, first 16 digits)."
    return (Table(caption, "lrllll", header, tuple(rows)),)


COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
"""One Okabe–Ito colour per result, in their order."""
_LANE = 0.16
NEAR = 0.05
"""Readings under a load within this share of the common one are shown."""


@styled
def contrast(comparison: Comparison, name: str, ax: Axes | None = None) -> Axes:
    """Draw one parameter in all results, each in its colour.

    Filled: posterior density. Dashed: prior after the physical cut, where the parameter is free. Bars:
    90 % highest-density interval with the median as a dot; a vertical line where the parameter is fixed.
    """
    ax = own_axes(ax, 6.0, 0.52 + 0.1 * len(comparison.names))
    free = {n: result for n, result in comparison.results.items() if name in result.names}
    axes = [axis(result, name) for result in free.values()]
    low, high = min(along.low for along in axes), max(along.high for along in axes)
    along = Axis(low, high, all(along.log for along in axes), axes[0].bounds)
    for lane, (result_name, result) in enumerate(comparison.results.items()):
        colour = COLOURS[lane]
        if result_name in free:
            prior, row = density(result.column(name, "prior"), along), summary_rows(result)[name]
            ax.plot(along.grid(200), 0.5 * prior, color=colour, linewidth=0.8, dashes=(3, 2), alpha=0.7)
            _lane(ax, along, lane, result.column(name), row.hdi, row.median)
        elif name in result.study.prior.fixed:
            fixed = result.study.prior.fixed[name] / PARAMETERS[name].scale
            ax.axvline(fixed, color=colour, linewidth=1.2)
    _frame(ax, along, len(comparison.names))
    return ax


@styled
def contrast_derived(comparison: Comparison, name: str, ax: Axes | None = None) -> Axes:
    """Draw one derived quantity (a key of ``derived.DERIVED``) in all results, as :func:`contrast` does.

    Every result drives its own wheel under the common load; priors are left out, they are far wider.
    """
    ax = own_axes(ax, 6.0, 0.52 + 0.1 * len(comparison.names))
    table = comparison.parameters
    table = table[table["quantity"] == name].set_index("result")
    draws = {result_name: comparison.curves[result_name].derived[name] for result_name in table.index}
    finite = {n: values[np.isfinite(values)] / DERIVED[name].scale for n, values in draws.items()}
    ends = np.concatenate([np.quantile(values, [0.002, 0.998]) for values in finite.values()])
    margin = 0.03 * float(np.ptp(ends)) or 0.01
    along = Axis(float(ends.min() - margin), float(ends.max() + margin), False, (-np.inf, np.inf))
    for result_name, values in finite.items():
        row, lane = table.loc[result_name], comparison.names.index(result_name)
        _lane(ax, along, lane, values, (row["hdi90_lo"], row["hdi90_hi"]), row["median"])
    _frame(ax, along, len(comparison.names))
    return ax


@styled
def contrast_prediction(comparison: Comparison, quantity: str, ax: Axes | None = None) -> Axes:
    """Draw one quantity (a key of ``prediction.PREDICTED``) over slip in all results, each in its colour.

    Lines: medians; bands: 90 % of the modelled values, without noise, under the common load. Dots: readings
    in the fits that were taken with the same wheel and load.
    """
    ax = own_axes(ax)
    column, scale = list(PREDICTED).index(quantity), PREDICTED[quantity].scale
    for (result_name, curve), colour in zip(comparison.curves.items(), COLOURS, strict=False):
        low, middle, high = quantiles(curve.modelled[:, :, column])[::2] / scale
        ax.fill_between(curve.slip, low, high, color=colour, alpha=0.22, linewidth=0)
        ax.plot(curve.slip, middle, color=colour, linewidth=1.3, label=literal(result_name))
    _dots(ax, comparison, quantity)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=label(PREDICTED[quantity]))
    return ax


def _dots(ax: Axes, comparison: Comparison, quantity: str) -> None:
    """Readings of any of the results that were taken with its predicted wheel under the common load."""
    shown = set()
    for name, result in comparison.results.items():
        rows, curve = result.study.observations.used(), comparison.curves[name]
        if quantity not in rows.values or outcomes_of(result) in shown:
            continue
        loads = np.where(np.isnan(rows.load), rows.values.get("normal_force", rows.load), rows.load)
        driven = np.array([result.study.wheels[wheel] == curve.wheel for wheel in rows.wheel])
        mine = driven & (np.abs(loads / curve.load - 1) < NEAR)
        values = rows.values[quantity][mine] / CHANNELS[quantity].scale
        ax.plot(rows.slip[mine], values, "o", color=DATA, markersize=4, zorder=6)
        shown.add(outcomes_of(result))


def _lane(ax: Axes, along: Axis, lane: int, values: FloatArray, ends: tuple[float, float], median: float) -> None:
    """Density of values (n,), and under it their interval and median, in the colour of a lane."""
    colour, heights, height = COLOURS[lane], density(values, along), -_LANE * (lane + 1)
    ax.fill_between(along.grid(200), heights, color=colour, alpha=0.28, linewidth=0)
    ax.plot(along.grid(200), heights, color=colour, linewidth=1.0)
    ax.plot(ends, [height, height], color=colour, linewidth=3.5, solid_capstyle="butt")
    ax.plot([median], [height], "o", color="white", markeredgecolor=colour, markersize=4.5, zorder=5)


def _frame(ax: Axes, along: Axis, lanes: int) -> None:
    ax.set(
        xlim=(along.low, along.high), ylim=(-_LANE * (lanes + 0.7), 1.05), yticks=[],
        xscale="log" if along.log else "linear",
    )  # fmt: skip
    ax.axhline(0, color=INK, linewidth=0.5)
    ax.spines["left"].set_visible(False)
