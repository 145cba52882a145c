"""A followed stream as a figure and as lines on a terminal."""

from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from scipy.stats import binom

from bayesterra.arrays import FloatArray
from bayesterra.follow.rows import BAND_NAMES, column_of
from bayesterra.follow.session import FollowedStream, RowOutcome
from bayesterra.parameters import CHANNELS, PARAMETERS, Parameter, whole_and_part
from bayesterra.report.blocks import Overview, Table, Text
from bayesterra.report.figures import DATA, GRID, POSTERIOR, figure_of, label, new_figure, styled
from bayesterra.report.numbers import estimate
from bayesterra.report.terminal import PlainConsole, note

ALARM = "#D55E00"
COLUMNS = 4
RARE = 0.001
"""Probability of so many readings outside their bands, by a model that is right, below which it is called wrong."""


@styled
def bands_over_rows(updates: pd.DataFrame, truth: Mapping[str, float] | None = None) -> FloatArray:
    """Draw median and 90 % band of every parameter after each row; returns the array of axes.

    Of long streams the first fiftieth does not count for the limits of the axes.

    Dashed: the row at which the soil seems to have changed, where there was an alarm. Dotted: true values of
    simulated data.

    Parameters
    ----------
    updates : a table as ``updates.csv``; a column ``soil`` counts the soils of a stream that began anew.
    truth : SI values by parameter.
    """
    stems = [str(column).split("_q50")[0] for column in updates.columns if "_q50" in str(column)]
    names = [name for name in stems if whole_and_part(name)[0] in PARAMETERS]
    alarms = updates["alarm"].dropna().tolist() if "alarm" in updates.columns else []
    lines = -(-len(names) // COLUMNS)
    figure = new_figure(8.0, 1.75 * lines + 0.35)
    axes = np.asarray(figure.subplots(lines, COLUMNS, sharex=True, squeeze=False))
    for ax, name in zip(axes.ravel(), names, strict=False):
        _band(ax, updates, PARAMETERS[name])
        if truth and name in truth:
            ax.axhline(truth[name] / PARAMETERS[name].scale, color=DATA, linewidth=1.0, linestyle=":")
        for since in alarms:
            ax.axvline(float(since), color=ALARM, linewidth=1.0, linestyle="--")
    for ax in axes.ravel()[len(names) :]:
        ax.set_visible(False)
    for index in range(len(names)):
        if index + COLUMNS >= len(names):
            axes.ravel()[index].set_xlabel("row")
            axes.ravel()[index].tick_params(labelbottom=True)
    _legend(axes, truth=bool(truth), alarms=bool(alarms))
    return axes


def _band(ax: Axes, updates: pd.DataFrame, parameter: Parameter) -> None:
    low, middle, high = (column_of(parameter, key) for key in BAND_NAMES)
    soils = updates["soil"] if "soil" in updates.columns else pd.Series(1, index=updates.index)
    for _, part in updates.groupby(soils.to_numpy()):
        ax.fill_between(part["row"], part[low], part[high], color=POSTERIOR, alpha=0.25, linewidth=0)
        ax.plot(part["row"], part[middle], color=POSTERIOR, marker="" if len(part) > 1 else ".")
    # the first rows of a long stream know so little that nothing later could be seen beside them
    settled = updates.iloc[len(updates) // 50 :]
    bottom, top = float(settled[low].min()), float(settled[high].max())
    margin = 0.05 * (top - bottom) or 1e-12
    ax.set_ylim(bottom - margin, top + margin)
    ax.set_ylabel(label(parameter))
    ax.xaxis.set_major_locator(MaxNLocator(4, integer=True))
    ax.grid(color=GRID, linewidth=0.4, alpha=0.6)


def _legend(axes: FloatArray, *, truth: bool, alarms: bool) -> None:
    entries: list[Patch | Line2D] = [
        Line2D([], [], color=POSTERIOR, label="median"),
        Patch(color=POSTERIOR, alpha=0.25, label="90 % interval"),
    ]
    if truth:
        entries.append(Line2D([], [], color=DATA, linewidth=1.0, linestyle=":", label="true value"))
    if alarms:
        entries.append(Line2D([], [], color=ALARM, linewidth=1.0, linestyle="--", label="soil changed"))
    figure_of(axes).legend(handles=entries, loc="outside lower center", ncols=len(entries))


def print_row(seen: RowOutcome, *, quiet: bool) -> None:
    """One line: slip, every reading beside what was expected of it, particles, time; alarms in their own."""
    where = f" (row {seen.place} of the file)" if seen.place else ""
    if seen.update is None or seen.row is None:
        note(f"left out: {seen.problem}{where}")
        return
    update = seen.update
    if not quiet:
        readings = "  ".join(filter(None, (_reading(row) for row in update.predictive.to_dict("records"))))
        moved = f", moved {update.sweeps}×" if update.rejuvenated else ""
        PlainConsole().print(
            f"{update.row:>4}  slip {seen.row.slip[0]:.3f}  {readings}"
            f"  ({update.effective:.0f} effective{moved}, {1e3 * update.seconds:.0f} ms)",
            soft_wrap=True,
        )
    if update.alarm:
        anew = "; begun anew there" if seen.begun_anew is not None else ""
        PlainConsole().print(f"! {update.alarm.sentence}{where}{anew}", soft_wrap=True)


def _reading(reading: dict[object, object]) -> str:
    """A reading and the 90 % interval that was expected; what was not measured says nothing."""
    observed, low, high = (float(str(reading[key])) for key in ("observed", "q05", "q95"))
    if np.isnan(observed):
        return ""
    symbol, unit = CHANNELS[str(reading["channel"])].symbol, str(reading["unit"])
    if np.isnan(low):
        return f"{symbol} {observed:.4g} {unit} (nothing was expected)"
    middle, ends = estimate(observed, low, high)
    return f"{symbol} {middle} {unit} {ends}{'' if low <= observed <= high else ' *'}"


def followed_overview(followed: FollowedStream) -> Overview:
    """The parameters, the evidence, and whether the soil has changed."""
    stream = followed.stream
    soil = f", soil {followed.soil} since row {stream.offset + 1}" if followed.soil > 1 else ""
    rows = []
    for row in stream.summary.to_dict("records"):
        figures = estimate(row["median"], row["q05"], row["q95"])
        rows.append((PARAMETERS[row["parameter"]].symbol, row["unit"], *figures))
    left = f", {followed.left_out} left out" if followed.left_out else ""
    evidence = f"{stream.log_evidence:.2f} ± {stream.log_evidence_error:.2f}"
    read = "slip on the radius '{slip_reference}', sinkage from '{sinkage_reference}'".format(**stream.references)
    lines = [f"{len(stream)} rows{left}, {read}; log evidence {evidence}."]
    outside, of = followed.misses
    if wrong := binom.sf(outside - 1, of, 0.1) < RARE:
        lines.insert(0, f"The model does not predict these rows: {outside} of {of} readings lie outside the 90 % bands"
                        " expected of them. It is wrong for them, or the noise is stated too small.")  # fmt: skip
    if stream.watch.rate is None:
        lines.append("Changes of soil were not looked for.")
    elif followed.soil == 1 and not followed.alarms and stream.alarm is None:
        lines.append(
            f"No change of soil was found (at most {stream.watch.rate:g} false alarms per row, on average"
            f" over the prior){'; by a model that does not predict that says nothing' if wrong else ''}."
        )
    header = ("parameter", "unit", "median", "90 % interval")
    title = f"{stream.study.title or 'stream'}{soil}"
    told = (Text(line, "bad" if wrong and not i else "") for i, line in enumerate(lines))
    return (Table(title, "llrr", header, tuple(rows)), *told)
