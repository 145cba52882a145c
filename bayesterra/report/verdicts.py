"""Verdicts: what may be said of a result, in a word, a grade and a sentence; made once, read everywhere.

And failures: what could not be computed from draws is recorded and said, and never costs the draws.
"""

import tomllib
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Required, TypeVar, overload

from markupsafe import Markup
from pydantic import ConfigDict
from typing_extensions import TypedDict

from bayesterra.errors import ResultError, enumerated, in_short, printable
from bayesterra.report.symbols import in_symbols
from bayesterra.runtime.reading import MEGABYTE, read_text

if TYPE_CHECKING:
    from bayesterra.report.blocks import Cell, Text

T = TypeVar("T")

PARTS: Mapping[str, str] = tomllib.loads(read_text(Path(__file__).with_name("parts.toml"), MEGABYTE))
"""Names of the parts of a result in a sentence."""


@dataclass(frozen=True)
class Failure:
    """A part of a result that could not be computed."""

    part: str  # an entry of a record, a key of ``PARTS``, or ``report: `` and a section of it
    error: str  # type of what was raised
    message: str  # its text
    trace: tuple[str, ...]  # the calls that led there, outermost first: file, line and function

    @classmethod
    def of(cls, part: str, error: Exception) -> "Failure":
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

    @overload
    def attempt(self, part: str, compute: Callable[[], T]) -> T | None: ...
    @overload
    def attempt(self, part: str, compute: Callable[[], T], otherwise: Callable[[], T]) -> T: ...
    def attempt(self, part: str, compute: Callable[[], Any], otherwise: Callable[[], Any] = lambda: None) -> Any:
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


SIGNS = {"good": "✓", "doubtful": "◐", "bad": "✕", "note": "–"}
"""Signs of grades without colour. A note is neither good nor bad: a finding, or what could not be tested."""
UNSEEN = "A second solution that no ensemble found would not show."
"""Limit of what convergence can say."""


@dataclass(frozen=True)
class Verdict:
    """One verdict."""

    name: str  # of what is judged
    word: str
    grade: str  # ``good``, ``doubtful``, ``bad`` or ``note``
    sentence: "Cell"
    claim: str = ""  # what it says, as a clause of a sentence on the whole result
    figures: Mapping[str, float] = field(default_factory=dict)  # numbers behind the word
    thresholds: Mapping[str, float] = field(default_factory=dict)  # what they are held against

    @property
    def sign(self) -> str:
        """A sign that says the grade without colour."""
        return SIGNS[self.grade]

    @property
    def html(self) -> Markup:
        """The sentence with its symbols set as in the literature."""
        return in_symbols(self.sentence)

    @property
    def line(self) -> "Text":
        """The verdict on a terminal; a bad one warns."""
        from bayesterra.report.blocks import Text

        said = self.sentence.striptags() if isinstance(self.sentence, Markup) else self.sentence
        warns = "warning: " if self.grade == "bad" else ""
        return Text(f"{warns}{self.name}: {self.word}. {said}", "bad" if warns else "")

    def record(self) -> dict[str, Any]:
        """Entry of a record."""
        return {**asdict(self), "sentence": str(self.sentence)}


class VerdictEntry(TypedDict, total=False):
    """Entry of a record for a verdict, as :meth:`Verdict.record` makes it."""

    __pydantic_config__ = ConfigDict(extra="forbid")  # type: ignore[misc]

    name: Required[str]
    word: Required[str]
    grade: Required[Literal["good", "doubtful", "bad", "note"]]
    sentence: Required[str]
    claim: str
    figures: dict[str, Any]
    thresholds: dict[str, Any]


def unknown_verdict(name: str, why: str) -> Verdict:
    """The word that a verdict is not known, and why."""
    return Verdict(name, "not known", "doubtful", Markup("{}").format(why), f"{name.lower()} is not known")


def sampling_verdict(record: Mapping[str, Any]) -> Verdict:
    """Verdict on whether the draws can be relied on."""
    verdict, settings = record["verdict"], record["settings"]
    r_hat = "–" if verdict["r_hat"] is None else f"{verdict['r_hat']:.4f}"
    figures = f"R-hat {r_hat}, {verdict['ess']:.0f} effective draws of {settings['ensembles']} ensembles"
    failed = [check["name"] for check in verdict["checks"] if not check["passed"]]
    behind = {check["name"]: check["value"] for check in verdict["checks"]}
    asked = {check["name"]: check["threshold"] for check in verdict["checks"]}
    if verdict["converged"]:
        return Verdict("Sampling", "converged", "good", f"{figures}. {UNSEEN}", "", behind, asked)
    sentence = f"{figures}. Failed: {enumerated(failed)}."
    return Verdict("Sampling", "not converged", "bad", sentence, "the sampling has not converged", behind, asked)


def quotable(verdicts: Sequence[Verdict], scope: str, notes: Sequence[str]) -> str:
    """The sentence that may be quoted of a result: what forbids its use first, else what it holds for."""
    claims = {
        grade: [verdict.claim or verdict.word for verdict in verdicts if verdict.grade == grade]
        for grade in ("bad", "doubtful")
    }
    if claims["bad"]:
        return f"Do not use: {'; '.join(claims['bad'] + claims['doubtful'])}."
    if claims["doubtful"]:
        return f"Use with care, for {scope}: {'; '.join(claims['doubtful'])}."
    return f"These intervals hold for {'; '.join((scope, *notes))}."
