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


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """``" (did you mean 'slip'?)"`` where a known name is close, else the list of known names."""
    known = list(known)
    close = get_close_matches(name, known, n=1, cutoff=0.6)
    return f" (did you mean '{close[0]}'?)" if close else f" (known: {', '.join(known)})"
