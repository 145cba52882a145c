"""Leave-group-out cross-validation: levels of slip, wheels or rows that the fit has not seen.

What a left-out row keeps is what somebody who plans that drive would know: its slip, its wheel and its load.
With the drive ``both`` that is the normal force as it was read, from which each draw's true load is inferred;
with ``sinkage`` it is the sinkage. Everything else that was read is predicted, noise included.

A draw for which the model has no answer (no sinkage carries the load, say) states that the drive cannot be.
As it was made, such draws are set aside and the others predict; their share is in the table.
"""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

import pandas as pd

from bayesterra.checking.folds import DRAWS, TOLERANCE, By, Fold, LeaveOneOut, Outcome, levels, refits
from bayesterra.checking.holdout_scores import skills, summarise
from bayesterra.checking.ranks import CONVERGED
from bayesterra.checking.short_runs import Fit, settings_of
from bayesterra.errors import StudyError, check_kind, check_seed
from bayesterra.likelihood.joint import whole_posterior
from bayesterra.runtime.engines import Engine, completed, in_process
from bayesterra.runtime.folders import check_free
from bayesterra.runtime.status import job_folder
from bayesterra.runtime.tables import Count, Record
from bayesterra.study.result import AnalysisResult, Result, versions
from bayesterra.study.study import Study, load_study, without_wheels


@dataclass(frozen=True)
class Holdout(AnalysisResult):
    """Every level left out once.

    Attributes
    ----------
    study : what was analysed.
    levels : what was left out, in order.
    outcomes : one per level.
    record : grouping, seed, settings, fingerprints and versions.
    """

    MARK = "holdout.json"
    RECORD = Record.having(
        kind=Literal["holdout"], by=str, seed=Count, model=str, drive=str, data=str,
        fingerprints=dict[str, str], settings=dict, versions=dict[str, str], converged=bool,
    )  # fmt: skip
    VIEW = "bayesterra.checking.holdout_page:holdout"
    WITH_STUDY = True
    FIGURES: ClassVar[Mapping[str, str]] = {"holdout.png": "all_left_out", "bands.png": "bands_without"}
    CALLED = "Page"

    study: Study
    levels: tuple[Fold, ...]
    outcomes: tuple[Outcome, ...]
    record: dict[str, Any]

    @property
    def model(self) -> str:
        """The model's name among the predictors."""
        return self.study.model.name

    @property
    def converged(self) -> bool:
        """True where every refit converged."""
        return all(outcome.status == CONVERGED for outcome in self.outcomes)

    @property
    def table(self) -> pd.DataFrame:
        """One row per predictor, left-out row and channel.

        Observed value, predictive quantiles, probability below the reading (``pit``), CRPS, log of the
        predictive density, whether the central 50 and 90 % hold the reading, the share of draws without an
        answer; all in field units.
        """
        return pd.DataFrame([row for outcome in self.outcomes for row in outcome.rows])

    @property
    def summary(self) -> pd.DataFrame:
        """Mean scores by predictor, channel and part."""
        return summarise(self.table)

    @property
    def skills(self) -> pd.DataFrame:
        """The model against every baseline; see :func:`bayesterra.checking.holdout_scores.skills`."""
        return skills(self.table, self.model, self.record["seed"])

    @property
    def refits(self) -> pd.DataFrame:
        """One row per level: rows left out, and how the refit went."""
        rows, how = self.study.observations.rows, ("status", "ess", "r_hat", "seconds", "note")
        return pd.DataFrame(
            [
                {
                    "level": fold.name,
                    "rows": " ".join(str(rows[i]) for i in fold.left.nonzero()[0]),
                    **{name: getattr(outcome, name) for name in how},
                }
                for fold, outcome in zip(self.levels, self.outcomes, strict=True)
            ]
        )

    def tables(self) -> dict[str, pd.DataFrame]:
        """Scores of every row, their means, skills beside the baselines, and the refits."""
        return {"scores": self.table, "summary": self.summary, "skills": self.skills, "refits": self.refits}

    def to_record(self) -> dict[str, Any]:
        """Content of the JSON file."""
        return {**self.record, "converged": self.converged}


def _held_out(
    study: Study,
    report: Callable[[int, int, float | None], None],
    *,
    by: By,
    tolerance: float,
    seed: int,
    engine: Engine | None,
    fit: Fit | None = None,
) -> Holdout:
    """Leave every level out once; ``report`` is told how many of how many are done, and the seconds left."""
    if not study.prior.names:
        raise StudyError("every parameter is fixed: there is nothing to fit again")
    whole_posterior(study)
    folds, fit = levels(study, by, tolerance), fit or refits(study)
    task = LeaveOneOut(study, folds, seed, fit)
    done: dict[int, Outcome] = {}
    n, started = len(folds), time.perf_counter()
    report(0, n, None)
    for number, outcome in completed(task, range(n), engine or in_process()):
        done[number] = outcome
        report(len(done), n, (time.perf_counter() - started) / len(done) * (n - len(done)))
    origin = {
        "kind": "holdout", "by": by if isinstance(by, str) else "groups given",
        **({"tolerance": tolerance} if by == "slip" else {}),
        **({"basis": study.pooling.left_out} if study.pooling else {}), "seed": seed, "model": study.model.name,
        "drive": study.drive, "data": study.kind, "fingerprints": study.fingerprint,
        "settings": {"draws": DRAWS, **settings_of(fit)}, "versions": versions(),
    }  # fmt: skip
    return Holdout(study, folds, tuple(done[number] for number in range(n)), origin)


def leave_out(
    what: Study | Result, by: By = "slip", *, tolerance: float = TOLERANCE, seed: int = 1,
    engine: Engine | None = None, fit: Fit | None = None, progress: Callable[[str], None] = lambda part: None,
) -> Holdout:  # fmt: skip
    """Leave groups of rows out, one group at a time; fit the others; predict the group and score that.

    Of a left-out row its slip, wheel and load stay known, with the drive ``both`` its normal force as it was
    read, with ``sinkage`` its sinkage; all else that was read is predicted, noise included. Regressions that
    know no terramechanics predict the same rows from the same training rows. With groups refits are of the
    joint posterior, and a group that is left out whole is predicted as one that was not tested.

    Parameters
    ----------
    what : a study, or a result, of which only the study is used.
    by : ``slip`` (slips nearer than ``tolerance`` are one level), ``wheel`` or ``row``; or groups of row
        numbers, or one label for every row of the table.
    tolerance : for ``slip``; a level is four times as wide at most.
    seed : same seed, same scores, whatever the engine.
    engine : computes the refits: ``bt.local_pool()``, ``bt.dask_cluster("tcp://…")``; by default this
        process.
    fit : samples a posterior, see :data:`bayesterra.checking.calibration.Fit`; by default the sampler of
        :func:`bayesterra.run`, until there are 1000 effective draws.
    progress : told what is at work.

    Raises
    ------
    StudyError : an unknown grouping, fewer than two levels or groups, or nothing is free.
    """
    check_kind("bt.leave_out", what, Study, Result)
    check_seed(seed)
    study = what.study if isinstance(what, Result) else what
    without_wheels(study, "holdout")
    return _held_out(
        study, lambda done, of, _: progress(_at_work(done, of)),
        by=by, tolerance=tolerance, seed=seed, engine=engine, fit=fit,
    )  # fmt: skip


def _at_work(done: int, of: int) -> str:
    return f"leaving out {of} levels: {done} done"


def leave_out_into(path: Path, out: Path, *, overwrite: bool = False, quiet: bool = False, **asked: Any) -> Holdout:
    """Leave levels of the study at a path, or of the one in a result folder, out into a new folder.

    ``asked``: keywords of :func:`leave_out`, all but ``fit`` and ``progress``.

    Raises
    ------
    ResultError : ``out`` exists (and ``overwrite`` is not given) or cannot be written.
    StudyError : as :func:`leave_out`.
    """
    from bayesterra.report.terminal import stages

    study = load_study(path)
    without_wheels(study, "holdout")
    check_free(out, overwrite=overwrite, mark=Holdout.MARK)
    with job_folder(out, mark=Holdout.MARK, overwrite=overwrite) as (part, status):
        with stages(show=not quiet) as show:

            def update(done: int, of: int, seconds_left: float | None) -> None:
                status.note("leaving out", done / of, seconds_left, steps=done)
                show(_at_work(done, of))

            result = _held_out(study, update, **asked)
        result.write(part)
    return result
