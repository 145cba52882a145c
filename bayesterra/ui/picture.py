"""Pictures of studies: readings over slip, laws of priors, and what the prior predicts of the rows."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from markupsafe import Markup

from bayesterra.analysis.result import PriorResult
from bayesterra.arrays import FloatArray
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.report.numbers import given
from bayesterra.stats.laws import Law
from bayesterra.study.noise import Noise
from bayesterra.study.observations import Observations
from bayesterra.study.priors import Entry
from bayesterra.study.soil_tests import LEVELS, PATHS, STRESSES, SoilTest
from bayesterra.study.study import Study
from bayesterra.ui.drawing import Panel, ends

SHADES = 6
"""Looks by which wheels are told apart."""
POINTS = 121
MOST_MARKS = 1000
"""Readings of a series of soil tests that are drawn, evenly spaced."""
TAIL = 0.001


def _panel(study: Study, name: str, more: Iterable[FloatArray] = ()) -> Panel:
    rows, channel = study.observations, CHANNELS[name]
    values = rows.values[name] / channel.scale
    sd = _sd(study.noise.get(name), rows, name) / channel.scale
    return Panel(
        f"{channel.description} over slip: {int(np.isfinite(values).sum())} readings", ends(rows.slip),
        ends(values - np.nan_to_num(sd), values + np.nan_to_num(sd), *more), "slip", _axis(name),
    )  # fmt: skip


def with_readings(panel: Panel, study: Study, name: str, faint: Mapping[int, bool] | None = None) -> None:
    """Draw the readings of a channel into a panel; ``faint``: rows that stand back."""
    rows, channel, wheels = study.observations, CHANNELS[name], list(study.wheels)
    sd = _sd(study.noise.get(name), rows, name) / channel.scale
    for i, value in enumerate(rows.values[name] / channel.scale):
        used = rows.use[i] and not (faint or {}).get(i, False)
        look = f"reading shade{wheels.index(rows.wheel[i]) % SHADES} {'' if used else 'idle'}"
        where = f"row {rows.rows[i]}, {rows.wheel[i]}: {rows.marks(name)[i]}{value:.4g} {channel.unit}"
        title = f"{where} at slip {rows.slip[i]:.3g}{'' if rows.use[i] else ', not in the fit'}"
        panel.mark(float(rows.slip[i]), float(value), look, title, float(sd[i]))


def _axis(name: str) -> str:
    channel = CHANNELS[name]
    return f"{channel.description} [{channel.unit}]"


def _sd(noise: Noise | None, rows: Observations, name: str) -> FloatArray:
    """Standard deviation (m,) of readings where it is stated; else NaN."""
    given = rows.given_sd.get(name, np.full(len(rows), np.nan))
    if noise is None or noise.law is not None:
        return given
    scale: FloatArray = np.broadcast_to(noise.scale(np.abs(rows.values[name])[None, :], None, given), (1, len(rows)))[0]
    return scale


def looks(study: Study) -> list[tuple[str, str]]:
    """What the looks of readings mean: wheels, and plates or stresses of soil tests, where there are several."""
    named = [list(study.wheels), *(_level_names(test) for test in study.soil_tests.values())]
    return [(name, f"shade{i % SHADES}") for names in named if len(names) > 1 for i, name in enumerate(names)]


def _level_names(test: SoilTest) -> list[str]:
    """What sets the tests of a series apart, in field units."""
    channel = LEVELS[test.kind]
    levels = np.unique(test.readings.level) / channel.scale
    return [f"{test.name}: {channel.description} {given(float(f'{level:.4g}'))} {channel.unit}" for level in levels]


def _soil_test_panel(test: SoilTest) -> Panel:
    """Readings of a series of soil tests: the answer of the soil over the way into it, or along it."""
    found, path, stress = test.readings, PATHS[test.kind], STRESSES[test.kind]
    across, up = found.path / path.scale, found.stress / stress.scale
    panel = Panel(
        f"{stress.description} over {path.description}: {len(up)} readings of {len(found.tests)} tests {test.name}",
        ends(across), ends(up), f"{test.name}: {path.description} [{path.unit}]",
        f"{stress.description} [{stress.unit}]",
    )  # fmt: skip
    levels = np.unique(found.level)
    for i in range(0, len(up), 1 + len(up) // MOST_MARKS):
        look = f"reading shade{int(np.searchsorted(levels, found.level[i])) % SHADES}"
        title = f"{found.tests[found.test[i]]}: {up[i]:.4g} {stress.unit} at {across[i]:.4g} {path.unit}"
        panel.mark(float(across[i]), float(up[i]), look, title)
    return panel


def study_panels(study: Study) -> list[Markup]:
    """Readings over slip, a panel for every measured channel; then those of soil tests, a panel for every series."""
    driven = []
    for name in study.noise:
        panel = _panel(study, name)
        with_readings(panel, study, name)
        driven.append(panel.svg())
    return [*driven, *(_soil_test_panel(test).svg() for test in study.soil_tests.values())]


def prior_panels(prior: PriorResult) -> list[Markup]:
    """What the prior predicts of the readings, before any of them counts: median and 90 % beside the readings."""
    study, table, panels = prior.study, prior.predictive, []
    for name in study.noise:
        own = table[table["channel"] == name]
        slip, low, middle, high = (own[column].to_numpy(float) for column in ("slip", "q05", "q50", "q95"))
        panel = _panel(study, name, (low, high))
        width = (panel.x[1] - panel.x[0]) / 90
        for at, *values in zip(slip, low, middle, high, strict=True):
            across = np.array([at - width, at + width])
            panel.band(across, np.full(2, values[0]), np.full(2, values[2]), "band90")
            panel.line(across, np.full(2, values[1]), "median")
        with_readings(panel, study, name)
        panels.append(panel.svg())
    return panels


def law_picture(name: str, entry: Entry) -> Markup:
    """Density of a prior law as a small picture; nothing for a value or a tie."""
    if not isinstance(entry, Law):
        return Markup("")
    scale = PARAMETERS[name].scale
    tails = entry.quantile(np.array([TAIL, 1 - TAIL]))
    low, high = (end if np.isfinite(end) else tail for end, tail in zip(entry.range, tails, strict=True))
    x = np.linspace(low, high, POINTS)
    density = np.exp(entry.log_density(x))
    density = np.where(np.isfinite(density), density, 0.0)
    shown = density / (density.max() or 1.0)
    words = f"prior of {PARAMETERS[name].description}, 90 % in {_range(entry, scale)} {PARAMETERS[name].unit}"
    panel = Panel(words, (float(x[0]) / scale, float(x[-1]) / scale), (0.0, 1.08), width=200.0, height=66.0)
    return _small(panel, x / scale, shown)


def _range(law: Law, scale: float) -> str:
    low, high = (float(value) / scale for value in law.quantile(np.array([0.05, 0.95])))
    return f"{_end(low)} to {_end(high)}"


def _end(value: float) -> str:
    """An end of a range, to three digits."""
    return given(float(f"{value:.3g}"))


def _small(panel: Panel, x: FloatArray, y: FloatArray) -> Markup:
    """A density over its axis with both ends named."""
    base, top = 48.0, 6.0
    across = 4 + (x - x[0]) / (x[-1] - x[0]) * (panel.width - 8)
    heights = base - y * (base - top)
    points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(across, heights, strict=True))
    return Markup(
        '<svg class="law" viewBox="0 0 {w:g} {h:g}" role="img" aria-label="{alt}">'
        '<polygon class="density" points="4,{base} {points} {end:g},{base}"/>'
        '<text class="tick" x="2" y="{h:g}" dy="-3">{low}</text>'
        '<text class="tick end" x="{w:g}" y="{h:g}" dx="-2" dy="-3">{high}</text></svg>'
    ).format(
        w=panel.width, h=panel.height, alt=panel.alt, base=base, points=points, end=panel.width - 4, low=_end(x[0]),
        high=_end(x[-1]),
    )  # fmt: skip
