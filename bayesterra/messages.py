"""Helpers that make error messages help: where the mistake is, and what may have been meant."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from difflib import get_close_matches

from bayesterra.errors import StudyError


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


LONGEST = 500
"""Characters, at most, of a message."""


def printable(text: str) -> str:
    """A text in one line that can do nothing to a terminal: characters that do not show are spelled out."""
    line = " ".join(text.split())
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in line)


def in_short(text: str, most: int = LONGEST) -> str:
    """The text, or its two ends where it is long."""
    half = most // 2
    return text if len(text) <= most else f"{text[:half]} [...] {text[-half:]}"


def suggestion(name: str, known: Iterable[str]) -> str:
    """``" (did you mean 'slip'?)"`` where a known name is close, else nothing."""
    by_lower = {word.lower(): word for word in known}
    close = get_close_matches(name.lower(), by_lower, n=1, cutoff=0.7)
    return f" (did you mean '{by_lower[close[0]]}'?)" if close else ""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """The suggestion, or the list of known names where none is close."""
    known = list(known)
    return suggestion(name, known) or f" (known: {', '.join(known)})"
