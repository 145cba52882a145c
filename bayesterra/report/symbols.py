"""Names of quantities in HTML: symbols set as in the literature, units, lists of words."""

import re
from collections.abc import Iterable

from markupsafe import Markup, escape

from bayesterra.parameters import CHANNELS, DERIVED, EFFICIENCY, PARAMETERS, Channel, Parameter, whole_and_part

QUANTITIES: dict[str, Parameter | Channel] = {**CHANNELS, **PARAMETERS, **DERIVED, EFFICIENCY.name: EFFICIENCY}
PLAIN = {parameter.symbol: name for name, parameter in PARAMETERS.items()}
"""Parameters by their plain symbols."""
_PLAIN = re.compile(
    r"(?<![\w_])({})(?![\w_])".format("|".join(re.escape(s) for s in sorted(PLAIN, key=len, reverse=True)))
)


def quantity_of(name: str) -> Channel:
    """A parameter, also of a group or soil test, a channel or a derived quantity."""
    return QUANTITIES.get(name) or PARAMETERS[name]


def symbol(name: str) -> Markup:
    """The symbol of a parameter, channel or derived quantity.

    >>> symbol("Ks"), symbol("drawbar_pull"), symbol("K[Wh11]")
    (Markup('<i>K</i><sub>s</sub>'), Markup('<i>F</i><sub>DP</sub>'), Markup('<i>K</i>[Wh11]'))
    """
    name, part = whole_and_part(name)
    return _symbol(name) + part if part else _symbol(name)


def _symbol(name: str) -> Markup:
    if name in DERIVED:
        before, pull, after = DERIVED[name].symbol.partition("F_DP")
        return Markup("{}{}{}").format(before, letters(pull) if pull else "", after)
    return letters(quantity_of(name).symbol)


def letters(text: str) -> Markup:
    """A letter in italics with its subscript upright: ``K_s``, ``n0``, ``F_DP``, ``σ(z)``."""
    if inner := re.fullmatch(r"([σδρ])\((.*)\)", text):
        return Markup("<i>{}</i>({})").format(inner[1], letters(inner[2]))
    letter, subscript = text[0], text[1:].removeprefix("_")
    lowered = Markup("<sub>{}</sub>").format(subscript) if subscript else Markup("")
    return Markup("<i>{}</i>{}").format(letter, lowered)


def angles(text: str) -> Markup:
    """Text with the subscripts of its angles set.

    >>> angles("θm outside (θ2, θ1)")
    Markup('θ<sub>m</sub> outside (θ<sub>2</sub>, θ<sub>1</sub>)')
    """
    return Markup(re.sub(r"θ([m12])", r"θ<sub>\1</sub>", str(escape(text))))  # noqa: S704 (escaped before)


def unit(name: str) -> Markup:
    """The field unit, empty for pure numbers."""
    return raised(quantity_of(whole_and_part(name)[0]).unit)


def raised(unit: str) -> Markup:
    """A unit with its exponent raised, empty for pure numbers.

    >>> raised("kPa/m^n")
    Markup('kPa/m<sup>n</sup>')
    """
    if unit == "-":
        return Markup("")
    before, power, exponent = unit.partition("m^")
    return Markup("{}m<sup>{}</sup>").format(before, exponent) if power else Markup("{}").format(unit)


def with_unit(name: str) -> Markup:
    """Symbol and unit, for the head of a table."""
    text = unit(name)
    return Markup("{} [{}]").format(symbol(name), text) if text else symbol(name)


def amount(name: str, text: str) -> Markup:
    """A number with its unit, kept on one line."""
    return Markup("{}&nbsp;{}").format(text, unit(name)) if unit(name) else Markup("{}").format(text)


def listed(items: Iterable[str | Markup], last: str = "and") -> Markup:
    """Items as in a sentence: a, b and c."""
    texts = [Markup("{}").format(item) for item in items]
    if len(texts) < 2:
        return texts[0] if texts else Markup("")
    return Markup("{} {} {}").format(Markup(", ").join(texts[:-1]), last, texts[-1])


def symbols(names: Iterable[str], last: str = "and") -> Markup:
    """Symbols as in a sentence."""
    return listed((symbol(name) for name in names), last)


def in_symbols(text: str) -> Markup:
    """Text with the plain symbols in it set as in the literature; HTML as it is.

    >>> str(in_symbols("K_s − 0.4 n0 of σ(z)"))
    '<i>K</i><sub>s</sub> − 0.4 <i>n</i><sub>0</sub> of <i>σ</i>(<i>z</i>)'
    """
    if isinstance(text, Markup):
        return text
    return Markup("").join(_set(part) for part in _PLAIN.split(text))


def _set(part: str) -> Markup:
    if part in PLAIN:
        return symbol(PLAIN[part])
    return Markup("m<sup>N</sup>").join(Markup("{}").format(piece) for piece in part.split("m^N"))
