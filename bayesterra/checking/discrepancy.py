"""Discrepancy of the model over slip: its posterior, and which parameters it trades with."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.checking.validation import spread_draws
from bayesterra.likelihood.posterior import posterior
from bayesterra.parameters import SIZES
from bayesterra.study.result import Result

DRAWS = 1000
GRID = 41
LEVELS = (0.05, 0.25, 0.5, 0.75, 0.95)
NOTABLE = 0.5
"""Share of the variance of a level or tilt that goes with the parameters, from which it is said."""


@dataclass(frozen=True)
class Stretch:
    """Slips over which the 90 % band of a discrepancy leaves 0 to one side.

    Attributes
    ----------
    low, high : first and last of these slips.
    least, most : smallest and greatest median there, SI; negative where the model is too high.
    """

    low: float
    high: float
    least: float
    most: float


@dataclass(frozen=True)
class Trade:
    """A shape of a discrepancy that the parameters of the soil can take over.

    Attributes
    ----------
    shape : ``level``, the mean over the driven slips, or ``tilt``, the slope over them.
    share : of its posterior variance that goes with the parameters, by linear regression on them.
    parameter, correlation : the one that correlates most with it, and how much.
    """

    shape: str
    share: float
    parameter: str
    correlation: float


@dataclass(frozen=True)
class Missed:
    """The discrepancy of one channel of one wheel over the driven slips.

    Attributes
    ----------
    wheel, channel : of which.
    slip : (g,) grid over the driven slips.
    bands : quantiles ``LEVELS`` of the discrepancy (5, g), SI.
    rows : slips of the readings in the fit (r,).
    residuals : median of reading less model there (r,), SI; the model without its discrepancy.
    trades : shapes that the parameters can take over, the strongest first.
    """

    wheel: str
    channel: str
    slip: FloatArray
    bands: FloatArray
    rows: FloatArray
    residuals: FloatArray
    trades: tuple[Trade, ...]

    @property
    def stretches(self) -> tuple[Stretch, ...]:
        """Stretches of slip where the model is surely off, 90 % of the draws on one side."""
        side = np.where(self.bands[0] > 0, 1, np.where(self.bands[-1] < 0, -1, 0))
        stretches = []
        for sign, group in groupby(range(len(side)), key=lambda i: int(side[i])):
            places = list(group)
            if sign:
                middle = self.bands[2, places]
                ends = sorted((float(middle.min()), float(middle.max())), key=abs)
                stretches.append(Stretch(float(self.slip[places[0]]), float(self.slip[places[-1]]), *ends))
        return tuple(stretches)


def missed(result: Result) -> tuple[Missed, ...]:
    """The discrepancy of every wheel and channel that has one; nothing where the study states none."""
    if not result.study.errors.discrepancy:
        return ()
    return tuple(_found(result))


def _found(result: Result) -> Iterator[Missed]:
    target, draws = posterior(result.study), spread_draws(result, DRAWS)
    likelihood, rng = target.likelihood, np.random.default_rng(0)
    soil, noise = target.prior.soil_values(draws), target.noise_values(draws)
    plain = likelihood.predicted(likelihood.forward(soil))
    rows = likelihood.observations
    for wheel in dict.fromkeys(rows.wheel):
        mine: BoolArray = np.array([name == wheel for name in rows.wheel])
        slip = np.linspace(rows.slip[mine].min(), rows.slip[mine].max(), GRID)
        curves = likelihood.beyond(soil, noise, wheel, slip, rng)
        for channel in result.study.errors.discrepancy:
            column = likelihood.channels.index(channel)
            read = mine & ~np.isnan(likelihood.measured[:, column])
            off = likelihood.measured[read, column] - plain[:, read, column]
            curve = curves[:, :, column]
            yield Missed(
                wheel, channel, slip, np.quantile(curve, LEVELS, axis=0), rows.slip[read],
                np.median(off, axis=0), notable(trades(target.names, draws, slip, curve)),
            )  # fmt: skip


def trades(
    names: tuple[str, ...], draws: FloatArray, slip: FloatArray, curve: FloatArray
) -> tuple[Trade, ...]:
    """Shares of level and tilt of a curve (n, g) over slips (g,) that go with the parameters of draws (n, d).

    Sizes of errors are left out; nothing where no other parameter is free.
    """
    soil = [i for i, name in enumerate(names) if not name.startswith(SIZES)]
    if not soil:
        return ()
    x = (draws[:, soil] - draws[:, soil].mean(axis=0)) / draws[:, soil].std(axis=0)
    trade_offs = []
    for shape, values in (("level", curve.mean(axis=1)), ("tilt", curve @ (slip - slip.mean()))):
        y = values - values.mean()
        explained = x @ np.linalg.lstsq(x, y, rcond=None)[0]
        single = [float(np.corrcoef(column, y)[0, 1]) for column in x.T]
        most = int(np.abs(single).argmax())
        trade_offs.append(Trade(shape, float(explained.var() / y.var()), names[soil[most]], single[most]))
    return tuple(trade_offs)


def notable(trade_offs: tuple[Trade, ...]) -> tuple[Trade, ...]:
    """Those with a share of ``NOTABLE`` or more, the greatest first."""
    return tuple(sorted((trade for trade in trade_offs if trade.share >= NOTABLE), key=lambda t: -t.share))
