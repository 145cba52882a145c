"""Identifiability analysis as a page, figures of its profiles and a terminal table."""

from typing import Any

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from bayesterra.arrays import FloatArray
from bayesterra.errors import counted
from bayesterra.identifiability import evidence_page
from bayesterra.identifiability.analysis import Foreseen, Identified
from bayesterra.identifiability.information import ALL
from bayesterra.identifiability.profiles import LEVELS, NO_PROFILES, Profile, Profiles
from bayesterra.identifiability.verdicts import COUPLED_TO_ALL, DETERMINED, EXCLUDED, MOVED, SHIFT, WEAK, WORDS
from bayesterra.parameters import PARAMETERS
from bayesterra.report.blocks import Blocks, Cell, Gallery, Overview, Record, Table, Text, drawing, records
from bayesterra.report.figures import GRID, INK, POSTERIOR, PRIOR, label, new_figure, styled
from bayesterra.report.numbers import NOTHING, interval, number, plain, signed
from bayesterra.report.sections import Prose, Section, VerdictPage
from bayesterra.report.symbols import amount, in_symbols, listed, symbol
from bayesterra.report.verdicts import Verdict
from bayesterra.study.result import COUPLED, shown

say = Prose("identify")

FEW = 2
"""Objections that find room on a card."""


def identifiability_page(made: Identified) -> VerdictPage:
    """Put the page together."""
    study, drawn = made.study, f"{made.record['draws']} draws"
    return VerdictPage(
        title=study.title or "Soil parameters from wheel tests",
        facts=(f"{study.kind} data", f"model {study.model.name}, {study.drive}-driven", drawn),
        warning=say("warning", made.record["converged"]),
        verdicts=(_directions_card(made), _parameters_card(made), _agreement_card(made)),
        sections=(
            Section("verdicts", "Verdicts", _verdict_section(made)),
            Section("profiles", "Profiles", _profile_section(made)),
            Section("coupling", "Coupling", evidence_page.coupling_section(made.found.coupling)),
            Section("information", "Information", evidence_page.information_section(made.found.information)),
            Section("local", "Sensitivities", evidence_page.local_section(made.found)),
            Section("method", "Structure and method", evidence_page.method_section(made)),
        ),
        version=made.record["versions"]["bayesterra"],
        template="identifiability.html",
    )


def _directions_card(made: Identified) -> Verdict:
    counts = made.found.counts.set_index("scope")
    determined, of = (int(counts[name].to_dict()[ALL]) for name in ("determined", "directions"))
    grade = "good" if determined == of else "doubtful" if determined else "bad"
    sentence = Markup(made.in_words(lambda name: str(symbol(name))))  # noqa: S704 (constants)
    return Verdict("Independent directions", f"{determined} of {of} fixed", grade, sentence)


def _parameters_card(made: Identified) -> Verdict:
    words = made.found.verdicts.groupby("verdict")["parameter"].agg(list).to_dict()
    determined = words.get("determined", [])
    others = {word: words[word] for word in WORDS if word in words and word != "determined"}
    grade = "good" if len(determined) == len(made.found.names) else "doubtful" if determined else "bad"
    word = f"{len(determined)} of {len(made.found.names)} determined"
    return Verdict("Parameters", word, grade, say("parameters", determined, others))


def _agreement_card(made: Identified) -> Verdict:
    against = [row for row in records(made.found.verdicts) if row["against"]]
    word = counted(len(against), "objection") if against else "agree"
    return Verdict("Methods", word, "doubtful" if against else "good", say("against", against, FEW))


def _verdict_section(made: Identified) -> Blocks:
    text = say("words", 100 * (1 - DETERMINED), 100 * EXCLUDED, COUPLED, COUPLED_TO_ALL, WEAK, SHIFT, MOVED)
    rows = records(made.verdicts)
    against = [row for row in rows if row["against"]]
    objections = (Text(say("objections", against)),) if against else ()
    combined = (
        (row["verdict"], number(row["contraction"], 3, least=0.0), in_symbols(row["combination"]))
        for row in records(made.found.combinations)
    )
    verdicts = say.table("verdict_table", map(_verdict_row, rows))
    return (verdicts, *objections, Text(text), say.table("combinations", combined))


def _verdict_row(row: Record) -> tuple[Cell, ...]:
    name = row["parameter"]
    tie: tuple[Cell, ...] = (NOTHING, NOTHING, NOTHING)
    if row["tied_to"] != name:
        tie = (symbol(row["tied_to"]), signed(row["tie"]), number(row["multiple"], 2))
    return (
        symbol(name),
        Markup("<b>{}</b>").format(row["verdict"]),
        number(max(row["contraction"], 0.0), 2),
        Markup("{}{}").format(row["profile"], _ends(row)),
        *tie,
    )


def _ends(row: Record) -> Cell:
    """The profile's interval in the parameter's unit; what bounds no side says nothing."""
    name, low, high = row["parameter"], row["lower_95"], row["upper_95"]
    if low == low and high == high:
        return Markup(", {}").format(amount(name, interval(low, high)))
    if low == low:
        return Markup(", above {}").format(amount(name, plain(low)))
    return Markup(", below {}").format(amount(name, plain(high))) if high == high else ""


def _profile_section(made: Identified) -> Blocks:
    if not made.found.profiles.found:
        return (Text(NO_PROFILES),)
    panels = drawing(profile_panels(made.found.profiles), profiles_in_words(made.found.profiles))
    table = made.found.profiles.table
    rows = tuple(
        (
            symbol(row["parameter"]),
            row["class"],
            f"{100 * row['trust']:.0f} %" + (f", {row['failed']} not solved" if row["failed"] else ""),
            _moves(row["compensated_by"]),
        )
        for row in records(table[table["kind"] == "likelihood"])
    )
    moves = say.table("compensation", rows)
    return (Gallery("whole", (panels,), say("profiles")), moves)


def _moves(text: str) -> Cell:
    """Such as ``n0 −0.4, c1 +0.3``, with symbols."""
    pairs = [pair.rsplit(" ", 1) for pair in text.split(", ") if pair]
    return listed(Markup("{} {}").format(symbol(name), move) for name, move in pairs) if pairs else NOTHING


HIGHEST = 6.0
"""Upper end of the axis of 2 Δ log density."""
COLUMNS = 4
NARROW = 0.12
"""Share of the prior's range; intervals narrower than that are drawn on a part of it."""
LINES: dict[str, tuple[str, tuple[float, ...], float]] = {
    "likelihood": (INK, (5.0, 3.0), 1.2),
    "posterior": (POSTERIOR, (), 1.9),
}
"""Colour, dashes and width of the curves; the broken one lies on top, so that both show where they agree."""


@styled
def profile_panels(profiles: Profiles) -> FloatArray:
    """Draw one panel per parameter over its prior's range; returns the array of axes (d,).

    Blue: 2 Δ log posterior; broken: 2 Δ log likelihood; 0 is the best point of all. Dots: interval ends,
    where a curve crosses the 68 or 95 % line. Crosses: points that no descent solved. Grey bars: ends of the
    prior's range; grey areas: nothing is possible there. The title of a panel says its class, the
    likelihood's first where the two differ.
    """
    count = len(profiles.names)
    columns = min(COLUMNS, count)
    rows = -(-count // columns)
    figure = new_figure(2.35 * columns + 0.3, 2.15 * rows + 0.4)
    axes = np.atleast_1d(np.asarray(figure.subplots(rows, columns))).ravel()
    for i, name in enumerate(profiles.names):
        _panel(axes[i], profiles, name)
        axes[i].tick_params(labelleft=i % columns == 0)
        if i % columns == 0:
            axes[i].set_ylabel(r"2 $\Delta$ log density")
    for spare in axes[count:]:
        spare.remove()
    _legend(figure, profiles)
    return np.asarray(axes[:count])


def _panel(ax: Axes, profiles: Profiles, name: str) -> None:
    scale = PARAMETERS[name].scale
    ends = profiles.ranges[profiles.names.index(name)] / scale
    for percent, level in LEVELS.items():
        ax.axhline(level, color=GRID, linewidth=0.9)
        ax.annotate(
            f"{percent} %", (1.0, level), xycoords=("axes fraction", "data"), fontsize=6.5,
            ha="right", va="bottom", color=PRIOR,
        )  # fmt: skip
    for kind in profiles.found:
        _curve(ax, profiles.profile(name, kind), scale)
    window = _window(profiles, name) / scale
    margin = 0.03 * (window[1] - window[0])
    _bounds(ax, profiles.profile(name), ends, scale)
    part = (window[1] - window[0]) / (ends[1] - ends[0])
    note = "" if part > 0.99 else f", {100 * part:.2g} % of the range"
    ax.set(xlim=(window[0] - margin, window[1] + margin), ylim=(-0.15, HIGHEST))
    ax.set_xlabel(label(PARAMETERS[name]) + note, labelpad=2)
    title = " / ".join(dict.fromkeys(profiles.profile(name, kind).shape for kind in profiles.found))
    ax.set_title(title if len(title) < 28 else title.replace(" / ", " /\n"), fontsize=8.5)


def _curve(ax: Axes, profile: Profile, scale: float) -> None:
    colour, dashes, _ = LINES[profile.kind]
    grid, height = _smooth(profile)
    ax.plot(grid / scale, height, zorder=3 if dashes else 2, **_line(profile.kind))
    lost = profile.values[profile.failed] / scale
    height = np.minimum(profile.rise[profile.failed], HIGHEST - 0.2)
    ax.plot(lost, height, "x", color=colour, markersize=4.0)
    for percent, level in LEVELS.items():
        ends = np.array(profile.crossings(percent)) / scale
        ax.plot(ends, [level, level], "o", color=colour, markersize=3.2)


def _line(kind: str) -> dict[str, Any]:
    """Look of a curve."""
    colour, dashes, width = LINES[kind]
    return {"color": colour, "linewidth": width, "linestyle": (0, dashes) if dashes else "-"}


def _smooth(profile: Profile) -> tuple[FloatArray, FloatArray]:
    """The curve between its points: the signed root of the rise is close to straight there."""
    usable = np.isfinite(profile.rise) & ~profile.failed
    values, root = profile.values[usable], np.sqrt(np.maximum(profile.rise[usable], 0.0))
    root = np.where(values < profile.best, -root, root)
    grid = np.unique(np.concatenate([values, np.linspace(values[0], values[-1], 400)]))
    return grid, np.interp(grid, values, root) ** 2


def _bounds(ax: Axes, profile: Profile, ends: FloatArray, scale: float) -> None:
    """Mark the ends of the prior's range, and what of it is impossible."""
    possible = profile.values[np.isfinite(profile.rise)][[0, -1]] / scale
    for end, reached in zip(ends, possible, strict=True):
        ax.axvline(end, color=PRIOR, linewidth=2.2, alpha=0.7)
        if abs(end - reached) > 1e-6 * (ends[1] - ends[0]):
            ax.axvspan(*sorted((end, reached)), color=PRIOR, alpha=0.18, linewidth=0)


def _window(profiles: Profiles, name: str) -> FloatArray:
    """The part of the axis that is drawn: the prior's range, or three intervals' widths if that is less."""
    ends = profiles.ranges[profiles.names.index(name)]
    intervals = np.array([profiles.profile(name, kind).interval(95) for kind in profiles.found])
    low, high = intervals[:, 0].min(), intervals[:, 1].max()
    if high - low > NARROW * (ends[1] - ends[0]):
        return np.asarray(ends)
    return np.asarray(np.clip([low - (high - low), high + (high - low)], *ends))


def _legend(figure: Figure, profiles: Profiles) -> None:
    lost = any(profile.failed.any() for each in profiles.found.values() for profile in each)
    cross = Line2D([], [], color=INK, marker="x", markersize=4.0, linestyle="", label="not solved")
    entries: list[Line2D | Patch] = [
        *(Line2D([], [], label=kind, **_line(kind)) for kind in profiles.found),
        Line2D([], [], color=INK, marker="o", markersize=3.2, linestyle="", label="end of an interval"),
        *([cross] if lost else []),
        Line2D([], [], color=PRIOR, linewidth=2.2, alpha=0.7, label="end of the prior's range"),
        Patch(color=PRIOR, alpha=0.18, linewidth=0, label="impossible"),
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries))


def profiles_in_words(profiles: Profiles) -> str:
    """Text of the panels, for those who do not see them."""
    said = []
    for profile in profiles.found["likelihood"]:
        parameter = PARAMETERS[profile.name]
        low, high = (f"{end / parameter.scale:.3g}" for end in profile.interval(95))
        unit = "" if parameter.unit == "-" else f" {parameter.unit}"
        said.append(f"{parameter.symbol} {profile.shape}, 95 % from {low} to {high}{unit}")
    return "Likelihood profiles: " + "; ".join(said) + "."


def identifiability_overview(made: Identified) -> Overview:
    """The verdict on every parameter with its figures, and the finding."""
    rows = records(made.found.verdicts)
    table = Table(made.study.title, "llrll", IDENTIFIED, tuple(_identified(row) for row in rows))
    lines = [f"! {PARAMETERS[row['parameter']].symbol}: {row['against']}." for row in rows if row["against"]]
    if not made.record["converged"]:
        lines.append("! The sampling did not converge: do not rely on what rests on draws.")
    return (table, *map(Text, lines), Text(made.sentence))


IDENTIFIED = ("", "verdict", "contraction", "tied to", "profile")
PROFILES = {"bounded only by the prior": "prior-bound"}
"""Classes of profiles in fewer letters, so that no row of the table breaks on 80 columns."""


def _identified(row: Record) -> tuple[str, ...]:
    tied = row["tied_to"] != row["parameter"]
    tie = f"{PARAMETERS[row['tied_to']].symbol} {signed(row['tie'])}" if tied else ""
    profile = PROFILES.get(str(row["profile"]), str(row["profile"]))
    symbol, word = PARAMETERS[row["parameter"]].symbol, shown(row["verdict"])
    return (symbol, word, _share(row["contraction"]), tie, profile)


def _share(contraction: float) -> str:
    return f"{max(contraction, 0.0):.2f}"


def foreseen_overview(made: Foreseen) -> Overview:
    """What a design could determine, and what contraction to expect."""
    rows = []
    for name, expected in zip(made.spread.names, made.contraction, strict=True):
        word = "determine it" if name in made.structure.determined else "NOT determine it"
        rows.append((PARAMETERS[name].symbol, word, _share(expected)))
    lines = [f"{null.words[:1].upper()}{null.words[1:]}." for null in made.structure.nulls]
    lines.append("Expected over the prior after the physical cut, were the readings made.")
    header = ("", "the design could", "contraction to expect")
    return (Table(made.study.title, "llr", header, tuple(rows)), *map(Text, lines))
