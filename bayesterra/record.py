"""The record of a run: what made the result, machine-readable and without personal paths."""

from __future__ import annotations

import platform
from dataclasses import asdict
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

import numpy as np

from bayesterra.checkpoints import digest
from bayesterra.comparison import Standing
from bayesterra.diagnostics import Diagnosis
from bayesterra.identifiability import Identifiability
from bayesterra.identifiability.information import Information
from bayesterra.identifiability.structure import Structure
from bayesterra.identification import Fit
from bayesterra.identity import identity
from bayesterra.posteriors import INSIDE, REASONS, PriorDraws
from bayesterra.sampling.evidence import Evidence
from bayesterra.sampling.sampler import Samples
from bayesterra.study import Study

PACKAGES = ("bayesterra", "numpy", "scipy", "numba", "emcee", "arviz-base", "arviz-stats", "xarray")


def run_record(
    study: Study, seed: int, findings: dict[str, Any], seconds: dict[str, float]
) -> dict[str, Any]:
    """Put together the content of ``run.json``.

    Parameters
    ----------
    findings : verdicts and figures of the analysis.
    seconds : wall time by stage.
    """
    return {
        **_origin(study, seed),
        "settings": {
            "target_ess": study.sampling.target_ess,
            "ensembles": study.sampling.ensembles,
            "walkers": study.sampling.walkers,
            "max_steps": study.sampling.max_steps,
        },
        "seconds": seconds,
        **findings,
    }


def prior_record(study: Study, seed: int, support: dict[str, Any]) -> dict[str, Any]:
    """Put together the content of ``run.json`` of a prior without readings; ``support``: its physical cut."""
    return {**_origin(study, seed), "prior_only": True, "prior_support": support}


def _origin(study: Study, seed: int) -> dict[str, Any]:
    """What was run with what."""
    return {
        "title": study.title,
        "kind": study.kind,
        "source": study.source,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
        "machine": f"{platform.system()} {platform.machine()}",
        "seed": seed,
        "model": study.model.name,
        "drive": study.drive,
        "fingerprints": {**study.fingerprint, "run": digest(identity(study, seed))},
        "notes": list(study.notes),
        **({"priors_from": [one.record() for one in study.taken]} if study.taken else {}),
    }


def of_diagnosis(diagnosis: Diagnosis) -> dict[str, Any]:
    """The verdict on the sampling, with every threshold and value."""
    return {
        "converged": diagnosis.converged,
        "ess": diagnosis.ess,
        "r_hat": diagnosis.worst_r_hat,
        "checks": [asdict(check) for check in diagnosis.checks],
    }


def of_samples(samples: Samples, every: int) -> dict[str, Any]:
    """How the draws were made; ``every`` is the step between kept draws."""
    diagnosis, adaptations = samples.diagnosis, samples.adaptations
    return {
        "acceptance": diagnosis.acceptance,
        "steps": diagnosis.steps,
        "kept_one_step_in": every,
        "tau": dict(zip(samples.names, diagnosis.tau.tolist(), strict=True)),
        "temperatures": [len(adaptation.temperatures) - 1 for adaptation in adaptations],
        "proposal_efficiency": [adaptation.efficiency for adaptation in adaptations],
        "log_evidence": [adaptation.log_evidence for adaptation in adaptations],
    }


def of_evidence(found: Evidence, prior: PriorDraws) -> dict[str, Any]:
    """Log evidence under the stated prior, and the log share of that prior which physics leaves."""
    share = prior.shares[REASONS[INSIDE]]
    error = np.sqrt((1.0 - share) / (share * prior.tried))
    return {**asdict(found), "reliable": found.reliable, "log_share": np.log(share), "log_share_error": error}


def of_fit(fitted: Fit) -> dict[str, Any]:
    """How a least-squares fit ended."""
    return {
        "converged": fitted.converged,
        "passes": fitted.passes,
        "errors_percent": dict(fitted.errors),
        "held": list(fitted.held),
        "at_bound": list(fitted.at_bound),
        "missing": list(fitted.missing),
        "notes": list(fitted.notes),
    }


def of_standing(standing: Standing) -> dict[str, Any]:
    """Where a point estimate stands in the posterior."""
    return {
        "credible_level": standing.credible_level,
        "log_density": standing.log_density if np.isfinite(standing.log_density) else None,
        "word": standing.word,
        "at_bound": list(standing.at_bound),
        "filled": list(standing.filled),
        "values": dict(standing.values),
    }


def of_directions(found: Identifiability, seen: Structure, added: Information) -> dict[str, Any]:
    """How many independent directions the data determine, of each group too, and what the design cannot."""
    columns = ["scope", "view", "directions", "determined", "effective", "cut_effective"]
    return {
        "determined": found.determined,
        "of": len(found.contractions),
        "contractions": found.contractions.tolist(),
        "groups": added.counts[columns].to_dict("records"),
        "unseen": [null.words for null in seen.nulls],
    }
