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
    curves = list(missed(result))
    if not curves:
        return ()
    several = len(result.study.wheels) > 1
    blocks: list[Block] = [Text(_sentence(result, curve, several=several)) for curve in curves]
    pictures = tuple(
        drawing(discrepancy(curve), f"Error of the {CHANNELS[curve.channel].description} over slip")
        for curve in curves
    )
    caption = Markup(
        "Discrepancy <i>δ</i> of the model over slip{}: bands of 50 and 90 % and the median; dots: reading "
        "less model without discrepancy, at its median. Dots can lie beside the band where <i>δ</i> and the "
        "parameters trade off."
    ).format(f", wheels {', '.join(dict.fromkeys(curve.wheel for curve in curves))}" if several else "")
    blocks += [Gallery("small", pictures, caption), *_trades(curves, several=several), _use(result)]
    return (Section("missed", "What the model misses", tuple(blocks)),)


def _sentence(result: Result, curve: Missed, *, several: bool) -> Markup:
    """Sentence on where the model is too low or too high, and by how much."""
    of = Markup(" of wheel {}").format(curve.wheel) if several else Markup("")
    head = Markup("{}’s {}{}").format(result.study.model.name, CHANNELS[curve.channel].description, of)
    if not curve.stretches:
        most = plain(float(np.abs(curve.bands[[0, -1]]).max()) / CHANNELS[curve.channel].scale, 2)
        text = Markup(
            "Whether {} is off at any one slip, the readings leave open: the 90 % band of its error holds 0 "
            "everywhere, and reaches {} at most."
        )
        return text.format(head, amount(curve.channel, most))
    stretches = listed(_part(curve, stretch) for stretch in curve.stretches)
    return Markup("{} is {}.").format(head, stretches)


def _part(curve: Missed, stretch: Stretch) -> Markup:
    scale = CHANNELS[curve.channel].scale
    least, most = (plain(abs(value) / scale, 2) for value in (stretch.least, stretch.most))
    size = amount(curve.channel, most if least == most else f"{least} to {most}")
    side = "too low" if stretch.most > 0 else "too high"
    whole = (stretch.low <= curve.slip[0], stretch.high >= curve.slip[-1])
    where = {
        (True, True): "at all driven slips",
        (True, False): f"up to slip {stretch.high:.2g}",
        (False, True): f"from slip {stretch.low:.2g} on",
        (False, False): f"between slips {stretch.low:.2g} and {stretch.high:.2g}",
    }[whole]
    return Markup("{} {} {}").format(size, side, where)


def _trades(curves: list[Missed], *, several: bool) -> tuple[Text, ...]:
    """Text on shapes where discrepancy and parameters cannot be told apart."""
    shares = []
    for curve in curves:
        for trade in curve.trades:
            of = Markup(" of {}").format(curve.wheel) if several else Markup("")
            shares.append(
                Markup("{} of <i>δ</i>({}){}, {:.0f} % (most with {}, correlation {})").format(
                    trade.shape, symbol(curve.channel), of, 100 * trade.share, symbol(trade.parameter),
                    number(trade.correlation, 2),
                )
            )  # fmt: skip
    if not shares:
        return ()
    text = Markup(
        "Much of this the soil’s parameters could explain as well, and the readings do not say which it is. "
        "Share of the posterior variance that goes with the parameters: {}. There the intervals of these "
        "parameters rest on the prior of the discrepancy."
    )
    return (Text(text.format(listed(shares)), "poor"),)


def _use(result: Result) -> Text:
    wheels = listed(result.study.wheels)
    text = Markup(
        "Curves, predictions and checks of {} hold the discrepancy; of another wheel its prior alone is "
        "known. Derived quantities (greatest pull and the like) are those of the model alone."
    )
    return Text(text.format(wheels))


@styled
def discrepancy(curve: Missed, ax: Axes | None = None) -> Axes:
    """Draw a discrepancy over slip: bands of 50 and 90 %, median, and reading less model as dots."""
    ax, channel = own_axes(ax), CHANNELS[curve.channel]
    bands = field_values(curve.channel, curve.bands)
    for low, high, alpha in ((0, 4, 0.18), (1, 3, 0.32)):
        ax.fill_between(curve.slip, bands[low], bands[high], color=POSTERIOR, alpha=alpha, linewidth=0)
    ax.axhline(0, color=INK, linewidth=0.7)
    ax.plot(curve.slip, bands[2], color=POSTERIOR)
    residuals = field_values(curve.channel, curve.residuals)
    ax.plot(curve.rows, residuals, "o", color=DATA, markersize=4)
    shown = np.concatenate([bands.ravel(), residuals, [0.0]])
    margin = 0.08 * float(np.ptp(shown))
    ax.set_ylim(shown.min() - margin, shown.max() + margin)
    ax.set(xlabel="slip ratio $s$ [–]", ylabel=rf"$\delta_{{{channel.latex}}}$ [{channel.unit}]")
    return ax
