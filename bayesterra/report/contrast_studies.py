"""What the compared results were made from, and how good they are: sections of the page side by side."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from markupsafe import Markup

from bayesterra.adequacy import fit_checks
from bayesterra.crossvalidation import INDISTINCT
from bayesterra.models import Wheel
from bayesterra.parameters import PARAMETERS
from bayesterra.priors import Law, Tie
from bayesterra.report.blocks import Cell, Section, Table
from bayesterra.report.contrast_parts import coloured, keys
from bayesterra.report.inputs import noise_text
from bayesterra.report.numbers import NOTHING, given, plain, probability, with_error
from bayesterra.report.symbols import amount, law_text, symbol
from bayesterra.results import Result
from bayesterra.side_by_side import Comparison


def compared_section(comparison: Comparison) -> Section:
    """What the studies have in common and where they differ."""
    rows = []
    for what, described in _ASPECTS.items():
        cells = [described(result) for result in comparison.results.values()]
        rows.append((what, *_same(cells)))
    for name in PARAMETERS:
        cells = [_prior(result, name) for result in comparison.results.values()]
        if any(cells):
            rows.append((Markup("prior of {}").format(symbol(name)), *_same(cells)))
    rows.sort(key=lambda row: row[-1] == "same")
    caption = "The studies: first, in bold, where they differ; then what all share."
    header = ("", *keys(comparison))
    return Section("studies", "What is compared", (Table(caption, "l" * len(header), header, tuple(rows)),))


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
        Markup("{} {}").format(symbol(name), noise_text(noise)) for name, noise in result.study.noise.items()
    )


def _options(result: Result) -> str:
    options = asdict(result.study.model).items()
    return "; ".join(f"{name.replace('_', ' ')} {value}" for name, value in options)


def _wheels(result: Result) -> str:
    return "; ".join(f"{name}: {_wheel(wheel)}" for name, wheel in result.study.wheels.items())


def _wheel(wheel: Wheel) -> str:
    sizes = (wheel.radius, wheel.width, wheel.lug_height, float(wheel.shearing_radius()))
    r, b, h, rs = (given(round(1e3 * size, 2)) for size in sizes)
    return f"r {r}, b {b}, h {h}, r_s {rs} mm, {wheel.lug_count} lugs"


def _prior(result: Result, name: str) -> Cell:
    entry = result.study.prior.entries.get(name)
    if entry is None or isinstance(entry, Law):
        return "" if entry is None else law_text(name, entry)
    if isinstance(entry, Tie):
        return Markup("that of {}").format(symbol(entry.to))
    return Markup("fixed at {}").format(amount(name, given(float(entry) / PARAMETERS[name].scale)))


_ASPECTS: dict[str, Callable[[Result], Cell]] = {
    "title": lambda result: result.study.title,
    "data": lambda result: f"{result.study.kind}; {result.study.source}",
    "model": lambda result: result.study.model.name,
    "options": _options,
    "drive": lambda result: result.study.drive,
    "wheels": _wheels,
    "rows": _rows,
    "noise": _noise,
}


def judged_section(comparison: Comparison) -> Section:
    """Evidence, cross-validation, fit and sampling of every result."""
    rows = [_judged(comparison, row) for row in comparison.evidences.to_dict("records")]
    caption = Markup(
        "Log evidence: log of the probability density of the readings, averaged over the prior after the "
        "physical cut; it favours the result that foretold the readings better, and depends on the width of "
        "the priors. Difference from {}: below 1 not worth more than a bare mention, to 3 positive, to 5 "
        "strong, above very strong (Kass and Raftery 1995), and nothing below two standard errors. * the run "
        "itself found that its evidence cannot be relied on: its true error may be much larger."
    ).format(comparison.names[0])
    header = ("", "log evidence", "difference", "in words", "converged", "R-hat", "ESS", "model fit")
    table = Table(caption, "lrrlcrrl", header, tuple(rows))
    return Section(
        "evidence", "Evidence, cross-validation, fit and sampling", (table, *_left_out(comparison))
    )


def _judged(comparison: Comparison, row: Mapping[Hashable, Any]) -> tuple[Cell, ...]:
    name = str(row["result"])
    result = comparison.results[name]
    verdict = result.record["verdict"]
    return (
        coloured(comparison, name, name),
        Markup("{} ± {}{}").format(
            *with_error(float(row["log_evidence"]), float(row["error"])), "" if row["reliable"] else "*"
        ),
        _difference(comparison, name, row["difference"], row["difference_error"]),
        str(row["word"]),
        "yes" if result.converged else Markup("<b>no</b>"),
        plain(verdict["r_hat"], 4),
        plain(verdict["ess"]),
        _fit(result),
    )


def _fit(result: Result) -> Markup:
    """The overall check where the record holds it, else the p values of the channels."""
    checks = result.record.get("predictive_checks")
    if checks:
        word = "not adequate" if checks["alarm"] else "adequate"
        return Markup("{}, <i>p</i> {}").format(word, probability(checks["overall"]))
    parts = (Markup("{} {}").format(symbol(c.channel), probability(c.p)) for c in fit_checks(result))
    return Markup("<i>p</i> {}").format(Markup(", ").join(parts))


def _left_out(comparison: Comparison) -> tuple[Table, ...]:
    """How well the results predict rows that they have not seen."""
    if not comparison.loo:
        return ()
    rows = [
        (
            coloured(comparison, str(row["result"]), str(row["result"])),
            Markup("{} ± {}").format(*with_error(float(row["elpd"]), float(row["elpd_se"]))),
            _difference(comparison, str(row["result"]), row["elpd_difference"], row["elpd_difference_se"]),
            str(row["elpd_word"]),
        )
        for row in comparison.evidences.to_dict("records")
    ]
    caption = Markup(
        "Leave-one-out cross-validation by row: log density of every row’s readings, predicted from the "
        "others (elpd ± standard error). Not distinguishable below {:.0f}, or two standard errors, of "
        "difference."
    ).format(INDISTINCT)
    return (Table(caption, "lrrl", ("", "elpd", "difference", "in words"), tuple(rows)),)


def _difference(comparison: Comparison, name: str, value: float, error: float) -> str:
    """A difference from the first result and its error; nothing for the first itself."""
    if name == comparison.names[0] or not np.isfinite(value):
        return "" if name == comparison.names[0] else NOTHING
    return " ± ".join(with_error(float(value), float(error)))


def repeat_section(comparison: Comparison) -> Section:
    """What the page was made of."""
    rows = [
        (
            coloured(comparison, name, name),
            str(result.record["seed"]),
            str(result.record["made"]),
            str(result.record["versions"]["bayesterra"]),
            Markup("<code>{}</code>").format(result.record["fingerprints"]["study"][:16]),
            Markup("<code>{}</code>").format(result.record["fingerprints"]["data"][:16]),
        )
        for name, result in comparison.results.items()
    ]
    header = ("", "seed", "made", "bayesterra", "study", "data")
    caption = "The results; fingerprints of study and data (SHA-256, first 16 digits)."
    return Section("repeat", "Reproduce this", (Table(caption, "lrllll", header, tuple(rows)),))
