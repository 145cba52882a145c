"""The job ``design``: which drive to command next, as a resumable folder."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import SeedSequence, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.design import choosing
from bayesterra.design.candidates import Candidate, Situation, candidates, parameters_of_interest, readings_of
from bayesterra.design.choosing import BIT, CRITERIA, UNANSWERED, Design, Progress
from bayesterra.design.gain import Estimate, Interest, normal_estimate, pairs
from bayesterra.errors import StudyError, check_kind, check_seed, did_you_mean
from bayesterra.likelihood.forward import reference_load
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.models import Wheel
from bayesterra.runtime.checkpoints import Checkpoints
from bayesterra.runtime.engines import Engine
from bayesterra.runtime.folders import check_free
from bayesterra.runtime.ownership import WORK
from bayesterra.runtime.status import job_folder
from bayesterra.study.canonical import FORM
from bayesterra.study.result import Result, versions
from bayesterra.study.study import Study, without_wheels
from bayesterra.study.wheels import chosen_wheel, chosen_wheels

TASKS = "candidates"
DRAWS = 2000
"""Draws, at most, that candidates are judged by: all pairs of them are looked at."""
QUICK = 500
"""Draws of the quick form."""
MOST = 12
"""Rows, at most, to choose together."""


def situation_of(study_or_result: Result | Study, seed: int = 1) -> Situation:
    """Knowledge before the drive: the posterior of a result, or the cut prior of a study."""
    if isinstance(study_or_result, Result):
        draws = study_or_result.values()
        chosen = np.linspace(0, len(draws) - 1, min(len(draws), DRAWS)).astype(np.int64)
        study, basis = study_or_result.study, study_or_result.basis
        return Situation(study, posterior(study), draws[chosen], "posterior", basis)
    density = posterior(study_or_result)
    return Situation(study_or_result, density, draw_cut_prior(density, DRAWS, default_rng(seed)).x, "prior")


@dataclass(frozen=True)
class DesignRequest:
    """Question to a design, complete: what :func:`bayesterra.design.choosing.choose` is told."""

    situation: Situation
    candidates: tuple[Candidate, ...]
    about: tuple[str, ...]
    number: int
    by: str
    seed: int

    @property
    def origin(self) -> dict[str, Any]:
        """Facts that judged candidates of one design share, by names fit for a message."""
        study, prints = self.situation.study, self.situation.study.fingerprint
        candidates = [
            (row.wheel, row.wheels, row.slip.tolist(), row.load.tolist(), row.noise) for row in self.candidates
        ]
        return {
            "seed": self.seed, "about": list(self.about), "number": self.number, "by": self.by,
            "source": self.situation.source, **versions(), "plain form {} of studies": FORM, "study": prints["study"],
            "table of measurements": prints["data"],
            "set of draws": sha256(np.ascontiguousarray(self.situation.draws).tobytes()).hexdigest(),
            "list of candidates": sha256(repr((candidates, str(study.drive))).encode()).hexdigest(),
        }  # fmt: skip


def design_request(
    study_or_result: Result | Study, *, about: Sequence[str] = (), slips: Sequence[float] = (),
    loads: Sequence[float | str] = (), wheels: Sequence[str | Wheel] = (), channels: Sequence[str] = (),
    number: int = 1, by: str = "information", seed: int = 1, group: str | None = None,
) -> DesignRequest:  # fmt: skip
    """Put a question together, and find mistakes before any work; see :func:`recommend`."""
    if by not in CRITERIA:
        raise StudyError(f"'by' must be {' or '.join(CRITERIA)} (got {by!r}){did_you_mean(by, CRITERIA)}")
    if not 1 <= number <= MOST:
        raise StudyError(f"'number' must lie in 1 to {MOST} (got {number})")
    if isinstance(study_or_result, Result):
        study_or_result = _of_group(study_or_result, group, wheels, seed)
    elif group is not None:
        raise StudyError(f"'group' needs a result with groups (got {group!r} beside a study)")
    study = study_or_result.study if isinstance(study_or_result, Result) else study_or_result
    without_wheels(study, "design")
    names = parameters_of_interest(study, about)
    grid = candidates(study, slips, loads, chosen_wheels(study, wheels), channels)
    return DesignRequest(situation_of(study_or_result, seed), tuple(grid), tuple(names), number, by, seed)


def _of_group(result: Result, group: str | None, wheels: Sequence[str | Wheel], seed: int) -> Result:
    """The result itself, or that of the group whose drives are judged."""
    pooling = result.study.pooling
    if group is None and pooling is not None and pooling.by == "wheel":
        if len(wheels) != 1:
            raise StudyError(
                f"say whose drives: 'group' must be one of {', '.join(result.groups)}, or 'wheel' one that"
                " was not tested"
            )
        called, _ = chosen_wheel(result.study, wheels[0])
        group = called if called in result.groups else None
    return result.of_group(group, seed=seed)


def recommend(
    known: Result | Study, *, about: Sequence[str] = (), slips: Sequence[float] = (),
    loads: Sequence[float | str] = (), wheels: Sequence[str | Wheel] = (), channels: Sequence[str] = (),
    number: int = 1, by: str = "information", seed: int = 1, engine: Engine | None = None,
    progress: Callable[[Progress], None] = lambda update: None, group: str | None = None,
) -> Design:  # fmt: skip
    """Rank rows that could come next by the information that their readings are expected to give.

    Parameters
    ----------
    known : a result, whose posterior is built on, or a study, of which only the prior is used.
    about : parameters of interest; by default all that are free.
    slips : candidates, on the shearing radius; by default the driven range and a quarter of it beyond.
    loads : N or texts with a unit; by default the study's.
    wheels : of the study by name, files, or other wheels; by default the study's.
    channels : sensors to add, with their noise: ``"resistance_moment=0.15 N m"``.
    number : drives to choose together.
    by : ``information`` about the parameters of interest together, or the ``sd`` of each.
    seed : same seed, same ranking, whatever the engine.
    engine : judges the candidates: ``bt.local_pool()``, ``bt.dask_cluster("tcp://…")``; by default this
        process.
    progress : called as candidates are judged.
    group : of a joint posterior, whose drives are judged; by default one that was not tested. Where groups
        are wheels, one wheel that is given says it too.

    Raises
    ------
    StudyError : nothing is free, an unknown name, a load or slip that cannot be, or no answer anywhere.
    """
    check_kind("bt.recommend", known, Study, Result)
    check_seed(seed)
    question = design_request(
        known, about=about, slips=slips, loads=loads, wheels=wheels, channels=channels, number=number, by=by,
        seed=seed, group=group,
    )  # fmt: skip
    return choosing.choose(**vars(question), engine=engine, report=lambda estimates, update: progress(update))


def next_drive(study: Study, target: Posterior, draws: FloatArray, seed: SeedSequence) -> dict[str, Any] | None:
    """The drive that tells most by a regression on few draws, under half, the same and twice the load.

    Parameters
    ----------
    study, target : and its posterior.
    draws : some of its parameter sets (n, d).
    seed : of the readings that are drawn.

    Returns
    -------
    Wheel, load (N), slip on the shearing radius, expected gain about all parameters together (bits, a lower
    bound) with its Monte Carlo error, and the same for the best of the driven loads; None where none has an
    answer for enough draws, or readings of another drive have no law.
    """
    load, rng = reference_load(study), default_rng(seed)
    try:
        grid = candidates(study, loads=[0.5 * load, load, 2.0 * load])
        situation = Situation(study, target, draws, "posterior")
        interest = Interest(draws, tuple(range(draws.shape[1])))
        judged = [normal_estimate(pairs(readings_of(situation, each), interest, rng), interest) for each in grid]
    except StudyError:
        return None
    gains = np.nan_to_num([each.values[1] if each.answered > 1 - UNANSWERED else 0.0 for each in judged]) / BIT
    best = int(gains.argmax())
    if gains[best] <= 0:
        return None
    return {
        "wheel": grid[best].wheel[0], "load": float(grid[best].load[0]), "slip": float(grid[best].slip[0]),
        "bits": float(gains[best]), "error": float(judged[best].errors[1] / BIT), "candidates": len(grid),
        "same_load": float(gains[[each.load[0] == load for each in grid]].max()),
    }  # fmt: skip


def design_into(
    study_or_result: Result | Study,
    out: Path,
    *,
    engine: Engine | None = None,
    resume: bool = False,
    overwrite: bool = False,
    quiet: bool = False,
    watch: Callable[[Progress], None] = lambda update: None,
    **wishes: Any,
) -> Design:
    """Recommend the next drive for a result or a study, and write the folder ``out``.

    Every judged candidate is saved at once in ``<out>.part``; ``resume`` goes on from there. ``wishes``:
    keywords of :func:`design_request`. ``watch`` is called as candidates are judged.

    Raises
    ------
    ResultError : ``out`` exists (and ``overwrite`` is not given) or cannot be written; or there is an
        unfinished design, of something else or without ``resume``.
    StudyError : as :func:`recommend`.
    """
    from bayesterra.report.terminal import note, task_bar

    check_free(out, overwrite=overwrite, mark=Design.MARK)
    if isinstance(study_or_result, Result) and not study_or_result.converged:
        note("the sampling of this result has not converged: gains from its draws may be wrong")
    question = design_request(study_or_result, **wishes)
    folder = job_folder(out, mark=Design.MARK, kind=TASKS, resume=resume, overwrite=overwrite)
    with folder as (part, status):
        store = Checkpoints.opened(part / WORK, question.origin, TASKS)
        with task_bar("judging", "candidates", show=not quiet) as show:

            def update(estimates: Mapping[int, Estimate], progress: Progress) -> None:
                store.add({n: {**asdict(e), "replicates": e.replicates.tolist()} for n, e in estimates.items()})
                stage, done = f"judging for drive {progress.drive}", progress.done / progress.of
                status.note(stage, done, progress.seconds_left, steps=progress.judged)
                show(stage, progress.done, progress.of, progress.seconds_left, "")
                watch(progress)

            tasks = store.tasks().items()
            finished = {n: Estimate(**{**kept, "replicates": np.array(kept["replicates"])}) for n, kept in tasks}
            made = choosing.choose(**vars(question), engine=engine, finished=finished, report=update)
        made.write(part)
    return made
