"""How far groups share their parameters: complete pooling, the stated one and none, side by side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator

from bayesterra.pooling.alternatives import Level
from bayesterra.pooling.joint import JointPosterior
from bayesterra.pooling.sampler import JointSamples
from bayesterra.pooling.weighing import (
    PriorShares,
    Weighed,
    joint_shares,
    plain_shares,
    weigh_joint,
    weigh_plain,
)
from bayesterra.sampling.evidence import Evidence
from bayesterra.sampling.sampler import Samples

COMPLETE, PARTIAL, NONE = "complete", "as stated", "none"
"""One value for all groups; the study's own roles; every group alone."""
INDISTINCT = 3.0
"""Difference of log evidences below which two degrees of pooling are not told apart; odds of 20 to 1."""


LEFT_OUT_COLUMNS = ("pooling", "what", "label", "elpd", "error", "k", "reliable")
DEGREE_COLUMNS = ("pooling", "converged", "log_evidence", "log_evidence_error", "evidence_reliable")


@dataclass(frozen=True)
class Degree:
    """One degree of pooling.

    Attributes
    ----------
    name : ``complete``, ``as stated`` or ``none``.
    converged : of its sampling.
    log_z, error, reliable : log evidence under the prior cut to the support and renormalised.
    left_out : elpd of every row and group, columns ``pooling, what, label, elpd, error, k, reliable``.
    """

    name: str
    converged: bool
    log_z: float
    error: float
    reliable: bool
    left_out: pd.DataFrame

    @property
    def level(self) -> Level:
        """Its log evidence."""
        return Level(self.log_z, self.error, self.reliable)

    def row(self) -> dict[str, Any]:
        """A row of the table."""
        parts: dict[str, Any] = {}
        for what in ("row", "group"):
            some = self.left_out[self.left_out["what"] == what]
            spread = float(np.sqrt(len(some)) * some["elpd"].std())
            parts |= {
                f"elpd_{what}s": float(some["elpd"].sum()),
                f"se_{what}s": spread,
                f"error_{what}s": float(np.sqrt((some["error"] ** 2).sum())),
                f"unreliable_{what}s": int((~some["reliable"]).sum()),
            }
        head = {"pooling": self.name, "converged": self.converged, "log_evidence": self.log_z}
        return {**head, "log_evidence_error": self.error, "evidence_reliable": self.reliable, **parts}


def degrees_of(
    joint: JointPosterior, samples: JointSamples, complete: Samples, rng: Generator
) -> tuple[Degree, Degree, Degree]:
    """Complete pooling, the study's own roles, none."""
    names = list(joint.groups)
    of_joint = weigh_joint(samples, rng)
    proposals = [adaptation.proposal for adaptation in complete.adaptations]
    of_all = weigh_plain(joint, names, complete.coordinates, proposals, rng)
    alone = []
    for name, lone in samples.lone.items():
        proposals = [adaptation.proposal for adaptation in lone.adaptations]
        weighed = weigh_plain(joint, [name], lone.coordinates, proposals, rng)
        alone.append((weighed, _own(weighed, lone), plain_shares(joint, [name], rng)))
    every = all(lone.diagnosis.converged for lone in samples.lone.values())
    return (
        _degree(
            joint,
            COMPLETE,
            complete.diagnosis.converged,
            (of_all, _own(of_all, complete), plain_shares(joint, names, rng)),
        ),
        _degree(
            joint,
            PARTIAL,
            samples.diagnosis.converged,
            (of_joint, of_joint.evidence, joint_shares(joint, rng)),
        ),
        _apart(joint, every, alone),
    )


def _own(weighed: Weighed, samples: Samples) -> Evidence:
    """Evidence with what the ensembles found alone."""
    return weighed.evidence.beside([adaptation.log_evidence for adaptation in samples.adaptations])


def _entry(name: str, what: str, label: object, found: Any, correction: float = 0.0) -> dict[str, Any]:
    return {
        "pooling": name, "what": what, "label": str(label), "elpd": found.elpd + correction,
        "error": found.error, "k": found.k, "reliable": found.reliable,
    }  # fmt: skip


def _degree(
    joint: JointPosterior, name: str, converged: bool, parts: tuple[Weighed, Evidence, PriorShares]
) -> Degree:
    weighed, found, shares = parts
    entries = []
    for g, (group, own) in enumerate(joint.groups.items()):
        correction = shares.without[g] - shares.whole
        entries.append(_entry(name, "group", group, weighed.left_out(g), correction))
        rows = own.likelihood.observations.rows
        entries += [_entry(name, "row", row, weighed.left_out(g, i)) for i, row in enumerate(rows)]
    error = float(np.hypot(found.error, shares.error))
    return Degree(name, converged, found.log_z - shares.whole, error, found.reliable, pd.DataFrame(entries))


def _apart(
    joint: JointPosterior, converged: bool, alone: Sequence[tuple[Weighed, Evidence, PriorShares]]
) -> Degree:
    entries, log_z, variance, reliable = [], 0.0, 0.0, True
    for (group, own), (weighed, found, shares) in zip(joint.groups.items(), alone, strict=True):
        log_z += found.log_z - shares.whole
        variance += found.error**2 + shares.error**2
        reliable &= found.reliable
        entries.append(
            {
                "pooling": NONE, "what": "group", "label": group, "elpd": found.log_z - shares.whole,
                "error": float(np.hypot(found.error, shares.error)), "k": found.k_hat,
                "reliable": found.reliable,
            }
        )  # fmt: skip
        rows = own.likelihood.observations.rows
        entries += [_entry(NONE, "row", row, weighed.left_out(0, i)) for i, row in enumerate(rows)]
    return Degree(NONE, converged, log_z, float(np.sqrt(variance)), reliable, pd.DataFrame(entries))


def preferred(degrees: Sequence[Degree]) -> str:
    """Which degree of pooling the evidence prefers, in words."""
    if not degrees:
        return "not known: the degrees of pooling could not be compared"
    best, second = sorted(degrees, key=lambda degree: -degree.log_z)[:2]
    gap = best.log_z - second.log_z
    if not (best.reliable and second.reliable):
        return "not known: the evidence cannot be relied on; compare by leaving rows out"
    if gap - 2 * np.hypot(best.error, second.error) < INDISTINCT:
        return f"not decided between {best.name} and {second.name}"
    return best.name
