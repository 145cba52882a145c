"""What if: the draws of a result under another slip, load, wheel and slope, as fast as a slider moves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import cos, radians, sin

import numpy as np
from markupsafe import Markup

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError
from bayesterra.models import Wheel
from bayesterra.parameters import CHANNELS
from bayesterra.prediction.prediction import PREDICTED, Condition, answers, quantiles, spread
from bayesterra.study.drive import Drive
from bayesterra.study.result import Result
from bayesterra.study.study import Study, without_wheels
from bayesterra.study.wheels import chosen_wheel, measured_loads
from bayesterra.ui.drawing import Panel, ends
from bayesterra.ui.picture import with_readings

DRAWS = 1000
CURVE = np.array([0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8])
MOST_SLIP, STEEPEST, ALIKE = 0.8, 30.0, 0.05
"""Ends of the sliders; share of the load by which readings of another load stand back."""
Scales = dict[str, tuple[float, float]]
CALLED = {"sinkage": "sinkage", "drawbar_pull": "pull", "resistance_moment": "moment"}


@dataclass(frozen=True)
class Setting:
    """Where the sliders stand: slip, load of the wheel on the flat (N), its name, and slope (degrees)."""

    slip: float
    load: float
    wheel: str
    slope: float = 0.0

    @property
    def normal(self) -> float:
        """Load across the slope, N."""
        return self.load * cos(radians(self.slope))

    @property
    def carried(self) -> float:
        """Load across the slope to six digits, by which answers are kept."""
        return float(f"{self.normal:.6g}")

    @property
    def downhill(self) -> float:
        """Part of the load along the slope, N, which the pull has to hold."""
        return self.load * sin(radians(self.slope))


@dataclass(frozen=True)
class Answer:
    """Bands over slip, and what holds at the slip of the slider."""

    panels: tuple[Markup, ...]
    rows: tuple[tuple[str, str, str], ...]
    holds: str
    notes: tuple[str, ...]


class WhatIf:
    """Draws of a result, held ready."""

    def __init__(self, name: str, result: Result) -> None:
        without_wheels(result.study, "what if")
        self.name, self.study = name, result.study
        self._result = result
        self._curves = lru_cache(64)(self._curve)
        self._at = lru_cache(256)(self._quantiles)
        self._draws = lru_cache(64)(self._soils)

    @property
    def wheels(self) -> tuple[str, ...]:
        """Names of the study's wheels."""
        return tuple(self.study.wheels)

    @property
    def loads(self) -> tuple[float, float]:
        """Ends of the slider of the load, N: from a fifth of the lowest to twice the highest that was measured."""
        low, high = measured_loads(self.study) or (10.0, 100.0)
        return float(f"{0.2 * low:.2g}"), float(f"{2 * high:.2g}")

    def start(self) -> Setting:
        """Middle of what was driven."""
        rows = self.study.observations.used()
        loads = measured_loads(self.study) or (50.0, 50.0)
        slip = float(np.median(rows.slip)) if len(rows) else 0.3
        return Setting(round(min(max(slip, 0.0), MOST_SLIP), 2), float(f"{np.mean(loads):.3g}"), self.wheels[0])

    def checked(self, form: Mapping[str, str]) -> Setting:
        """Setting of a form, held between the ends of the sliders."""
        start, (low, high) = self.start(), self.loads
        wheel = form.get("wheel", start.wheel)
        return Setting(
            slip=_between(form.get("slip"), 0.0, MOST_SLIP, start.slip),
            load=_between(form.get("load"), low, high, start.load),
            wheel=wheel if wheel in self.study.wheels else start.wheel,
            slope=_between(form.get("slope"), 0.0, STEEPEST, 0.0),
        )  # fmt: skip

    def _soils(self, wheel: str) -> tuple[Study, Wheel, FloatArray]:
        called, driven = chosen_wheel(self.study, wheel)
        result = self._result.of_group(None, wheel=called, seed=1)
        draws, _ = spread(result, DRAWS)
        return result.study, driven, result.study.prior.soil_values(draws)

    def _modelled(self, wheel: str, slips: tuple[float, ...], load: float) -> tuple[FloatArray, FloatArray]:
        """Outcomes (n, k, 3) at slips, SI, and the share (k,) of the draws without an answer."""
        study, driven, soil = self._draws(wheel)
        _, outcomes, reasons = answers(study, driven, np.array(slips), load, soil)
        return outcomes.of(Drive.LOAD.outcomes), np.asarray((reasons != 0).mean(axis=0))

    def _curve(self, wheel: str, load: float) -> tuple[FloatArray, FloatArray]:
        values, unanswered = self._modelled(wheel, tuple(CURVE.tolist()), load)
        return quantiles(values), unanswered

    def _quantiles(self, wheel: str, load: float, slip: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        values, unanswered = self._modelled(wheel, (slip,), load)
        return quantiles(values[:, 0]), unanswered, values[:, 0]

    def scales(self, setting: Setting) -> Scales:
        """Ends of the axis of every panel at a setting, so that results side by side may share theirs."""
        curves, _ = self._curves(setting.wheel, setting.carried)
        own = np.array([wheel == setting.wheel for wheel in self.study.observations.wheel], dtype=bool)
        return {
            name: ends(*(curves[[1, 3], :, i] / PREDICTED[name].scale), self._measured(name)[own], [0.0])
            for i, name in enumerate(Drive.LOAD.outcomes)
        }

    def _measured(self, name: str) -> FloatArray:
        """Readings of a channel in its field unit, NaN where there is none."""
        rows = self.study.observations
        return np.asarray(rows.values.get(name, np.full(len(rows), np.nan)) / PREDICTED[name].scale)

    def answer(self, setting: Setting, scales: Scales | None = None) -> Answer:
        """Bands and figures at a setting; ``scales``: ends of the axes, by default its own."""
        scales = scales or self.scales(setting)
        curves, _ = self._curves(setting.wheel, setting.carried)
        at, unanswered, values = self._at(setting.wheel, setting.carried, setting.slip)
        names = list(Drive.LOAD.outcomes)
        driven = self.study.observations.used().slip
        span = (float(driven.min()), float(driven.max())) if len(driven) else (0.0, 0.0)
        panels = tuple(self._panel(name, curves[:, :, i], setting, span, scales[name]) for i, name in enumerate(names))
        rows = tuple(
            (
                CALLED[name],
                rounded_in(name, at[2, i]),
                f"{rounded_in(name, at[0, i])} to {rounded_in(name, at[4, i])} {CHANNELS[name].unit}",
            )
            for i, name in enumerate(names)
        )
        pull = values[:, names.index("drawbar_pull")]
        chance = Condition("", "drawbar_pull", True, setting.downhill).share(pull)
        holds = f"{100 * chance:.0f} %"
        return Answer(panels, rows, holds, tuple(self._notes(setting, span, float(unanswered[0]))))

    def _panel(
        self, name: str, curve: FloatArray, setting: Setting, span: tuple[float, float], y: tuple[float, float]
    ) -> Markup:
        channel, rows = PREDICTED[name], self.study.observations
        field = curve / channel.scale
        own = np.array([wheel == setting.wheel for wheel in rows.wheel], dtype=bool)
        panel = Panel(
            f"{channel.description} over slip, bands of 50 and 90 % of the draws",
            (0.0, MOST_SLIP),
            y,
            "slip",
            f"{CALLED[name]} [{channel.unit}]",
        )
        panel.shade(0.0, span[0], "beyond")
        panel.shade(span[1], MOST_SLIP, "beyond")
        panel.band(CURVE, field[0], field[4], "band90")
        panel.band(CURVE, field[1], field[3], "band50")
        panel.line(CURVE, field[2], "median")
        if name == "drawbar_pull" and setting.slope > 0:
            panel.level(setting.downhill / channel.scale, "needed")
        panel.upright(setting.slip, "asked")
        if name in rows.values:
            carried = rows.known_loads
            other = np.abs(carried - setting.load) > ALIKE * setting.load
            faint = {i: bool(other[i] or not own[i]) for i in range(len(rows))}
            with_readings(panel, self.study, name, faint)
        return panel.svg()

    def _notes(self, setting: Setting, span: tuple[float, float], unanswered: float) -> list[str]:
        notes = []
        if not span[0] <= setting.slip <= span[1]:
            notes.append(
                f"slip {setting.slip:g} lies outside the driven slips, {span[0]:.3g} to {span[1]:.3g}: extrapolated"
            )
        measured = measured_loads(self.study)
        if measured and not 0.999 * measured[0] <= setting.normal <= 1.001 * measured[1]:
            named = " to ".join(dict.fromkeys(f"{end:.4g}" for end in measured))
            notes.append(f"load {setting.normal:.4g} N is not among the measured loads, {named} N: extrapolated")
        if self.study.errors.discrepancy:
            notes.append(
                "the error of the model that the study states is not in these bands: 'bayesterra predict' adds it"
            )
        if unanswered > 0:
            notes.append(f"{100 * unanswered:.0f} % of the draws have no answer there")
        return notes


def widest(scales: Sequence[Scales]) -> Scales:
    """Ends that hold those of every result."""
    return {name: (min(each[name][0] for each in scales), max(each[name][1] for each in scales)) for name in scales[0]}


def rounded_in(channel: str, value: float) -> str:
    """SI value in the field unit of a channel, to three digits."""
    return f"{value / CHANNELS[channel].scale:.3g}" if np.isfinite(value) else "–"


def _between(typed: str | None, low: float, high: float, otherwise: float) -> float:
    try:
        value = float(typed) if typed else otherwise
    except ValueError as error:
        raise StudyError(f"a slider must give a number (got {typed!r:.40})") from error
    return min(max(value, low), high) if np.isfinite(value) else otherwise
