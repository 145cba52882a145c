"""The run of a study with a [pooling] table: joint posterior, both extremes, the verdict; one group alone."""

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.random import SeedSequence, default_rng
from pydantic import Field
from typing_extensions import TypedDict

from bayesterra.arrays import FloatArray
from bayesterra.errors import enumerated, known
from bayesterra.likelihood.joint import SPREAD, JointPosterior, draw_joint_prior, joint_posterior, name_in_group
from bayesterra.likelihood.posterior import posterior
from bayesterra.parameters import PARAMETERS
from bayesterra.pooling.degrees import (
    COMPLETE,
    DEGREE_COLUMNS,
    LEFT_OUT_COLUMNS,
    UNKNOWN,
    Degree,
    Evidences,
    Sharing,
    degrees_of,
    judged_alone,
    judged_as_stated,
    preferred,
)
from bayesterra.pooling.evidence import row_terms
from bayesterra.report.verdicts import Failures, Verdict, VerdictEntry, quotable, sampling_verdict, with_failures
from bayesterra.runtime.checkpoints import CheckpointStore
from bayesterra.runtime.netcdf import labelled_tree
from bayesterra.runtime.tables import Number
from bayesterra.sampling import sampler
from bayesterra.sampling.evidence import Weighted, against_nested, check_installed
from bayesterra.sampling.joint import JointSamples, PoolingOptions, sample_joint
from bayesterra.sampling.sampler import Progress, Samples, Target, ThinnedDraws, sample, thin
from bayesterra.sampling.summary import array_diagnosis, parameter_rows, summary_row
from bayesterra.stats.diagnostics import hdi
from bayesterra.study import result
from bayesterra.study.groups import law_sd
from bayesterra.study.study import Study

PRIOR_DRAWS = 1000
ALONE_DRAWS = 4000


Degrees = TypedDict(  # noqa: UP013 (as in the records that it is part of)
    "Degrees", {"pooling": str, "log_evidence": Number, "elpd_rows": Number, "elpd_groups": Number}
)
PoolingEntry = TypedDict(  # noqa: UP013
    "PoolingEntry", {"by": str, "preferred": str, "sentence": str, "degrees": list[Degrees]}
)


class PooledRecord(result.StudyRecord):
    """The content of ``run.json`` of a run with groups."""

    pooling: PoolingEntry
    verdicts: list[VerdictEntry] = Field(default_factory=list)
    untested: list[str] = Field(default_factory=list)


@dataclass(frozen=True, kw_only=True, repr=False)
class PooledResult(result.Result):
    """The outcome of a run with pooling; everything its report shows.

    Attributes
    ----------
    draws : xarray DataTree. ``posterior`` holds shared parameters without, the groups' own with the dimension
        ``group``, means and spreads of populations as ``K.mean``; ``alone`` each group's own posterior;
        ``prior`` the cut joint prior; SI, radians.
    summary : one row per parameter, ``c``, ``K.mean``, ``K[Wh11]``; ``mode`` is the densest draw.
    pooling : one row per degree of pooling: evidence, leave-one-out by row and by group.
    sharing : one row per parameter, and one for c and φ together: one value for all groups, or one for each?
        ``verdict`` from the groups' own posteriors, ``verdict_as_stated`` with all others as in the study.
    left_out : elpd of every row and of every group under every degree of pooling.
    """

    TABLES = ("summary", "pooling", "sharing", "left_out")
    RECORD = PooledRecord
    VIEW = "bayesterra.pooling.page:pooled"

    pooling: pd.DataFrame
    sharing: pd.DataFrame
    left_out: pd.DataFrame

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Verdicts on the sampling, with that of the posteriors beside it, and on fit and prediction."""
        sampling = sampling_verdict(self.record)
        others = self.record["verdict"]["compared_with"].items()
        if beside := [f"{name} pooling" if name == COMPLETE else name for name, good in others if not good]:
            said = f"{enumerated(beside)} did not converge"
            grade = "doubtful" if sampling.grade == "good" else sampling.grade
            claim = "; ".join(filter(None, (sampling.claim, said)))
            sampling = replace(sampling, grade=grade, sentence=f"{sampling.sentence} Beside it {said}.", claim=claim)
        return (sampling, *(Verdict(**entry) for entry in self.record.get("verdicts", ())[1:]))

    @property
    def sentence(self) -> str:
        """What may be quoted of the result."""
        groups = f"{len(self.groups)} groups, {', '.join(self.groups)}"
        return quotable(self.verdicts, groups, self.record.get("untested", ()))

    @property
    def groups(self) -> tuple[str, ...]:
        """Names of the groups."""
        return tuple(str(name) for name in self.draws["posterior"]["group"].to_numpy())

    @property
    def names(self) -> tuple[str, ...]:
        """All parameters: ``phi``, ``K.mean``, ``K.spread``, ``K[Wh11]``."""
        return tuple(map(str, self.summary["parameter"]))

    def values(self, group: str = "") -> FloatArray:
        """Draws of all parameters (n, d), of the group ``prior`` where that is asked for; SI, radians."""
        data, columns = self.draws[group or self.GROUP], []
        for name in self.names:
            base, _, own = name.removesuffix("]").partition("[")
            columns.append((data[base].sel(group=own) if own else data[base]).to_numpy().ravel())
        return np.column_stack(columns)

    def to_dataframe(self) -> pd.DataFrame:
        """Posterior draws, one row each: chain, draw, then a column per parameter, SI and radians."""
        chain, draw = (self.draws["posterior"].sizes[name] for name in ("chain", "draw"))
        index = {"chain": np.repeat(np.arange(chain), draw), "draw": np.tile(np.arange(draw), chain)}
        return pd.DataFrame({**index, **dict(zip(self.names, self.values().T, strict=True))})

    def of_group(self, group: str | None = None, *, wheel: str = "", seed: int = 1) -> result.Result:
        """Draws of the parameters that one group has, shared and own, as a result without groups.

        Parameters
        ----------
        group : name of a group; None for one that was not tested. Each draw of it has the shared values of a
            joint draw; hierarchical values come from the population with that draw's mean and spread,
            separate ones from their prior, as nothing tells more of them.
        wheel : name of the wheel that is meant: where groups are wheels, its group in place of None.
        seed : of the draws of a group that was not tested.

        Raises
        ------
        StudyError : there is no such group.
        """
        joint, rng = joint_posterior(self.study), default_rng(seed)
        if group is None and joint.pooling.by == "wheel" and wheel in self.groups:
            group = wheel
        if group is not None:
            known("group", group, self.groups)
        trees = {}
        for name in ("prior", "posterior"):
            data = self.draws[name].to_dataset()
            shared = _stacked(data, joint.shared_and_hyper)
            own = _stacked(data.sel(group=group), joint.local) if group else joint.draw_untested(shared, rng)
            chains = joint.of_group(shared, own).reshape(data.sizes["chain"], data.sizes["draw"], -1)
            trees[name] = result.parameter_dataset(joint.first.names, chains)
        return result.Result(
            study=self.study.of_group(group),
            draws=xr.DataTree.from_dict(trees),
            summary=pd.DataFrame([self._row(joint, name, group, trees) for name in joint.first.names]),
            record=self.record,
            basis=_basis(joint, group),
        )

    def _row(
        self, joint: JointPosterior, name: str, group: str | None, draws: Mapping[str, xr.Dataset]
    ) -> dict[str, Any]:
        """Row of the summary for a parameter of a group; values of one that was not tested have no mode."""
        if group is None and name not in joint.shared:
            chains, prior = draws["posterior"][name].to_numpy(), draws["prior"][name].to_numpy().ravel()
            return summary_row(PARAMETERS[name], chains, prior, np.nan, array_diagnosis(chains))
        whole = name if name in joint.shared else name_in_group(name, group or "")
        row = self.summary[self.summary["parameter"] == whole].iloc[0]
        return {**{str(column): value for column, value in row.items()}, "parameter": name}


def _basis(joint: JointPosterior, group: str | None) -> str:
    """Sentence on where the parameters of a group come from."""
    names = ", ".join(joint.groups)
    if group is not None:
        return f"parameters are those of {group} in the joint posterior of {names}"
    separate = [PARAMETERS[name].symbol for name in joint.local if name not in joint.populations]
    known = [PARAMETERS[name].symbol for name in joint.populations]
    drawn = [f"{', '.join(known)} drawn from the population of {names}"] if known else []
    drawn += [f"{', '.join(separate)} from the prior, as {names} tell nothing of another"] if separate else []
    return f"this {joint.pooling.by} was not tested: {'; '.join(drawn)}"


def run_pooled(
    study: Study,
    *,
    seed: int = 1,
    report: Callable[[Progress], None] = lambda progress: None,
    checkpoint_store: CheckpointStore | None = None,
    plan: PoolingOptions | None = None,
    crosscheck: bool = False,
) -> PooledResult:
    """Sample the joint posterior of a study with groups, and judge how far its parameters are shared.

    Beside the study's own roles two extremes are sampled: complete pooling, where all groups share every
    parameter, and none, every group alone under the stated prior.

    Parameters
    ----------
    seed, report, checkpoint_store, crosscheck : as for :func:`bayesterra.analysis.inference.run`.
    plan : size of the adaptation.
    """
    if crosscheck:
        check_installed()
    started = time.perf_counter()
    joint, family_streams = joint_posterior(study), SeedSequence(seed).spawn(6)
    sampling, whole, weighing, prior_stream, comparing, nesting = family_streams
    samples = sample_joint(joint, study.sampling, sampling, report, plan, checkpoint_store)
    asked = replace(study.sampling, target_ess=min(study.sampling.target_ess, 4000))
    failures = Failures(lambda title: report(Progress("checking", 1.0, step=title)))
    lone = (plan or PoolingOptions()).lone
    complete = failures.attempt(
        "complete", lambda: sample(Target.of(posterior(study)), asked, whole, report, lone, checkpoint_store)
    )
    report(Progress("comparing", 1.0))
    degrees: tuple[Degree, ...] = ()
    if complete is not None:
        degrees = failures.attempt(
            "degrees", lambda: degrees_of(joint, samples, complete, default_rng(weighing)), tuple[Degree, ...]
        )
    prior = draw_joint_prior(joint, PRIOR_DRAWS, default_rng(prior_stream))
    kept = thin(samples.chains)
    chains = {name: lone.chains for name, lone in samples.lone.items()}
    complete_level, stated_level, no_level = degrees or [UNKNOWN] * 3
    evidences = Evidences(joint, chains, default_rng(comparing), complete_level, stated_level, no_level)
    verdicts = failures.attempt("sharing", lambda: shared_or_not(evidences), tuple[Sharing, ...])
    stated = failures.attempt("sharing_as_stated", lambda: as_stated(evidences), dict[str, Sharing])
    summary = _summary(samples, kept, prior)
    lost = [degree.left_out for degree in degrees] or [pd.DataFrame(columns=LEFT_OUT_COLUMNS)]
    rows = [degree.row() for degree in degrees]
    table = pd.DataFrame(rows) if rows else pd.DataFrame(columns=DEGREE_COLUMNS)
    shares = _sharing_table(joint, verdicts, stated, kept)
    draws = _tree(study, joint, samples, kept, prior, failures)
    told = {
        "degrees": table.to_dict("records"),
        "preferred": preferred(degrees),
        "sentence": sentence(verdicts) if verdicts else "",
        "sentence_as_stated": sentence(tuple(stated.values())) if stated else "",
    }
    findings = {
        "verdict": _verdict(samples, complete),
        "pooling": {**joint.pooling.record(), "groups": list(joint.groups), **told},
        "sampling": {"moves": dict(samples.moves), "kept_one_step_in": kept.every},
    }
    if crosscheck:

        def against() -> dict[str, Any]:
            ours = Weighted.of_ensembles("bayesterra", samples.chains[:, :: kept.every], None)
            compared = against_nested(joint, ours, nesting, report=lambda stage: report(Progress(stage, 1.0)))
            return {"crosscheck": compared.record()}

        findings |= failures.attempt("crosscheck", against, dict[str, Any])
    seconds = {**samples.seconds, "total": time.perf_counter() - started}
    return PooledResult(
        study=study, draws=draws, summary=summary, pooling=table, sharing=shares,
        left_out=pd.concat(lost, ignore_index=True),
        record=with_failures(result.run_record(study, seed, findings, seconds), failures),
    )  # fmt: skip


def shared_or_not(evidences: Evidences) -> tuple[Sharing, ...]:
    """Judge for every parameter, and for c and φ together, whether all groups have one value."""
    names = evidences.joint.first.names
    sets = [[name] for name in names]
    if {"c", "phi"} <= set(names):
        sets.append(["c", "phi"])
    return tuple(judged_alone(evidences, chosen) for chosen in sets)


def as_stated(evidences: Evidences) -> dict[str, Sharing]:
    """Judge the parameters that each group has a value of, all others being as the study states them."""
    return {name: judged_as_stated(evidences, name) for name in evidences.joint.local}


def sentence(verdicts: Sequence[Sharing]) -> str:
    """All verdicts in one sentence."""
    clauses = []
    for word in dict.fromkeys(verdict.verdict for verdict in verdicts):
        named = [
            " and ".join(PARAMETERS[n].symbol for n in sharing.names) + (" together" if len(sharing.names) > 1 else "")
            for sharing in verdicts
            if sharing.verdict == word
        ]
        clauses.append(f"{word}: {', '.join(named)}")
    return "; ".join(clauses) + "."


def _sharing_table(
    joint: JointPosterior, verdicts: Sequence[Sharing], stated: Mapping[str, Sharing], kept: ThinnedDraws
) -> pd.DataFrame:
    rows = []
    for sharing in verdicts:
        row: dict[str, Any] = {
            "parameter": " and ".join(sharing.names),
            "role": ", ".join(dict.fromkeys(role(joint, name) for name in sharing.names)),
            "log_bayes_factor": sharing.log_factor,
            "against_own_values": sharing.against_own,
            "against_a_population": sharing.against_population,
            "error": sharing.error,
            "reliable": sharing.reliable,
            "verdict": sharing.verdict,
        }
        stated_sharing = stated.get(sharing.names[0]) if len(sharing.names) == 1 else None
        row |= {
            "log_bayes_factor_as_stated": stated_sharing.log_factor if stated_sharing else np.nan,
            "error_as_stated": stated_sharing.error if stated_sharing else np.nan,
            "reliable_as_stated": stated_sharing.reliable if stated_sharing else True,
            "verdict_as_stated": stated_sharing.verdict if stated_sharing else "",
        }
        spread = dict.fromkeys(("spread_median", "spread_hdi90_lo", "spread_hdi90_hi"), np.nan)
        if sharing.names[0] in joint.populations and len(sharing.names) == 1:
            name = sharing.names[0]
            values = kept.flat[:, joint.names.index(f"{name}.{SPREAD}")] / law_sd(joint.laws[name])
            low, high = hdi(values, 0.9)
            spread = {
                "spread_median": float(np.median(values)), "spread_hdi90_lo": low, "spread_hdi90_hi": high
            }  # fmt: skip
        rows.append({**row, **spread})
    return pd.DataFrame(rows) if rows else pd.DataFrame(columns=["parameter", "role", "verdict"])


def role(joint: JointPosterior, name: str) -> str:
    """``shared``, ``separate`` or ``hierarchical``."""
    if name in joint.shared:
        return "shared"
    return "hierarchical" if name in joint.populations else "separate"


def _summary(samples: JointSamples, kept: ThinnedDraws, prior: FloatArray) -> pd.DataFrame:
    densest = kept.flat[np.argmax(samples.joint.log_density(kept.flat))]
    quantities = [PARAMETERS[name] for name in samples.joint.names]
    return pd.DataFrame(parameter_rows(quantities, kept.chains, prior, densest, samples.diagnosis))


def _verdict(samples: JointSamples, complete: Samples | None) -> dict[str, Any]:
    """The joint sampling's verdict; those of the posteriors it is compared with beside it."""
    verdict = sampler.of_diagnosis(samples.diagnosis)
    beside = {COMPLETE: complete is not None and complete.diagnosis.converged}
    beside |= {f"{name} alone": lone.diagnosis.converged for name, lone in samples.lone.items()}
    return {**verdict, "compared_with": beside}


def _tree(
    study: Study,
    joint: JointPosterior,
    samples: JointSamples,
    kept: ThinnedDraws,
    prior: FloatArray,
    failures: Failures,
) -> xr.DataTree:
    names, rows = joint.first.names, study.observations
    spaced = [thin(lone.chains).spaced(ALONE_DRAWS) for lone in samples.lone.values()]
    alone = np.stack([x[: min(map(len, spaced))] for x in spaced])
    groups = {
        "posterior": _dataset(joint, kept.chains),
        "sample_stats": xr.Dataset(
            {
                "lp": (("chain", "draw"), joint.log_density(kept.flat).reshape(kept.chains.shape[:2])),
                **{name: (("chain", "draw"), values) for name, values in kept.labels.items()},
            }
        ),
        **failures.attempt(
            "log_likelihood",
            lambda: {"log_likelihood": row_likelihoods(joint, kept.chains, rows.used().rows)},
            dict[str, xr.Dataset],
        ),
        "prior": _dataset(joint, prior[None]),
        "alone": xr.Dataset(
            {name: (("group", "sample"), alone[:, :, i]) for i, name in enumerate(names)},
            coords={"group": list(joint.groups)},
        ),
        "observed_data": result.of_rows(result.observed_dataset(study), rows.use),
        "constant_data": result.of_rows(result.conditions_dataset(study), rows.use),
    }
    if not rows.use.all():
        groups["predictions_constant_data"] = result.left_out_dataset(study)
    return labelled_tree(groups)


def _dataset(joint: JointPosterior, chains: FloatArray) -> xr.Dataset:
    """Label draws (chain, draw, d): a variable per parameter, the groups' own with the dimension group."""
    variables: dict[str, Any] = {}
    for i, name in enumerate(joint.shared_and_hyper):
        variables[name] = (("chain", "draw"), chains[:, :, i])
    k, d = len(joint.shared_and_hyper), len(joint.local)
    for i, name in enumerate(joint.local):
        variables[name] = (("chain", "draw", "group"), chains[:, :, k + i :: d])
    dataset = xr.Dataset(variables, coords={"group": list(joint.groups)})
    for name in map(str, dataset.data_vars):
        quantity = PARAMETERS[name.split(".")[0]]
        unit = result.SI_UNITS.get(quantity.name, quantity.dimension or "1")
        dataset[name].attrs.update(units=unit, long_name=PARAMETERS[name].description)
    return dataset


def row_likelihoods(joint: JointPosterior, chains: FloatArray, order: Sequence[int]) -> xr.Dataset:
    """Log likelihood of every row in the fit, (chain, draw, row), in the table's order; all channels."""
    flat = chains.reshape(-1, chains.shape[2])
    terms, rows = [], []
    for x, density in zip(joint.values_of_groups(flat), joint.groups.values(), strict=True):
        terms.append(row_terms(density, x, np.ones(len(x), dtype=bool))[1])
        rows += list(density.likelihood.observations.rows)
    values = np.concatenate(terms, axis=1).reshape(*chains.shape[:2], -1)
    likelihoods = xr.Dataset({"readings": (("chain", "draw", "row"), values)}, coords={"row": rows})
    return likelihoods.sel(row=list(order))


def _stacked(data: xr.Dataset, names: tuple[str, ...]) -> FloatArray:
    """Values (n, k) of variables with chains and draws."""
    columns = [data[name].to_numpy().ravel() for name in names]
    return np.column_stack(columns) if columns else np.empty((data.sizes["chain"] * data.sizes["draw"], 0))
