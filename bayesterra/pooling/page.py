"""Result of a study with groups as a page, with its figure."""

from collections.abc import Hashable, Mapping
from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.correlated import TYPICAL
from bayesterra.likelihood.joint import joint_posterior
from bayesterra.likelihood.page import conditions, prior_sources, priors_table, slip_note
from bayesterra.parameters import PARAMETERS, whole_and_part
from bayesterra.pooling.degrees import CONSTANT, OPEN, STRONG
from bayesterra.pooling.run import PooledResult
from bayesterra.report.blocks import Blocks, Cell, Gallery, Overview, Table, Text, drawing
from bayesterra.report.figures import DATA, MARKS, POSTERIOR, PRIOR, label, literal, new_figure, styled
from bayesterra.report.numbers import NOTHING, interval, moments, number, plain, resolution, rounded
from bayesterra.report.sections import Draft, Prose, VerdictPage, repeated
from bayesterra.report.symbols import listed, symbol, symbols, unit
from bayesterra.report.terminal import failure_lines
from bayesterra.report.verdicts import Verdict
from bayesterra.study.page import crosscheck, crosscheck_line, unconverged
from bayesterra.study.study import Study

say = Prose("pooling")

WORDS = {"complete": "complete pooling", "as stated": "pooling as stated", "none": "no pooling"}


def pooled_page(result: PooledResult) -> VerdictPage:
    """Put the page of a joint posterior together."""
    study, record = result.study, result.record
    rows = study.observations
    facts = (
        f"{len(result.groups)} groups by {record['pooling']['by']}", *study.described.values(),
        f"{int(rows.use.sum())} of {len(rows)} rows in the fit",
        f"model {study.model.name}, {study.drive}-driven", f"{len(result.summary)} free parameters",
        f"analysed {str(record['made'])[:10]}",
    )  # fmt: skip
    draft, degrees = Draft(result), ("degrees", "complete")
    verdicts = (
        *draft.failures.attempt("report: verdicts", lambda: result.verdicts, tuple[Verdict, ...]),
        draft.verdict("One value for all?", _sharing, "sharing"),
        draft.verdict("Evidence prefers", _preferred, *degrees),
    )
    sections = (
        draft.section("sharing", "What belongs to the soil", _sharing_section, "sharing"),
        draft.section("groups", "Parameters by group", _groups_section),
        draft.section("pooling", "Complete, partial and no pooling", _degrees_section, *degrees),
        draft.section("posterior", "Joint posterior", _summary_section),
        draft.section("prior", "Prior and roles", _prior_section),
        draft.section("data", "Data and model", _data),
        draft.section("reproduce", "Reproduce this", lambda result: (repeated("run STUDY", result.record),)),
    )
    return VerdictPage(
        title=study.title or "One soil, several groups of rows",
        facts=tuple(fact for fact in facts if fact), verdicts=verdicts, sections=sections,
        version=record["versions"]["bayesterra"],
        warning=draft.warning(unconverged(result, "The sampling has <b>not converged</b>: {}.")),
        failures=draft.failures, kind=study.kind, template="pooled.html",
        sentence=draft.failures.attempt("report: sentence", lambda: result.sentence, str),
    )  # fmt: skip


def _named(text: object) -> Markup:
    names = str(text).split(" and ")
    return symbols(names) if len(names) == 1 else Markup("{} together").format(symbols(names))


def _sharing(result: PooledResult) -> Verdict:
    alone, stated = _by_word(result, "verdict"), _by_word(result, "verdict_as_stated", beside=OPEN)
    clauses = [
        Markup("{}{}: {}").format(word, others, listed(names))
        for others, by_word in (("", alone), (", with the others as stated", stated))
        for word, names in by_word.items()
        if word != OPEN
    ]
    rows = result.sharing.to_dict("records")
    open_ = [_named(row["parameter"]) for row in rows if not _decided(row)]
    if open_:
        clauses.append(Markup("{}: {}").format(OPEN, listed(open_)))
    decided = len(rows) - len(open_)
    grade = "good" if decided else "doubtful"
    word = f"{decided} of {len(rows)} decided"
    return Verdict("One value for all?", word, grade, Markup("; ").join(clauses) + ".")


def _decided(row: Mapping[Any, Any]) -> bool:
    """True where the groups' own posteriors or the joint one tell."""
    words = (row["verdict"], row.get("verdict_as_stated"))
    return any(isinstance(word, str) and word not in ("", OPEN) for word in words)


def _preferred(result: PooledResult) -> Verdict:
    preferred = str(result.record["pooling"]["preferred"])
    rows = {row["pooling"]: row for row in result.pooling.to_dict("records")}
    clauses = [Markup("{} {}").format(WORDS[n], number(row["log_evidence"], 1)) for n, row in rows.items()]
    word = WORDS.get(preferred, "not decided")
    grade = "good" if preferred in WORDS and result.pooling["converged"].all() else "doubtful"
    return Verdict("Evidence prefers", word, grade, Markup("Log evidence: {}.").format(listed(clauses)))


def _sharing_section(result: PooledResult) -> Blocks:
    body = []
    for row in result.sharing.to_dict("records"):
        error = _with_error(row["log_bayes_factor"], row["error"], bool(row.get("reliable", True)))
        spread: Cell = NOTHING
        if np.isfinite(row["spread_median"]):
            spread = Markup("{} ({})").format(
                plain(row["spread_median"], 2), interval(row["spread_hdi90_lo"], row["spread_hdi90_hi"])
            )
        against = (number(row[f"against_{what}"], 1) for what in ("own_values", "a_population"))
        name, role, word = _named(row["parameter"]), str(row["role"]), str(row["verdict"])
        body.append((name, role, *against, error, word, *_as_stated(row), spread))
    by = result.record["pooling"]["by"]
    sentence = Text(say("sentence", *(_by_word(result, column) for column in ("verdict", "verdict_as_stated"))))
    return (sentence, say.table("sharing", body, by, STRONG, CONSTANT, OPEN))


def _as_stated(row: dict[Any, Any]) -> tuple[Cell, Cell]:
    """Factor and word with all others as the study has them; older results have neither."""
    word = row.get("verdict_as_stated")
    if not isinstance(word, str) or not word:
        return NOTHING, NOTHING
    reliable = bool(row.get("reliable_as_stated", True))
    return _with_error(row["log_bayes_factor_as_stated"], row["error_as_stated"], reliable), word


def _by_word(result: PooledResult, column: str, *, beside: str | None = None) -> dict[str, list[Markup]]:
    """Parameters by their verdict, what is open last; ``beside``: those with this verdict from the groups alone."""
    by_word: dict[str, list[Markup]] = {}
    for row in result.sharing.to_dict("records"):
        word = row.get(column)
        if isinstance(word, str) and word and beside in (None, row["verdict"]):
            by_word.setdefault(word, []).append(_named(row["parameter"]))
    return dict(sorted(by_word.items(), key=lambda part: part[0] == OPEN))


def _groups_section(result: PooledResult) -> Blocks:
    names = [name for name in PARAMETERS if name in result.draws["alone"].data_vars]
    held = result.draws["posterior"]
    shared = [name for name in names if "group" not in held[name].dims]
    own = [name for name in names if name not in shared]
    blocks: list[Gallery] = []
    for chosen, title in ((shared, "Shared"), (own, "Each group's own")):
        if chosen:
            pictures = tuple(
                drawing(group_strip(result, name), f"{PARAMETERS[name].description} by group") for name in chosen
            )
            blocks.append(Gallery("half", pictures, say("groups", title, symbols(chosen))))
    return tuple(blocks)


def _degrees_section(result: PooledResult) -> Blocks:
    body = []
    for row in result.pooling.to_dict("records"):
        evidence = _with_error(row["log_evidence"], row["log_evidence_error"], row["evidence_reliable"])
        elpds = (
            _with_error(row[f"elpd_{of}"], row[f"se_{of}"], row[f"unreliable_{of}"] == 0) for of in ("rows", "groups")
        )
        body.append((WORDS[row["pooling"]], "yes" if row["converged"] else "no", evidence, *elpds))
    table = say.table("degrees", body)
    return (table, _by_group(result))


def _with_error(value: float, error: float, reliable: bool) -> Cell:
    if not np.isfinite([value, error]).all():
        return NOTHING
    return Markup("{} ± {}{}").format(
        number(value, 1), rounded(error, 0.1 if error > 0.1 else 0.01), "" if reliable else "*"
    )


def _by_group(result: PooledResult) -> Table:
    some = result.left_out[result.left_out["what"] == "group"]
    degrees, body = list(dict.fromkeys(some["pooling"])), []
    for group in result.groups:
        own = some[some["label"].astype(str) == group].set_index("pooling")
        cells = [_with_error(own.loc[d, "elpd"], own.loc[d, "error"], bool(own.loc[d, "reliable"])) for d in degrees]
        body.append((group, *cells))
    return say.table("by_group", body, more=(WORDS[d] for d in degrees))


def _summary_section(result: PooledResult) -> Blocks:
    body = tuple(_row(row) for row in result.summary.to_dict("records"))
    return (say.table("summary", body), *crosscheck(result.record))


def _row(row: Mapping[Hashable, Any]) -> tuple[Cell, ...]:
    name = str(row["parameter"])
    base, part = whole_and_part(name)
    step = resolution(row["hdi90_lo"], row["hdi90_hi"])
    label = Markup("{} {}").format(symbol(base), part.strip("[].").replace("]", ""))
    return (
        label, unit(base) or NOTHING, rounded(row["mode"], step), rounded(row["median"], step),
        interval(row["hdi90_lo"], row["hdi90_hi"]), *moments(row["mean"], row["sd"]),
        plain(min(row["ess_bulk"], row["ess_tail"])), plain(row["r_hat"], 4),
        *moments(row["prior_mean"], row["prior_sd"]),
    )  # fmt: skip


def _prior_section(result: PooledResult) -> Blocks:
    study = result.study
    return (priors_table(study, say("prior", joined_laws(study))), *prior_sources(study))


def joined_laws(study: Study) -> Markup:
    """Independence of laws in words; where they are not independent, each pair with its correlation."""
    named = [
        Markup("{} {:+.2f}").format(symbols(pair.split(", ")), value) for pair, value in study.prior.correlation.items()
    ]
    named += [
        Markup("{} by a mixture of {} normal laws of scores").format(symbols(names.split(", ")), len(mixture.weights))
        for names, mixture in study.prior.mixtures.items()
    ]
    return say("joined_laws", listed(named))


def _data(result: PooledResult) -> Blocks:
    blocks = [*conditions(result.study)]
    if result.study.errors.slip is not None:
        joint, frame = joint_posterior(result.study), result.to_dataframe()
        typical = frame[list(joint.names)].to_numpy()[:: max(1, len(frame) // TYPICAL)]
        for x, density in zip(joint.values_of_groups(typical), joint.groups.values(), strict=True):
            blocks += slip_note(density, x)
    return tuple(blocks)


WIDTH, ROW = 4.4, 0.34


@styled
def group_strip(result: PooledResult, name: str) -> Axes:
    """Draw one parameter for every group: 50 and 90 % intervals over the range of its prior.

    Grey bars: the group alone. Blue bars: all groups together. A shared parameter has one blue bar for all, a
    hierarchical one its population's mean too. Circle: the true or published value, where there is one.
    """
    joint, alone = result.draws["posterior"], result.draws["alone"]
    scale, groups = PARAMETERS[name].scale, list(result.groups)
    figure = new_figure(WIDTH, ROW * (len(groups) + 2) + 0.35)
    ax: Axes = figure.subplots()
    shared = "group" not in joint[name].dims
    for i, group in enumerate(groups):
        _bar(ax, alone[name].sel(group=group).to_numpy() / scale, i + 0.15, PRIOR)
        if not shared:
            _bar(ax, joint[name].sel(group=group).to_numpy().ravel() / scale, i - 0.15, POSTERIOR)
    rows = [*groups]
    if shared or f"{name}.mean" in joint:
        source = name if shared else f"{name}.mean"
        _bar(ax, joint[source].to_numpy().ravel() / scale, len(groups), POSTERIOR)
        rows.append("all groups" if shared else "population mean")
    reference = result.study.truth or result.study.published
    if reference is not None:
        mark, values = MARKS["truth"], reference.values
        own = [values.get(f"{name}[{row}]", values.get(name, np.nan)) for row in groups]
        own += [values.get(f"{name}.mean", values.get(name, np.nan))] * (len(rows) - len(groups))
        ax.plot(np.array(own) / scale, np.arange(len(rows)), mark.marker, color=DATA,
                markerfacecolor="none", markersize=5, linestyle="none")  # fmt: skip
    names = [literal(row) for row in rows]
    ax.set(yticks=np.arange(len(rows)), yticklabels=names, ylim=(len(rows) - 0.4, -0.6))
    ax.set_xlim(*_limits(result, name))
    ax.set_xlabel(label(PARAMETERS[name]))
    ax.tick_params(axis="y", length=0)
    return ax


def _bar(ax: Axes, draws: FloatArray, at: float, colour: str) -> None:
    low, first, middle, third, high = np.quantile(draws, [0.05, 0.25, 0.5, 0.75, 0.95])
    ax.plot([low, high], [at, at], color=colour, linewidth=1.2, solid_capstyle="butt")
    ax.plot([first, third], [at, at], color=colour, linewidth=4.0, solid_capstyle="butt")
    ax.plot([middle], [at], "|", color=colour, markersize=9)


def _limits(result: PooledResult, name: str) -> tuple[float, float]:
    """The range of the prior, without the outer thousandth where it has no end."""
    law = result.study.prior.laws[name]
    tails = law.quantile(np.array([0.001, 0.999]))
    ends = [end if np.isfinite(end) else tail for end, tail in zip(law.range, tails, strict=True)]
    return ends[0] / PARAMETERS[name].scale, ends[1] / PARAMETERS[name].scale


def pooled_overview(result: PooledResult) -> Overview:
    """Degrees of pooling, convergence, and what is shared."""
    pooling = result.record["pooling"]
    rows = []
    for row in pooling["degrees"]:
        figures = (row["log_evidence"], row["elpd_rows"], row["elpd_groups"])
        rows.append((row["pooling"], *(f"{figure:.1f}" for figure in figures)))
    lines = [f"Evidence prefers: {pooling['preferred']}. {pooling['sentence']}"]
    if stated := pooling.get("sentence_as_stated"):
        lines.append(f"With the other parameters as this study has them: {stated}")
    header = ("pooling", "log evidence", "elpd of rows", "elpd of groups")
    judged = (*(verdict.line for verdict in result.verdicts), Text(result.sentence))
    rest = (*crosscheck_line(result.record), *failure_lines(result.record))
    return (Table("", "lrrr", header, tuple(rows)), *judged, *map(Text, lines), *rest)
