"""Reduction of a log in the page: its windows beside its channels, moved by hand where they should be."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from markupsafe import Markup

from bayesterra.errors import StudyError
from bayesterra.reduce.log import LOGGED, Log
from bayesterra.reduce.reduction import Reduction, reduce_logs
from bayesterra.reduce.windows import Settings, Window, window_at
from bayesterra.study.units import quantity
from bayesterra.ui.drawing import LEFT, RIGHT, Panel, ends

SHOWN = ("travel_speed", "rim_speed", "slip", "load", "sinkage", "normal_force", "drawbar_pull", "resistance_moment")
MOST_POINTS = 700
WIDTH = 900.0
LEFT_OUT = "left out by hand"
ASKED = ("radius", "lugs", "plate", "steady", "kind")
DEFAULTS = {"radius": "", "lugs": "0", "plate": "", "steady": "0.02", "kind": "measured"}
Form = Mapping[str, str]


@dataclass(frozen=True)
class Reduced:
    """A log with its windows, those that a person moved in their new places."""

    reduction: Reduction
    found: tuple[Window, ...]
    form: Form

    @classmethod
    def of(cls, path: Path, form: Form) -> Reduced:
        """The reduction that a form asks for."""
        asked = {name: form.get(name, DEFAULTS[name]).strip() for name in ASKED}
        found = reduce_logs(
            [path], radius=asked["radius"] or None, plate=asked["plate"] or None, lugs=_whole(asked["lugs"]),
            steady=_share(asked["steady"]), kind=asked["kind"] or "measured",
        )  # fmt: skip
        radius = quantity(asked["radius"], "m", "radius") if asked["radius"] else None
        settings = Settings(radius, _whole(asked["lugs"]), _share(asked["steady"]))
        windows = tuple(_placed(found.logs[0], settings, i, w, form) for i, w in enumerate(found.windows))
        _check_apart(windows)
        return cls(replace(found, windows=windows), found.windows, form)

    @property
    def windows(self) -> list[SimpleNamespace]:
        """Windows with what their fields hold."""
        return [
            self._fields(i, w, found)
            for i, (w, found) in enumerate(zip(self.reduction.windows, self.found, strict=True))
        ]

    def _fields(self, number: int, window: Window, found: Window) -> SimpleNamespace:
        """Fields of a window: where it was moved to, else where it was found, and what its row says."""
        moved = window not in (found, replace(found, rejected=LEFT_OUT, mean={}, sd={}))
        start, end = (
            (self.form[f"window/{number}/{name}"] for name in ("start", "end")) if moved else _found(found).split()
        )
        slip = f"{window.mean['slip']:.4g} ± {window.sd['slip']:.2g}" if window.mean else ""
        return SimpleNamespace(
            number=number, start=start, end=end, found=_found(found), rejected=window.rejected, slip=slip,
            left_out=window.rejected == LEFT_OUT,
        )  # fmt: skip

    def panels(self) -> list[Markup]:
        """Channels over time with their windows, or plate tests with their loading branches."""
        if self.reduction.branches:
            return [_branch(branch) for branch in self.reduction.branches]
        log = self.reduction.logs[0]
        return [_channel(log, name, self.reduction.windows) for name in SHOWN if name in log.values]

    def overview(self) -> Any:
        """Rows, what was rejected, and why, as the command line prints them."""
        return self.reduction.overview()


def _placed(log: Log, settings: Settings, number: int, window: Window, form: Form) -> Window:
    """A window where the form has it; the one that was found where the form leaves it there."""
    if form.get(f"window/{number}/use") == "no":
        return replace(window, rejected=LEFT_OUT, mean={}, sd={})
    start, end = form.get(f"window/{number}/start", ""), form.get(f"window/{number}/end", "")
    if not start or not end or f"{start} {end}" in (form.get(f"window/{number}/found"), _found(window)):
        return window
    first, last = _time(start), _time(end)
    if not first < last:
        raise StudyError(f"a window must end after it begins (got {first:g} s to {last:g} s)")
    return window_at(log, settings, first, last)


def _found(window: Window) -> str:
    """Ends of a window as the page writes them."""
    return f"{window.start:.3f} {window.end:.3f}"


def _check_apart(windows: tuple[Window, ...]) -> None:
    """StudyError where two windows that give rows share samples: these would count twice."""
    kept = sorted((w.start, w.end, i + 1) for i, w in enumerate(windows) if not w.rejected)
    for (_, end, first), (start, _, second) in pairwise(kept):
        if start < end:
            raise StudyError(f"windows {first} and {second} overlap: leave one out, or move it away")


def _time(typed: str) -> float:
    try:
        value = float(typed)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise StudyError(f"a window begins and ends at a number of seconds (got {typed!r:.40})")
    return value


def _whole(typed: str) -> int:
    if not typed.isdecimal() and typed:
        raise StudyError(f"'lugs' must be a whole number (got {typed!r:.40})")
    return min(int(typed or 0), 100_000)


def _share(typed: str) -> float:
    try:
        return float(typed or DEFAULTS["steady"])
    except ValueError:
        raise StudyError(f"'steady' must be a number (got {typed!r:.40})") from None


def _channel(log: Log, name: str, windows: tuple[Window, ...]) -> Markup:
    channel, time = LOGGED[name], log.values["time"]
    values = log.values[name] / channel.scale
    low, high = np.nanquantile(values, [0.002, 0.998])
    panel = Panel(
        f"{channel.description} over time, with its windows", (float(time[0]), float(time[-1])),
        ends([float(low), float(high)], margin=0.15), "time [s]", f"{channel.symbol} [{channel.unit}]", WIDTH, 130.0,
    )  # fmt: skip
    thin = slice(None, None, max(len(time) // MOST_POINTS, 1))
    panel.line(time[thin], values[thin], "trace")
    for i, window in enumerate(windows):
        look = "window rejected" if window.rejected else "window"
        panel.shade(window.start, window.end, look, Markup(' data-window="{}"').format(i))
        if name in window.mean:
            mean = window.mean[name] / channel.scale
            panel.line(np.array([window.start, window.end]), np.full(2, mean), "median")
    scale = Markup(' data-from="{:.6g}" data-to="{:.6g}" data-left="{:g}" data-right="{:g}" data-width="{:g}"')
    return panel.svg(scale.format(*panel.x, LEFT, RIGHT, WIDTH))


def _branch(branch: Any) -> Markup:
    """A plate test: all samples, and the readings of its loading branch."""
    name = next(name for name in (branch.stress, "normal_force", "load") if name in branch.log.values)
    channel, values = LOGGED[branch.stress], branch.log.values
    sinkage, stress = (values["sinkage"] - branch.zero) * 1e3, (values[name] - branch.air) / channel.scale
    panel = Panel(
        f"{branch.test}: {branch.stress} over sinkage", ends(sinkage), ends(stress), "sinkage from contact [mm]",
        f"{branch.stress} [{channel.unit}]",
    )  # fmt: skip
    thin = slice(None, None, max(len(sinkage) // MOST_POINTS, 1))
    panel.line(sinkage[thin], stress[thin], "trace")
    for z, p in branch.readings:
        panel.mark(z * 1e3, p / channel.scale, "reading", f"{z * 1e3:.4g} mm: {p / channel.scale:.4g} {channel.unit}")
    return panel.svg()
