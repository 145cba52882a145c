"""The content of ``run.json`` of a run on one soil."""
# ruff: noqa: UP013 (a line for each kind of entry reads better than a class)

from __future__ import annotations

from collections.abc import Collection
from typing import Annotated, Any, Literal, NotRequired

from pydantic import AfterValidator
from typing_extensions import TypedDict

from bayesterra.runtime.records import Count, Number
from bayesterra.study.record import ChannelName, ParameterName, Some, StudyRecord

Method = Literal["IM1", "IM2", "IM3", "joint"]
Names = list[ParameterName]
Values = dict[ParameterName, Some]
Sampling = TypedDict("Sampling", {
    "acceptance": Number, "steps": Count, "kept_one_step_in": Count, "tau": Values,
    "temperatures": list[Count], "proposal_efficiency": list[Some], "log_evidence": list[Some],
})  # fmt: skip
Evidence = TypedDict("Evidence", {
    "log_z": Number, "error": Number, "k_hat": Some, "limit": Number, "draws": Count, "reliable": bool,
    "spread": NotRequired[Number], "log_share": Number, "log_share_error": Number,
})  # fmt: skip
PriorSupport = TypedDict("PriorSupport", {"tried": Count, "shares": dict[str, Number]})
Mode = TypedDict("Mode", {"log_density": Number, "agreeing_starts": Count})
Fit = TypedDict("Fit", {
    "converged": bool, "passes": Count, "errors_percent": dict[ChannelName, Some], "held": Names,
    "at_bound": Names, "missing": Names, "notes": list[str],
})  # fmt: skip
Standing = TypedDict("Standing", {
    "credible_level": Some, "log_density": Some, "word": str, "at_bound": Names, "filled": Names,
    "values": Values,
})  # fmt: skip
Group = TypedDict("Group", {
    "scope": str, "view": str, "directions": Count, "determined": Count, "effective": Some,
    "cut_effective": Some,
})  # fmt: skip
Directions = TypedDict("Directions", {
    "determined": Count, "of": Count, "contractions": list[Number], "groups": list[Group],
    "unseen": list[str],
})  # fmt: skip
Check = TypedDict("Check", {"channel": ChannelName, "statistic": str, "p": Number, "calibrated": Number})
Checks = TypedDict("Checks", {
    "checks": list[Check], "overall": Number, "replicates": Count, "effective": list[Number],
})  # fmt: skip
PriorCheck = TypedDict("PriorCheck", {
    "channel": ChannelName, "statistic": str, "value": Number, "low": Number, "high": Number, "p": Number,
})  # fmt: skip
PriorChecks = TypedDict("PriorChecks", {"checks": list[PriorCheck], "overall": Number})
Row = TypedDict("Row", {"row": Count, "elpd": Number, "error": Number, "k": Some, "refitted": bool})
LeftOut = TypedDict("LeftOut", {
    "rows": list[Row], "full": list[Number], "pit": dict[ChannelName, list[Some]],
})  # fmt: skip
FAILING = {
    "evidence": ("evidence",),
    "directions": ("directions", "identifiability"),
    "predictive_checks": ("predictive_checks",),
    "prior_checks": ("prior_checks", "prior_predictive"),
    "loo": ("loo",),
}
"""Entries of a record that may be missing where its ``failures`` name one of these."""


def _same_length(loo: LeftOut) -> LeftOut:
    if len(loo["rows"]) != len(loo["full"]):
        raise ValueError("must have as many rows as densities")
    return loo


class RunRecord(StudyRecord):
    """The content of ``run.json`` of a run on one soil."""

    sampling: Sampling
    evidence: Evidence
    prior_support: PriorSupport
    mode: Mode
    fits: dict[Method, Fit]
    refused_fits: list[str]
    standings: dict[Method | Literal["mode", "published", "truth"], Standing]
    directions: Directions
    predictive_checks: Checks
    prior_checks: PriorChecks
    loo: Annotated[LeftOut, AfterValidator(_same_length)]

    @classmethod
    def excused(cls, content: dict[str, Any]) -> Collection[str]:
        """Entries that may be missing because they, or what they rest on, could not be computed."""
        failed = set(content.get("failures", ()))
        return [name for name, causes in FAILING.items() if failed & set(causes)]
