"""The record of a run: what made the result, machine-readable and without personal paths."""

from __future__ import annotations

import platform
from datetime import UTC, datetime
from importlib.metadata import version
from typing import Any

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
        "title": study.title,
        "kind": study.kind,
        "source": study.source,
        "made": datetime.now(UTC).isoformat(timespec="seconds"),
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
        "machine": f"{platform.system()} {platform.machine()}",
        "seed": seed,
        "model": study.model.name,
        "drive": study.drive,
        "settings": {
            "target_ess": study.sampling.target_ess,
            "ensembles": study.sampling.ensembles,
            "walkers": study.sampling.walkers,
            "max_steps": study.sampling.max_steps,
        },
        "fingerprints": study.fingerprint,
        "notes": list(study.notes),
        "seconds": seconds,
        **findings,
    }
