"""The exceptions of the package. Their text is one line, written for the person who made the input."""

LONGEST = 1500
"""Characters, at most, of a message."""


def printable(text: str) -> str:
    """A text in one line that can do nothing to a terminal: characters that do not show are spelled out."""
    if text.isprintable():
        return text
    line = " ".join(text.split())
    return "".join(one if one.isprintable() else ascii(one)[1:-1] for one in line)


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
