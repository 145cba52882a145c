"""Fit and prediction of a joint posterior of several groups, for the first screen of its report."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.random import Generator, SeedSequence, default_rng
from threadpoolctl import threadpool_limits

from bayesterra.arrays import FloatArray
from bayesterra.checking.folds import Fold
from bayesterra.checking.levels import parts_of, places, predicted, untested, ways
from bayesterra.checking.loo import without_levels
from bayesterra.checking.predictive_checks import uncalibrated_checks
from bayesterra.checking.validation import fit_verdict, prediction_verdict
from bayesterra.errors import enumerated
from bayesterra.likelihood.joint import JointPosterior, joint_posterior
from bayesterra.pooling.run import PooledResult
from bayesterra.report.numbers import probability
from bayesterra.report.verdicts import Failures, Verdict, unknown_verdict, with_failures
from bayesterra.study.study import Study

ANEW = "`bayesterra holdout` makes each fit anew"


def judged(result: PooledResult, seed: int) -> PooledResult:
    """The result with its verdicts on fit and prediction in the record.

    Their random streams are of the run's ``seed``, beside those of :func:`bayesterra.pooling.run.run_pooled`.
    """
    study, draws, failures = result.study, result.values(), Failures()
    joint, levels = joint_posterior(study), ways(study)
    fitting, predicting = SeedSequence(seed).spawn(8)[6:]
    with threadpool_limits(limits=1):  # matrices are small: threads of the linear algebra wait for each other
        fit = failures.attempt(
            "predictive_checks", lambda: fit_of_groups(study, joint, draws, levels, default_rng(fitting))
        )
        prediction = failures.attempt("levels", lambda: prediction_of_levels(study, joint, draws, levels, predicting))
    verdicts = (
        result.verdicts[0],
        fit or unknown_verdict("Fit", failures.said("predictive_checks")),
        prediction or unknown_verdict("Prediction", failures.said("levels")),
    )
    record = {**result.record, "verdicts": [verdict.record() for verdict in verdicts], "untested": untested(study)}
    found = replace(result, record=with_failures(record, failures))
    return replace(found, record={**found.record, "sentence": found.sentence})


def fit_of_groups(
    study: Study, joint: JointPosterior, draws: FloatArray, levels: Mapping[str, tuple[Fold, ...]], rng: Generator
) -> Verdict:
    """Verdict on the group whose readings look the strangest, as one of so many."""
    parts, order = parts_of(study, levels), study.observations.used().rows
    found = {}
    for (group, own), x in zip(joint.groups.items(), joint.values_of_groups(draws), strict=True):
        mine = np.isin(order, own.likelihood.observations.rows)
        found[group] = uncalibrated_checks(own, x, rng, {by: number[mine] for by, number in parts.items()})
    group, worst = min(found.items(), key=lambda item: item[1].overall)
    worst = replace(worst, overall=min(1.0, len(found) * worst.overall))
    verdict = fit_verdict(worst)
    if verdict.grade == "good":
        number = sum(len(checks.checks) for checks in found.values())
        said = f"No group looks strange: the least p of {number} statistics, times their number, is"
        return replace(verdict, sentence=f"{said} {probability(worst.overall)}.")
    claim = verdict.claim.replace(" fit: ", f" fit {group}: ")
    return replace(verdict, sentence=f"{group}: {verdict.sentence}", claim=claim)


def prediction_of_levels(
    study: Study, joint: JointPosterior, draws: FloatArray, levels: Mapping[str, tuple[Fold, ...]], seed: SeedSequence
) -> Verdict:
    """Verdict on levels left out, those that draws of the joint posterior reach by their weights."""
    if not joint.rows_apart:
        return prediction_verdict(None, study.model.name, f"Errors of the model tie rows together: {ANEW}.")
    leaving, predicting = seed.spawn(2)
    left = list(dict.fromkeys(places(study, fold) for folds in levels.values() for fold in folds))
    found = without_levels(joint, draws, leaving, left)
    records = predicted(study, joint, levels, found, default_rng(predicting))
    told = [row for row in records if row["reliable"]]
    beyond = list(dict.fromkeys(str(row["level"]) for row in records if not row["reliable"]))
    rest = f"{enumerated(beyond)}: the posterior without {'it' if len(beyond) == 1 else 'each'} is quite another one"
    if records and not told:
        return prediction_verdict(None, study.model.name, f"Not tested: {rest}; {ANEW}.")
    verdict = prediction_verdict(told, study.model.name)
    return replace(verdict, sentence=f"{verdict.sentence} Not tested: {rest}; {ANEW}.") if beyond else verdict
