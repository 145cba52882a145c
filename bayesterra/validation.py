"""What is asked of every fit: whether model and prior give such readings, and how well rows are predicted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from numpy.random import SeedSequence
from threadpoolctl import threadpool_limits

from bayesterra.arrays import FloatArray
from bayesterra.crossvalidation import CrossValidation, leave_one_out
from bayesterra.posteriors import Posterior
from bayesterra.predictive import RowPredictions
from bayesterra.predictive_checks import (
    ALARM,
    CONFLICT,
    Check,
    PredictiveChecks,
    PriorCheck,
    PriorChecks,
    predictive_checks,
    prior_checks,
)
from bayesterra.study import Study


@dataclass(frozen=True)
class Validation:
    """Predictive checks under the posterior and the prior, and leave-one-out cross-validation."""

    checks: PredictiveChecks
    prior: PriorChecks
    loo: CrossValidation

    def record(self) -> dict[str, Any]:
        """Everything, for ``run.json``."""
        return {
            "predictive_checks": {**asdict(self.checks), "threshold": ALARM, "alarm": self.checks.alarm},
            "prior_checks": {**asdict(self.prior), "threshold": CONFLICT, "conflict": self.prior.conflict},
            "loo": {
                "elpd": self.loo.elpd,
                "se": self.loo.se,
                "effective_parameters": self.loo.effective_parameters,
                **asdict(self.loo),
            },
        }

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Validation:
        """Read back from the content of a ``run.json``."""
        checks, prior = record["predictive_checks"], record["prior_checks"]
        return cls(
            PredictiveChecks(
                tuple(Check(**check) for check in checks["checks"]),
                checks["overall"],
                checks["replicates"],
                (checks["effective"][0], checks["effective"][1]),
            ),
            PriorChecks(tuple(PriorCheck(**check) for check in prior["checks"]), prior["overall"]),
            CrossValidation.from_record(record["loo"]),
        )


def validate(
    study: Study, posterior: Posterior, draws: FloatArray, before: RowPredictions, seed: SeedSequence
) -> Validation:
    """Validate a study's posterior.

    Parameters
    ----------
    draws : near-independent posterior draws (n, d).
    before : readings of all rows that the cut prior predicts, at known or read loads.
    """
    checking, leaving = seed.spawn(2)
    with threadpool_limits(limits=1):  # matrices are small: threads of the linear algebra wait for each other
        return Validation(
            predictive_checks(posterior, draws, checking),
            prior_checks(study, before),
            leave_one_out(posterior, draws, leaving),
        )
