"""Verdicts: what may be said of a result, in a word, a grade and a sentence; made once, read everywhere."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Any

from markupsafe import Markup

from bayesterra.errors import enumerated
from bayesterra.report.symbols import in_symbols

if TYPE_CHECKING:
    from bayesterra.report.blocks import Cell, Text

SIGNS = {"good": "✓", "doubtful": "◐", "bad": "✕", "note": "–"}
"""Signs of grades without colour. A note is neither good nor bad: a finding, or what could not be tested."""
UNSEEN = "A second solution that no ensemble found would not show."
"""Limit of what convergence can say."""


@dataclass(frozen=True)
class Verdict:
    """One verdict.

    Attributes
    ----------
    name : of what is judged.
    grade : ``good``, ``doubtful``, ``bad`` or ``note``.
    claim : what it says, as a clause of a sentence on the whole result.
    figures, thresholds : behind the word.
    """

    name: str
    word: str
    grade: str
    sentence: Cell
    claim: str = ""
    figures: Mapping[str, float] = field(default_factory=dict)
    thresholds: Mapping[str, float] = field(default_factory=dict)

    @property
    def sign(self) -> str:
        """A sign that says the grade without colour."""
        return SIGNS[self.grade]

    @property
    def html(self) -> Markup:
        """The sentence with its symbols set as in the literature."""
        return self.sentence if isinstance(self.sentence, Markup) else in_symbols(self.sentence)

    @property
    def line(self) -> Text:
        """The verdict on a terminal; a bad one warns."""
        from bayesterra.report.blocks import Text

        said = self.sentence.striptags() if isinstance(self.sentence, Markup) else self.sentence
        warns = "warning: " if self.grade == "bad" else ""
        return Text(f"{warns}{self.name}: {self.word}. {said}", "bad" if warns else "")

    def record(self) -> dict[str, Any]:
        """Entry of a record."""
        return {**asdict(self), "sentence": str(self.sentence)}


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
