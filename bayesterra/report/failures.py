"""Failures of what is computed from draws: recorded and said, and never at the cost of the draws."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

from bayesterra.errors import ResultError, in_short, printable

T = TypeVar("T")

PARTS: Mapping[str, str] = {
    "fits": "least squares",
    "mode": "posterior mode",
    "evidence": "log evidence",
    "posterior_predictive": "predictions of the rows",
    "prior_predictive": "predictions of the rows by the prior",
    "curves": "curves over slip",
    "standings": "standing of the point estimates",
    "identifiability": "verdicts on the parameters",
    "directions": "directions that the data determine",
    "predictive_checks": "predictive checks",
    "prior_checks": "prior-predictive checks",
    "loo": "leave-one-out cross-validation",
    "derived": "derived quantities",
    "crosscheck": "cross-check by nested sampling",
    "complete": "complete pooling",
    "degrees": "degrees of pooling",
    "sharing": "verdicts on sharing",
    "sharing_as_stated": "verdicts on sharing, others as stated",
    "log_likelihood": "log likelihood of every row",
    "left_out": "tests left out",
    "levels": "levels left out",
    "bands": "bands of the curves",
    "verdicts": "verdicts on the whole",
    "finding": "the finding in a sentence",
}
"""Names of the parts of a result in a sentence."""


@dataclass(frozen=True)
class Failure:
    """A part of a result that could not be computed.

    Attributes
    ----------
    part : an entry of a record, a key of :data:`PARTS`, or ``report: `` and a section of it.
    error, message : type and text of what was raised.
    trace : the calls that led there, outermost first: file, line and function.
    """

    part: str
    error: str
    message: str
    trace: tuple[str, ...]

    @classmethod
    def of(cls, part: str, error: Exception) -> Failure:
        """The failure that an exception stands for."""
        frames = traceback.extract_tb(error.__traceback__)[1:]
        # the last two parts of every path: a record holds no personal ones
        places = ("/".join(Path(frame.filename).parts[-2:]) for frame in frames)
        trace = tuple(f"{place}:{at.lineno} {at.name}" for place, at in zip(places, frames, strict=True))
        return cls(part, type(error).__name__, in_short(printable(str(error))), trace)

    @property
    def title(self) -> str:
        """Name of the part that could not be computed."""
        return PARTS.get(self.part, self.part)

    @property
    def sentence(self) -> str:
        """Sentence on what is missing and why, in one line."""
        why = f"{self.error}: {self.message}" if self.message else self.error
        return f"{self.title} could not be computed ({why.rstrip('.')})"


class Failures:
    """Parts that failed so far; ``watch`` is told what is tried."""

    def __init__(self, watch: Callable[[str], None] = lambda title: None) -> None:
        self._failures: dict[str, Failure] = {}
        self._watch = watch

    def attempt(self, part: str, compute: Callable[[], T], otherwise: Callable[[], T]) -> T:
        """Result of ``compute``; where it raises, that is noted as a failure, and ``otherwise`` is called.

        A lack of memory, a full disk, saved work that cannot be used and Ctrl-C are no failures of the part:
        they end the run, which can be resumed.
        """
        self._watch(PARTS.get(part, part))
        try:
            return compute()
        except (MemoryError, OSError, ResultError):
            raise
        except Exception as error:  # whatever it is, hours of sampling are not to be lost by it
            self._failures[part] = Failure.of(part, error)
            return otherwise()

    def __contains__(self, part: str) -> bool:
        return part in self._failures

    def __iter__(self) -> Iterator[Failure]:
        return iter(self._failures.values())

    def said(self, part: str) -> str:
        """Sentence on a part that failed; empty where it did not."""
        return f"{self._failures[part].sentence}." if part in self._failures else ""

    def record(self) -> dict[str, Any]:
        """The entry ``failures`` of a record; nothing where nothing failed."""
        kept = {part: {**asdict(failure), "trace": list(failure.trace)} for part, failure in self._failures.items()}
        return {"failures": kept} if kept else {}


def failures_of(record: Mapping[str, Any]) -> tuple[Failure, ...]:
    """Failures in a record; nothing for those of versions that ended there."""
    return tuple(
        Failure(str(part), str(entry["error"]), str(entry["message"]), tuple(map(str, entry["trace"])))
        for part, entry in record.get("failures", {}).items()
    )


REPORT = "report: "
"""Begins the name of what failed as a report was made; the rest is the heading of the section."""


def sentences(record: Mapping[str, Any]) -> str:
    """All that failed, in a few sentences; empty where nothing did."""
    texts = [failure.sentence for failure in failures_of(record)]
    return f"{'. '.join(texts)}. All else stands without it." if texts else ""


def failed(record: Mapping[str, Any], *names: str) -> str:
    """Sentence on the first of the parts that failed; empty where none did."""
    return next((f"{failure.sentence}." for failure in failures_of(record) if failure.part in names), "")


def with_failures(record: Mapping[str, Any], more: Failures) -> dict[str, Any]:
    """A record with further failures; those of an earlier report give way."""
    before = record.get("failures", {}).items()
    failures = {part: entry for part, entry in before if not part.startswith(REPORT)}
    failures |= more.record().get("failures", {})
    kept = {name: value for name, value in record.items() if name != "failures"}
    return {**kept, **({"failures": failures} if failures else {})}
