"""What is asked of every fit: whether model and prior give such readings, and how well rows are predicted."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

from numpy.random import SeedSequence
from threadpoolctl import threadpool_limits

from bayesterra.arrays import FloatArray
from bayesterra.crossvalidation import CrossValidation, leave_one_out
from bayesterra.failures import Failures
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
    """Predictive checks under the posterior and the prior, and leave-one-out cross-validation.

    None stands for one that could not be computed.
    """

    checks: PredictiveChecks | None
    prior: PriorChecks | None
    loo: CrossValidation | None

    def record(self) -> dict[str, Any]:
        """Everything, for ``run.json``."""
        record: dict[str, Any] = {}
        if self.checks is not None:
            alarm = {"threshold": ALARM, "alarm": self.checks.alarm}
            record["predictive_checks"] = {**asdict(self.checks), **alarm}
        if self.prior is not None:
            conflict = {"threshold": CONFLICT, "conflict": self.prior.conflict}
            record["prior_checks"] = {**asdict(self.prior), **conflict}
        if self.loo is not None:
            record["loo"] = {
                "elpd": self.loo.elpd,
                "se": self.loo.se,
                "effective_parameters": self.loo.effective_parameters,
                **asdict(self.loo),
            }
        return record

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> Validation:
        """Read back from the content of a ``run.json``."""
        checks, prior, loo = (record.get(name) for name in ("predictive_checks", "prior_checks", "loo"))
        return cls(
            checks
            and PredictiveChecks(
                tuple(Check(**check) for check in checks["checks"]),
                checks["overall"],
                checks["replicates"],
                (checks["effective"][0], checks["effective"][1]),
            ),
            prior and PriorChecks(tuple(PriorCheck(**check) for check in prior["checks"]), prior["overall"]),
            loo and CrossValidation.from_record(loo),
        )


def validate(
    study: Study,
    posterior: Posterior,
    draws: FloatArray,
    before: RowPredictions,
    seed: SeedSequence,
    failures: Failures,
) -> Validation:
    """Validate a study's posterior.

    Parameters
    ----------
    draws : near-independent posterior draws (n, d).
    before : readings of all rows that the cut prior predicts, at known or read loads.
    failures : takes note of checks that cannot be computed.
    """
    checking, leaving = seed.spawn(2)
    with threadpool_limits(limits=1):  # matrices are small: threads of the linear algebra wait for each other
        return Validation(
            failures.attempt(
                "predictive_checks", lambda: predictive_checks(posterior, draws, checking), lambda: None
            ),
            None
            if "prior_predictive" in failures
            else failures.attempt("prior_checks", lambda: prior_checks(study, before), lambda: None),
            failures.attempt("loo", lambda: leave_one_out(posterior, draws, leaving), lambda: None),
        )
