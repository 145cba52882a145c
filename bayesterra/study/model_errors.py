"""Errors that hang readings together, as a study states them: [discrepancy], [ripple] and [slip].

A reading is y = f(θ, s) + δ(s) + ripple + noise: δ is the smooth error of the model over slip, one curve per
wheel and channel; ripple belongs to the rows of one sweep; and the slip s of a row may be read in error.
All are Gaussian. Here are their sizes and shapes; :mod:`bayesterra.likelihood.correlated` makes a likelihood
of them.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, TypeVar

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, check_keys, did_you_mean
from bayesterra.parameters import CHANNELS, DISCREPANCY_PREFIX, OUTCOMES, RIPPLE_PREFIX, SLIP_ERROR
from bayesterra.stats.laws import Law
from bayesterra.study.entries import law, table
from bayesterra.study.units import quantity

KERNELS = ("smooth", "matern52")
"""Shapes of the correlation of a discrepancy over slip: squared exponential, or Matérn with ν = 5/2."""


@dataclass(frozen=True)
class Size:
    """A standard deviation, SI: given, or unknown with a prior law; exactly one of the two."""

    sd: float | None = None
    law: Law | None = None

    def checked(self, where: str) -> "Size":
        """The same; StudyError, naming ``where``, unless it is above 0."""
        if self.sd is not None and not (self.sd > 0 and np.isfinite(self.sd)):
            raise StudyError(f"{where} 'sd' must be above 0 (got {self.sd:g})")
        if self.law is not None and not self.law.range[0] >= 0:
            raise StudyError(f"{where} an estimated 'sd' needs a law of numbers from 0 on, e.g. halfnorm")
        return self


@dataclass(frozen=True)
class Discrepancy:
    """Error of the model in one channel: a Gaussian process over slip, one curve per wheel.

    Attributes
    ----------
    channel : name of the outcome.
    size : standard deviation of the curve at any slip.
    length : slip over which the curve changes its course.
    kernel : one of ``KERNELS``.
    """

    channel: str
    size: Size
    length: float
    kernel: str = "smooth"

    @property
    def parameter(self) -> str | None:
        """Name of the estimated standard deviation; None where it is given."""
        return DISCREPANCY_PREFIX + self.channel if self.size.law is not None else None

    def correlation(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Correlation (p, q) of the curve at slips (p,) and (q,).

        Rasmussen and Williams 2006, Gaussian Processes for Machine Learning, (4.9) and (4.17).
        """
        distance = np.abs(first[:, None] - second) / self.length
        if self.kernel == "smooth":
            return np.asarray(np.exp(-0.5 * distance**2))
        scaled = np.sqrt(5.0) * distance
        return np.asarray((1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled))


@dataclass(frozen=True)
class Ripple:
    """Noise of one channel that hangs together along a sweep, exp(−d/memory) cos(2π d/period) at d rows.

    Attributes
    ----------
    channel : name of the outcome.
    size : standard deviation.
    memory : rows over which the correlation falls to 1/e.
    period : rows from crest to crest; infinite where nothing repeats.
    """

    channel: str
    size: Size
    memory: float
    period: float = np.inf

    @property
    def parameter(self) -> str | None:
        """Name of the estimated standard deviation; None where it is given."""
        return RIPPLE_PREFIX + self.channel if self.size.law is not None else None

    def correlation(self, first: FloatArray, second: FloatArray) -> FloatArray:
        """Correlation (p, q) between rows number (p,) and (q,) of one sweep."""
        distance = np.abs(first[:, None] - second)
        return np.asarray(np.exp(-distance / self.memory) * np.cos(2 * np.pi * distance / self.period))


@dataclass(frozen=True)
class SlipError:
    """Error of the slip readings on the shearing radius, from row to row on its own."""

    size: Size

    @property
    def parameter(self) -> str | None:
        """Name of the estimated standard deviation; None where it is given."""
        return SLIP_ERROR if self.size.law is not None else None


@dataclass(frozen=True)
class ModelErrors:
    """All three; without any of them rows are independent of each other given the parameters."""

    discrepancy: Mapping[str, Discrepancy] = field(default_factory=dict)  # by channel
    ripple: Mapping[str, Ripple] = field(default_factory=dict)  # by channel
    slip: SlipError | None = None  # None where slips are exact

    def __bool__(self) -> bool:
        return bool(self.discrepancy or self.ripple or self.slip)

    @property
    def fields(self) -> tuple[Discrepancy | Ripple, ...]:
        """Discrepancies and ripples, which tie rows."""
        parts: tuple[Mapping[str, Discrepancy | Ripple], ...] = (self.discrepancy, self.ripple)
        return tuple(part[name] for part in parts for name in OUTCOMES if name in part)

    def __iter__(self) -> Iterator[Discrepancy | Ripple | SlipError]:
        """The errors one after the other, in the order in which posteriors hold their sizes."""
        yield from self.fields
        if self.slip is not None:
            yield self.slip

    @property
    def laws(self) -> dict[str, Law]:
        """Prior laws of the estimated sizes by parameter."""
        return {error.parameter: error.size.law for error in self if error.parameter and error.size.law}

    def of(self, channels: tuple[str, ...]) -> "ModelErrors":
        """The errors of some channels only."""
        curves = {name: curve for name, curve in self.discrepancy.items() if name in channels}
        ripples = {name: ripple for name, ripple in self.ripple.items() if name in channels}
        return ModelErrors(curves, ripples, self.slip)


Entry = TypeVar("Entry", Discrepancy, Ripple)


def check_groups(errors: ModelErrors, by: str) -> None:
    """StudyError where groups of rows by a column would cut through what hangs together."""
    if errors.discrepancy and by != "wheel":
        raise StudyError(f"[discrepancy] is one curve per wheel: [pooling] must be by wheel (got '{by}')")
    if errors.ripple and by == "site":
        raise StudyError("[ripple] runs along a sweep: [pooling] must be by wheel or run (got 'site')")


def discrepancies(value: object, *, bare: bool) -> dict[str, Discrepancy]:
    """Read the [discrepancy] table; StudyError for an unknown channel or key, or a number that cannot be."""
    return _by_channel(value, "discrepancy", _discrepancy, Discrepancy, bare=bare)


def ripples(value: object, *, bare: bool) -> dict[str, Ripple]:
    """Read the [ripple] table; errors as in :func:`discrepancies`."""
    return _by_channel(value, "ripple", _ripple, Ripple, bare=bare)


def slip_error(value: object, *, bare: bool) -> SlipError | None:
    """Read the [slip] table; None where there is none, or nothing in it."""
    if value is None or isinstance(value, SlipError):
        return value
    content = table(value, "slip")
    if not content:
        return None
    check_keys(content, ("sd",))
    return SlipError(_size(content, "", "'slip'", bare=bare))


def _by_channel(
    value: object, name: str, read: Callable[..., Entry], kind: type[Entry], *, bare: bool
) -> dict[str, Entry]:
    errors = {}
    for channel, item in table(value, name).items():
        if channel not in OUTCOMES:
            reason = "is never an outcome" if channel in CHANNELS else "is unknown"
            raise StudyError(f"channel '{channel}' {reason}{did_you_mean(channel, OUTCOMES)}")
        errors[channel] = item if isinstance(item, kind) else read(channel, table(item, channel), bare=bare)
    return errors


def _discrepancy(channel: str, content: dict[str, Any], *, bare: bool) -> Discrepancy:
    check_keys(content, ("sd", "length", "kernel"), f"'{channel}': ")
    size = _size(content, CHANNELS[channel].dimension, f"'{channel}'", bare=bare)
    length = _number(content, "length", channel, "slip", "the slip over which the error changes, e.g. 0.3")
    kernel = content.get("kernel", KERNELS[0])
    if kernel not in KERNELS:
        raise StudyError(f"'{channel}.kernel' must be one of {', '.join(KERNELS)} (got {kernel!r})")
    return Discrepancy(channel, size, length, str(kernel))


def _ripple(channel: str, content: dict[str, Any], *, bare: bool) -> Ripple:
    check_keys(content, ("sd", "memory", "period"), f"'{channel}': ")
    size = _size(content, CHANNELS[channel].dimension, f"'{channel}'", bare=bare)
    meaning = "the number of rows that hang together, e.g. 3"
    memory = _number(content, "memory", channel, "number of rows", meaning)
    period = quantity(content["period"], "", f"{channel}.period") if "period" in content else np.inf
    if not period >= 2:
        raise StudyError(f"'{channel}.period' must be 2 rows or more (got {period:g})")
    return Ripple(channel, size, memory, period)


def _number(content: Mapping[str, Any], key: str, channel: str, kind: str, meaning: str) -> float:
    if key not in content:
        raise StudyError(f"'{channel}' needs a '{key}', {meaning}")
    number = quantity(content[key], "", f"{channel}.{key}")
    if not 0 < number < np.inf:
        raise StudyError(f"'{channel}.{key}' must be a {kind} above 0 (got {number:g})")
    return number


def _size(content: Mapping[str, Any], dimension: str, where: str, *, bare: bool) -> Size:
    """A size: a quantity, ``{ estimate = { dist = ... } }``, or a :class:`Law`."""
    if "sd" not in content:
        unit = f" {dimension}" if dimension else ""
        raise StudyError(f"{where} needs an 'sd', e.g. \"0.02{unit}\" or {{ estimate = {{ dist = ... }} }}")
    value, name = content["sd"], f"{where.strip(chr(39))}.sd"
    if isinstance(value, Law):
        return Size(law=value).checked(where)
    if not isinstance(value, Mapping):
        return Size(sd=quantity(value, dimension, name, bare=bare)).checked(where)
    if set(value) != {"estimate"}:
        raise StudyError(f"{where} 'sd' must be a value or {{ estimate = {{ dist = ... }} }} (got {value!r})")
    estimate = value["estimate"]
    if not isinstance(estimate, Law):
        estimate = law(f"{name}.estimate", table(estimate, f"{name}.estimate"), dimension, bare=bare)
    return Size(law=estimate).checked(where)
