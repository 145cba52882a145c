"""Model discrepancy as a section and a figure of the report."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes

from bayesterra.checking.discrepancy import Missed, Stretch, missed
from bayesterra.parameters import CHANNELS, field_values
from bayesterra.report.blocks import Block, Gallery, Section, Text, drawing
from bayesterra.report.figures import DATA, INK, POSTERIOR, own_axes, styled
from bayesterra.report.numbers import number, plain
from bayesterra.report.symbols import amount, listed, symbol
from bayesterra.study.result import Result


def missed_sections(result: Result) -> tuple[Section, ...]:
    """A section where the study states a discrepancy, else none."""
    found = list(missed(result))
    if not found:
        return ()
    several = len(result.study.wheels) > 1
    blocks: list[Block] = [Text(_sentence(result, one, several=several)) for one in found]
    pictures = tuple(
        drawing(discrepancy(one), f"Error of the {CHANNELS[one.channel].description} over slip")
        for one in found
    )
    caption = Markup(
        "Discrepancy <i>δ</i> of the model over slip{}: bands of 50 and 90 % and the median; dots: reading "
        "less model without discrepancy, at its median. Dots can lie beside the band where <i>δ</i> and the "
        "parameters trade off."
    ).format(f", wheels {', '.join(dict.fromkeys(one.wheel for one in found))}" if several else "")
    blocks += [Gallery("small", pictures, caption), *_trades(found, several=several), _use(result)]
    return (Section("missed", "What the model misses", tuple(blocks)),)


def _sentence(result: Result, one: Missed, *, several: bool) -> Markup:
    """Where the model is too low or too high, and by how much."""
    of = Markup(" of wheel {}").format(one.wheel) if several else Markup("")
    head = Markup("{}’s {}{}").format(result.study.model.name, CHANNELS[one.channel].description, of)
    if not one.stretches:
        most = plain(float(np.abs(one.bands[[0, -1]]).max()) / CHANNELS[one.channel].scale, 2)
        text = Markup(
            "Whether {} is off at any one slip, the readings leave open: the 90 % band of its error holds 0 "
            "everywhere, and reaches {} at most."
        )
        return text.format(head, amount(one.channel, most))
    parts = listed(_part(one, stretch) for stretch in one.stretches)
    return Markup("{} is {}.").format(head, parts)


def _part(one: Missed, stretch: Stretch) -> Markup:
    scale = CHANNELS[one.channel].scale
    least, most = (plain(abs(value) / scale, 2) for value in (stretch.least, stretch.most))
    size = amount(one.channel, most if least == most else f"{least} to {most}")
    side = "too low" if stretch.most > 0 else "too high"
    whole = (stretch.low <= one.slip[0], stretch.high >= one.slip[-1])
    where = {
        (True, True): "at all driven slips",
        (True, False): f"up to slip {stretch.high:.2g}",
        (False, True): f"from slip {stretch.low:.2g} on",
        (False, False): f"between slips {stretch.low:.2g} and {stretch.high:.2g}",
    }[whole]
    return Markup("{} {} {}").format(size, side, where)


def _trades(found: list[Missed], *, several: bool) -> tuple[Text, ...]:
    """Where discrepancy and parameters cannot be told apart."""
    parts = []
    for one in found:
        for trade in one.trades:
            of = Markup(" of {}").format(one.wheel) if several else Markup("")
            parts.append(
                Markup("{} of <i>δ</i>({}){}, {:.0f} % (most with {}, correlation {})").format(
                    trade.shape, symbol(one.channel), of, 100 * trade.share, symbol(trade.parameter),
                    number(trade.correlation, 2),
                )
            )  # fmt: skip
    if not parts:
        return ()
    text = Markup(
        "Much of this the soil’s parameters could explain as well, and the readings do not say which it is. "
        "Share of the posterior variance that goes with the parameters: {}. There the intervals of these "
        "parameters rest on the prior of the discrepancy."
    )
    return (Text(text.format(listed(parts)), "poor"),)


def _use(result: Result) -> Text:
    wheels = listed(result.study.wheels)
    text = Markup(
        "Curves, predictions and checks of {} hold the discrepancy; of another wheel its prior alone is "
        "known. Derived quantities (greatest pull and the like) are those of the model alone."
    )
    return Text(text.format(wheels))


@styled
def discrepancy(found: Missed, ax: Axes | None = None) -> Axes:
    """Draw a discrepancy over slip: bands of 50 and 90 %, median, and reading less model as dots."""
    ax, channel = own_axes(ax), CHANNELS[found.channel]
    bands = field_values(found.channel, found.bands)
    for low, high, alpha in ((0, 4, 0.18), (1, 3, 0.32)):
        ax.fill_between(found.slip, bands[low], bands[high], color=POSTERIOR, alpha=alpha, linewidth=0)
    ax.axhline(0, color=INK, linewidth=0.7)
    ax.plot(found.slip, bands[2], color=POSTERIOR)
    residuals = field_values(found.channel, found.residuals)
    ax.plot(found.rows, residuals, "o", color=DATA, markersize=4)
    shown = np.concatenate([bands.ravel(), residuals, [0.0]])
    margin = 0.08 * float(np.ptp(shown))
    ax.set_ylim(shown.min() - margin, shown.max() + margin)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=rf"$\delta_{{{channel.latex}}}$ [{channel.unit}]")
    return ax
