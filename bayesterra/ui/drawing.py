"""Drawings as SVG: panels with axes, bands, lines and points, in colours of the style sheet."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from zlib import crc32

import numpy as np
from markupsafe import Markup

from bayesterra.arrays import FloatArray
from bayesterra.report.numbers import given

NOTHING = Markup("")
TICKS = 5
LEFT, RIGHT, TOP, BOTTOM = 52.0, 12.0, 12.0, 36.0


@dataclass
class Panel:
    """A panel of a plot, between ends of both axes; layers are drawn in the order in which they come.

    Attributes
    ----------
    alt : what the picture shows, in words.
    """

    alt: str
    x: tuple[float, float]
    y: tuple[float, float]
    x_label: str = ""
    y_label: str = ""
    width: float = 380.0
    height: float = 230.0
    layers: list[Markup] = field(default_factory=list)

    def across(self, values: Sequence[float] | FloatArray) -> FloatArray:
        """Horizontal places of values."""
        low, high = self.x
        share = (np.asarray(values, dtype=float) - low) / ((high - low) or 1.0)
        return LEFT + np.clip(share, -0.05, 1.05) * (self.width - LEFT - RIGHT)

    def up(self, values: Sequence[float] | FloatArray) -> FloatArray:
        """Vertical places of values."""
        low, high = self.y
        share = (np.asarray(values, dtype=float) - low) / ((high - low) or 1.0)
        return self.height - BOTTOM - np.clip(share, -0.5, 1.5) * (self.height - TOP - BOTTOM)

    def band(self, x: FloatArray, low: FloatArray, high: FloatArray, look: str) -> None:
        """Fill between two curves."""
        there = np.isfinite(low) & np.isfinite(high)
        if there.sum() < 2:
            return
        ends = np.concatenate([self.across(x[there]), self.across(x[there])[::-1]])
        heights = np.concatenate([self.up(low[there]), self.up(high[there])[::-1]])
        self.layers.append(Markup('<polygon class="{}" points="{}"/>').format(look, _points(ends, heights)))

    def line(self, x: FloatArray, y: FloatArray, look: str) -> None:
        """Draw a curve through the values that are there."""
        there = np.isfinite(y)
        self.layers.append(
            Markup('<polyline class="{}" points="{}"/>').format(look, _points(self.across(x[there]), self.up(y[there])))
        )

    def mark(self, x: float, y: float, look: str, title: str, sd: float = 0.0) -> None:
        """Draw a reading, with a bar of one standard deviation to either side where it has one."""
        if not math.isfinite(x) or not math.isfinite(y):
            return
        place, height = float(self.across([x])[0]), float(self.up([y])[0])
        bar = Markup("")
        if math.isfinite(sd) and sd > 0:
            ends = self.up([y - sd, y + sd])
            bar = Markup('<line x1="{0:.1f}" x2="{0:.1f}" y1="{1:.1f}" y2="{2:.1f}"/>').format(place, *ends)
        self.layers.append(
            Markup('<g class="{}"><title>{}</title>{}<circle cx="{:.1f}" cy="{:.1f}" r="3.6"/></g>').format(
                look, title, bar, place, height
            )
        )

    def upright(self, x: float, look: str) -> None:
        """Draw a vertical line."""
        if self.x[0] <= x <= self.x[1]:
            place = float(self.across([x])[0])
            self.layers.append(
                Markup('<line class="{0}" x1="{1:.1f}" x2="{1:.1f}" y1="{2:.1f}" y2="{3:.1f}"/>').format(
                    look, place, TOP, self.height - BOTTOM
                )
            )

    def level(self, y: float, look: str) -> None:
        """Draw a horizontal line."""
        if self.y[0] <= y <= self.y[1]:
            place = float(self.up([y])[0])
            self.layers.append(
                Markup('<line class="{0}" x1="{1:.1f}" x2="{2:.1f}" y1="{3:.1f}" y2="{3:.1f}"/>').format(
                    look, LEFT, self.width - RIGHT, place
                )
            )

    def shade(self, low: float, high: float, look: str, more: Markup = NOTHING) -> None:
        """Shade a stretch of the horizontal axis; ``more``: attributes of the stretch, already HTML."""
        ends = self.across([max(low, self.x[0]), min(high, self.x[1])])
        if ends[1] > ends[0]:
            self.layers.append(
                Markup('<rect class="{}" x="{:.1f}" y="{:.1f}" width="{:.1f}" height="{:.1f}"{}/>').format(
                    look, ends[0], TOP, ends[1] - ends[0], self.height - TOP - BOTTOM, more
                )
            )

    def svg(self, more: Markup = NOTHING) -> Markup:
        """The panel as an element of a page; ``more``: attributes of it, already HTML."""
        clip = f"clip{crc32(repr((self.alt, self.x, self.y, self.y_label)).encode()):x}"
        inner = (LEFT, TOP, self.width - LEFT - RIGHT, self.height - TOP - BOTTOM)
        rectangle = Markup('<rect x="{:g}" y="{:g}" width="{:g}" height="{:g}"/>').format(*inner)
        return Markup(
            '<svg class="panel" viewBox="0 0 {:g} {:g}" role="img" aria-label="{}"{}>'
            '<defs><clipPath id="{}">{}</clipPath></defs>{}<g clip-path="url(#{})">{}</g></svg>'
        ).format(
            self.width, self.height, self.alt, more, clip, rectangle, self._axes(), clip, Markup("").join(self.layers)
        )

    def _axes(self) -> Markup:
        base, end = self.height - BOTTOM, self.width - RIGHT
        parts = [Markup('<path class="axis" d="M{:g} {:g}V{:g}H{:g}"/>').format(LEFT, TOP, base, end)]
        for value in ticks(*self.x):
            x = float(self.across([value])[0])
            parts.append(
                Markup('<text class="tick middle" x="{:.1f}" y="{:.1f}">{}</text>').format(x, base + 14, given(value))
            )
        for value in ticks(*self.y):
            y = float(self.up([value])[0])
            parts.append(
                Markup('<line class="grid" x1="{:g}" x2="{:g}" y1="{:.1f}" y2="{:.1f}"/>').format(LEFT, end, y, y)
            )
            parts.append(
                Markup('<text class="tick end" x="{:.1f}" y="{:.1f}">{}</text>').format(LEFT - 5, y + 3.5, given(value))
            )
        middle = (LEFT + end) / 2
        parts.append(
            Markup('<text class="name middle" x="{:.1f}" y="{:.1f}">{}</text>').format(
                middle, self.height - 5, self.x_label
            )
        )
        up = (TOP + base) / 2
        turned = Markup('<text class="name middle" transform="translate(11 {:.1f}) rotate(-90)">{}</text>')
        parts.append(turned.format(up, self.y_label))
        return Markup("").join(parts)


def _points(x: FloatArray, y: FloatArray) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))


def ticks(low: float, high: float) -> list[float]:
    """Round values between two ends, about ``TICKS`` of them."""
    span = high - low
    if not (math.isfinite(span) and span > 0):
        return []
    step = 10.0 ** math.floor(math.log10(span / TICKS))
    step *= next(times for times in (1, 2, 5, 10) if span / (times * step) <= TICKS)
    first = math.ceil(low / step - 1e-9)
    return [round((first + i) * step, 12) + 0.0 for i in range(int((high - first * step) / step + 1e-9) + 1)]


def ends(*columns: Iterable[float] | FloatArray, margin: float = 0.06) -> tuple[float, float]:
    """Lowest and highest of all values that are there, with a margin to either side."""
    values = np.concatenate(
        [
            np.ravel(np.asarray(list(column) if not isinstance(column, np.ndarray) else column, float))
            for column in columns
        ]
    )
    values = values[np.isfinite(values)]
    if not values.size:
        return 0.0, 1.0
    low, high = float(values.min()), float(values.max())
    width = (high - low) or abs(high) or 1.0
    return low - margin * width, high + margin * width
