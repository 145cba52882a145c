"""Shape of what the records of all runs of a study say: where they come from, and how the sampling went."""
# ruff: noqa: UP013 (a line for each kind of entry reads better than a class)

from __future__ import annotations

from typing import Annotated, Literal, NotRequired

from pydantic import AfterValidator, Field
from typing_extensions import TypedDict

from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.runtime.records import Count, Number, Record


def _parameter(name: str) -> str:
    if name not in PARAMETERS:
        raise ValueError("must be a parameter")
    return name


def _channel(name: str) -> str:
    if name not in CHANNELS:
        raise ValueError("must be a channel")
    return name


ParameterName = Annotated[str, AfterValidator(_parameter)]
ChannelName = Annotated[str, AfterValidator(_channel)]
Some = Number | None
"""A number; what is not finite stands as null."""

Fingerprints = TypedDict("Fingerprints", {"study": str, "data": str, "run": NotRequired[str]})
Settings = TypedDict(
    "Settings", {"target_ess": Count, "ensembles": Count, "walkers": Count, "max_steps": Count}
)
Check = TypedDict("Check", {"name": str, "value": Some, "threshold": Number, "passed": bool, "advice": str})
SamplingVerdict = TypedDict(
    "SamplingVerdict", {"converged": bool, "ess": Number, "r_hat": Some, "checks": list[Check]}
)
FailureEntry = TypedDict("FailureEntry", {"error": str, "message": str, "trace": list[str]})


class OriginRecord(Record):
    """Where a record comes from, and what could not be computed."""

    title: str
    kind: Literal["measured", "simulated", "digitised"]
    source: str
    made: str
    versions: dict[str, str]
    seed: Count
    notes: list[str]
    failures: dict[str, FailureEntry] = Field(default_factory=dict)


class PriorRecord(OriginRecord):
    """The content of ``run.json`` of a prior without readings."""

    machine: str
    model: str
    drive: str
    fingerprints: Fingerprints


class StudyRecord(PriorRecord):
    """What the records of all runs of a study hold."""

    settings: Settings
    seconds: dict[str, Number]
    verdict: SamplingVerdict
