"""One group of a joint posterior as a result of its own: a wheel that was driven, or one that was not."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import xarray as xr
from numpy.random import Generator, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, did_you_mean
from bayesterra.likelihood.joint import JointPosterior, joint_posterior
from bayesterra.parameters import PARAMETERS
from bayesterra.pooling.run import PooledResult
from bayesterra.study.result import Result, parameter_dataset
from bayesterra.study.study import Study


def group_result(result: PooledResult, group: str | None = None, *, seed: int = 1) -> Result:
    """Draws of the parameters that one group has, shared and own, as a result without groups.

    Parameters
    ----------
    result : of a study with a [pooling] table.
    group : name of a group; None for one that was not tested. Each draw of it has the shared values of a
        joint draw; hierarchical values come from the population with that draw's mean and spread, separate
        ones from their prior, as nothing tells more of them.
    seed : of the draws of a group that was not tested.

    Raises
    ------
    StudyError : there is no such group.
    """
    groups, by = result.groups, _by(result)
    if group is not None and group not in groups:
        raise StudyError(f"unknown group '{group}'{did_you_mean(group, groups)}")
    joint, rng = joint_posterior(result.study), default_rng(seed)
    trees = {}
    for name in ("posterior", "prior"):
        data = result.draws[name].to_dataset()
        shared = _stacked(data, joint.shared_and_hyper)
        own = _stacked(data.sel(group=group), joint.local) if group else _new_values(joint, shared, rng)
        x = joint.of_group(shared, own)
        chains = x.reshape(data.sizes["chain"], data.sizes["draw"], -1)
        trees[name] = parameter_dataset(joint.first.names, chains)
    study = _alone(result.study, by, group)
    kept = ("parameter", "unit")
    summary = result.summary[[column for column in kept if column in result.summary]].iloc[:0]
    return Result(study=study, draws=xr.DataTree.from_dict(trees), summary=summary, record=result.record)


def basis(result: PooledResult, group: str | None) -> str:
    """Sentence on where the parameters of a group's result come from."""
    names = ", ".join(result.groups)
    if group is not None:
        return f"parameters are those of {group} in the joint posterior of {names}"
    joint = joint_posterior(result.study)
    separate = [PARAMETERS[name].symbol for name in joint.local if name not in joint.populations]
    known = [PARAMETERS[name].symbol for name in joint.populations]
    drawn = [f"{', '.join(known)} drawn from the population of {names}"] if known else []
    drawn += [f"{', '.join(separate)} from the prior, as {names} tell nothing of another"] if separate else []
    return f"this {_by(result)} was not tested: {'; '.join(drawn)}"


def _by(result: PooledResult) -> str:
    """The column that says which group a row belongs to."""
    assert result.study.pooling is not None  # noqa: S101 - a result with groups has them
    return result.study.pooling.by


def _stacked(data: xr.Dataset, names: tuple[str, ...]) -> FloatArray:
    """Values (n, k) of variables with chains and draws."""
    columns = [data[name].to_numpy().ravel() for name in names]
    return np.column_stack(columns) if columns else np.empty((data.sizes["chain"] * data.sizes["draw"], 0))


def _new_values(joint: JointPosterior, shared: FloatArray, rng: Generator) -> FloatArray:
    """Values (n, d) of a group that was not tested, inside the physical ranges where the prior has any."""
    own = joint.draw_group(shared, rng)
    for _ in range(1000):
        outside = np.flatnonzero(~np.isfinite(joint.first.log_prior(joint.of_group(shared, own))))
        if not outside.size:
            break
        own[outside] = joint.draw_group(shared[outside], rng)
    return own


def _alone(study: Study, by: str, group: str | None) -> Study:
    """The study without groups, of the rows of one of them or of all."""
    alone = copy(study)
    object.__setattr__(alone, "pooling", None)
    if group is None:
        return alone
    mine = np.array([label == group for label in study.observations.label(by)])
    rows = study.observations.take(mine)
    wheels = {name: wheel for name, wheel in study.wheels.items() if name in rows.wheel}
    object.__setattr__(alone, "wheels", wheels)
    return alone.with_rows(replace(rows, notes=()))
