"""Numbers as text, with the precision that an interval supports and no more."""

import math
from collections.abc import Iterable

NOTHING = "–"
MINUS = "−"
THIN = "\u202f"


def resolution(low: float, high: float) -> float:
    """The power of ten that is one to ten per cent of an interval's width.

    >>> resolution(14.9, 37.2), resolution(0.64, 1.07), resolution(1477, 9999)
    (1.0, 0.01, 100.0)
    """
    width = abs(high - low)
    if not math.isfinite(width) or width == 0:
        return _significant(max(abs(low), abs(high)))
    return float(10.0 ** (math.floor(math.log10(width) + 1e-9) - 1))


def _significant(size: float, digits: int = 3) -> float:
    """The unit of the last of some significant digits."""
    if not math.isfinite(size) or size == 0:
        return 1.0
    return float(10.0 ** (math.floor(math.log10(size)) - digits + 1))


def rounded(value: float | None, step: float) -> str:
    """A value to a step that is a power of ten.

    >>> rounded(29.1834, 1.0), rounded(-0.078, 0.01), rounded(12345.6, 100.0)
    ('29', '−0.08', '12\u202f300')
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    places = max(0, -round(math.log10(step)))
    nearest = round(value / step) * step
    text = f"{abs(nearest):.{places}f}"
    negative = nearest < 0 and float(text) != 0
    return (MINUS if negative else "") + _grouped(text)


def _grouped(text: str) -> str:
    """Digits in threes, from five before the point on."""
    whole, point, rest = text.partition(".")
    return f"{int(whole):,}".replace(",", THIN) + point + rest if len(whole) > 4 else text


def interval(low: float, high: float, step: float | None = None) -> str:
    """An interval to its own resolution.

    >>> interval(14.93, 37.21), interval(-0.331, 0.467)
    ('15–37', '−0.33 to 0.47')
    """
    step = resolution(low, high) if step is None else step
    ends = rounded(low, step), rounded(high, step)
    if NOTHING in ends:
        return NOTHING
    return " to ".join(ends) if low < 0 else "–".join(ends)


def estimate(middle: float, low: float, high: float) -> tuple[str, str]:
    """A value and its interval, both to the resolution of the latter.

    >>> estimate(25.62, 14.93, 37.21)
    ('26', '15–37')
    """
    step = resolution(low, high)
    return rounded(middle, step), interval(low, high, step)


def plain(value: float | None, digits: int = 3) -> str:
    """A value to some significant digits.

    >>> plain(1.00027), plain(15741.3), plain(0.0123456)
    ('1.00', '15\u202f700', '0.0123')
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    return rounded(value, _significant(abs(value), digits))


def number(value: float | None, places: int, *, least: float = -math.inf) -> str:
    """A value to some decimals, ``least`` where it is below that.

    >>> number(-0.123, 2), number(-0.1, 1, least=0.0), number(float("nan"), 2)
    ('−0.12', '0.0', '–')
    """
    if value is None or not math.isfinite(value):
        return NOTHING
    return rounded(max(value, least), 10.0**-places)


def signed(value: float, places: int = 2) -> str:
    """A value with its sign, such as a correlation or a shift.

    >>> signed(0.5), signed(-0.123), signed(-1.26, 1)
    ('+0.50', '−0.12', '−1.3')
    """
    return f"{value:+.{places}f}".replace("-", MINUS) if math.isfinite(value) else NOTHING


def moments(mean: float, sd: float) -> tuple[str, str]:
    """A mean and a standard deviation, both to the second digit of the latter.

    >>> moments(0.00538, 0.517)
    ('0.01', '0.52')
    """
    if not math.isfinite(sd):
        return plain(mean), NOTHING
    step = _significant(sd, 2)
    return rounded(mean, step), rounded(sd, step)


def given(value: float) -> str:
    """A number that a person gave, with all its digits.

    >>> given(157.35), given(0.0), given(-1.0)
    ('157.35', '0', '−1')
    """
    text = f"{abs(value):.7g}"
    return (MINUS if value < 0 else "") + (text if "e" in text else _grouped(text))


def column(values: Iterable[float], digits: int = 5) -> list[str]:
    """Given numbers with as many decimals as the longest of them; NaN where there is none.

    >>> column([5.0, 7.5, float("nan")])
    ['5.0', '7.5', '–']
    """
    values = list(values)
    tails = (f"{value:.{digits}g}".partition(".")[2] for value in values if math.isfinite(value))
    step = 10.0 ** -max((len(tail) for tail in tails if "e" not in tail), default=0)
    return [rounded(value, step) for value in values]


def probability(p: float) -> str:
    """A p value.

    >>> probability(0.0004), probability(0.837), probability(0.9987)
    ('< 0.01', '0.84', '> 0.99')
    """
    if not math.isfinite(p):
        return NOTHING
    return "< 0.01" if p < 0.01 else "> 0.99" if p > 0.99 else f"{p:.2f}"


def share(level: float | None) -> str:
    """A share of draws in percent; only exact ends are called 0 and 100.

    >>> share(0.9964), share(0.99999), share(1.0), share(0.0)
    ('99.6 %', '> 99.9 %', '100 %', '0 %')
    """
    if level is None or not math.isfinite(level):
        return NOTHING
    if level in (0.0, 1.0):
        return f"{100 * level:.0f} %"
    if level > 0.999 or level < 0.001:
        return "> 99.9 %" if level > 0.5 else "< 0.1 %"
    return f"{100 * level:.1f} %" if level > 0.99 or level < 0.1 else f"{100 * level:.0f} %"


def with_error(value: float, error: float) -> tuple[str, str]:
    """A value and its standard error, to a hundredth at the finest."""
    step = resolution(0.0, error) if error > 0 else 0.01
    step = max(step, 0.01)
    return rounded(value, step), rounded(max(error, step), step)
