"""Exceptions of the package, and helpers that make their one-line messages help.

A message says where the mistake is, what was found, and what to do.
"""

import os
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from difflib import get_close_matches
from numbers import Integral, Real
from pathlib import Path

LONGEST = 1500
"""Characters, at most, of a message."""


def printable(text: str) -> str:
    """A text in one line that can do nothing to a terminal: characters that do not show are spelled out."""
    if text.isprintable():
        return text
    line = " ".join(text.split())
    return "".join(character if character.isprintable() else ascii(character)[1:-1] for character in line)


def in_short(text: str, most: int = LONGEST) -> str:
    """The text, or its two ends where it is long."""
    half = most // 2
    return text if len(text) <= most else f"{text[:half]} [...] {text[-half:]}"


class BayesterraError(Exception):
    """Base of everything that the package raises on purpose."""

    def __init__(self, text: str = "") -> None:
        super().__init__(printable(in_short(str(text))))


class StudyError(BayesterraError, ValueError):
    """A study file, a table of measurements or a prior that cannot be used as it stands."""


class ResultError(BayesterraError, ValueError):
    """A result folder that cannot be read or written."""


class EngineError(BayesterraError, RuntimeError):
    """Workers that cannot be reached, do not fit together, or die."""


class SupportError(BayesterraError, ValueError):
    """No parameter set that the prior allows can explain the conditions of the data."""


class _LocatedError(StudyError):
    """An error whose text already says where it was found."""


@contextmanager
def errors_in(place: object) -> Iterator[None]:
    """Begin the text of a :class:`StudyError` with the file it was found in; the innermost place wins."""
    try:
        yield
    except _LocatedError:
        raise
    except StudyError as error:
        raise _LocatedError(f"{place}: {error}") from error


@contextmanager
def errors_after(beginning: str) -> Iterator[None]:
    """Turn a ValueError into a :class:`StudyError` whose text has a beginning."""
    try:
        yield
    except ValueError as error:
        raise StudyError(f"{beginning}{error}") from error


def suggestion(name: str, names: Iterable[str]) -> str:
    """``" (did you mean 'slip'?)"`` where a known name is close, else nothing."""
    by_lower = {word.lower(): word for word in names}
    close = get_close_matches(name.lower(), by_lower, n=1, cutoff=0.7)
    return f" (did you mean '{by_lower[close[0]]}'?)" if close else ""


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """The suggestion, or the list of known names where none is close."""
    names = list(names)
    return suggestion(name, names) or f" (known: {', '.join(names)})"


def known(kind: str, name: str, names: Iterable[str], where: str = "") -> str:
    """The name, if it is one of those known; else StudyError, begun by ``where``, with the name that may be meant."""
    names = list(names)
    if name not in names:
        raise StudyError(f"{where}unknown {kind} '{name}'{did_you_mean(name, names)}")
    return name


def check_keys(content: Iterable[str], keys: Iterable[str], where: str = "") -> None:
    """Refuse a table with other keys than some; StudyError as :func:`known`."""
    keys = list(keys)
    for key in content:
        known("key", str(key), keys, where)


_KINDS = {
    "Study": ("a study", "bt.load_study"),
    "Result": ("a finished result", "bt.load_result"),
    "DataFrame": ("a pandas.DataFrame of readings", "pandas.read_csv"),
}
"""Names of the kinds of objects, and of the call that makes one."""


def check_kind(call: str, value: object, *kinds: type) -> None:
    """Refuse a value that a public function was called with and that is of none of some kinds.

    StudyError names the call, what it needs and what makes that, and what was got.
    """
    if isinstance(value, kinds):
        return
    named = [_KINDS[kind.__name__] for kind in kinds]
    wanted = " or ".join(what for what, _ in named)
    if isinstance(value, str | os.PathLike):
        loads = " or ".join(f"{maker}({os.fspath(value)!r})" for _, maker in named)
        raise StudyError(f"{call} needs {wanted}, not a path: load it first with {loads}")
    makers = " or ".join(maker for _, maker in named)
    raise StudyError(f"{call} needs {wanted}, as {makers} returns it (got {_shown(value)})")


def checked_path(call: str, value: object, what: str) -> Path:
    """The path that a public function was called with; StudyError where it is none."""
    if not isinstance(value, str | Path):
        raise StudyError(f"{call} needs the path of {what} (got {_shown(value)})")
    return Path(value)


def check_number(name: str, value: object) -> None:
    """Refuse what is no number, truth values too: True is no reading of 1. StudyError names the value."""
    if isinstance(value, bool) or not isinstance(value, Real):
        raise StudyError(f"'{name}' must be a number (got {value!r:.60})")


def check_seed(seed: object) -> None:
    """Refuse what is no seed; StudyError where it is no whole number, or negative."""
    if isinstance(seed, bool) or not isinstance(seed, Integral) or seed < 0:
        raise StudyError(f"'seed' must be a whole number from 0 (got {seed!r:.60})")


def _shown(value: object) -> str:
    return "None" if value is None else f"an object of type {type(value).__name__}"


LONGEST_NAME, LONGEST_TEXT = 100, 10_000
"""Characters, at most, of a name (of a wheel, a site, a test) and of a title or a source."""
_UNSEEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")


def checked_name(name: str, what: str) -> str:
    """The name as it is.

    StudyError where it is empty or too long, has spaces around it or a character that does not show.
    """
    if not name or name != name.strip():
        raise StudyError(f"{what} must not be empty nor have spaces around it (got {name!r:.60})")
    if len(name) > LONGEST_NAME:
        raise StudyError(f"{what} must have at most {LONGEST_NAME} characters (got {len(name)})")
    if not name.isprintable():
        raise StudyError(f"{what} must have no characters that do not show (got {name!a})")
    return name


def checked_text(text: str, what: str) -> str:
    """The text as it is: a title, or a source; it may have several lines.

    StudyError where it is too long, or has control characters.
    """
    if len(text) > LONGEST_TEXT:
        raise StudyError(f"'{what}' must have at most {LONGEST_TEXT} characters (got {len(text)})")
    if match := _UNSEEN.search(text):
        raise StudyError(f"'{what}' must have no control characters (got {match[0]!a})")
    return text


def enumerated(texts: Sequence[str]) -> str:
    """Texts as in a sentence.

    >>> enumerated(["a", "b", "c"])
    'a, b and c'
    """
    return " and ".join([", ".join(texts[:-1]), texts[-1]] if len(texts) > 1 else texts)


def counted(number: int, noun: str) -> str:
    """A number of things in words.

    >>> counted(1, "row"), counted(3, "row")
    ('1 row', '3 rows')
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"
