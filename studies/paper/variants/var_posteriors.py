"""Evidence and leave-one-out of the variants in the load drive."""

from __future__ import annotations

import pandas as pd
from paper_data import readings
from paper_posteriors import Found, infer
from var_fits import HIT, PRIORS, REFERENCE, VARIANTS, study_of

from bayesterra.checking.loo import difference

SIMULATED, SEED = "Wh32", 1
SETS = ((HIT, "M1"), (HIT, "M2"), (SIMULATED, "M2"))
"""Readings and model; the simulated ones are made by M1 as in (5) and (13), with full noise."""


def comparison(sets: tuple[tuple[str, str], ...] = SETS) -> pd.DataFrame:
    """Evidence and elpd of every variant less those of the paper's model on the same readings."""
    return pd.concat([_compared(data, model) for data, model in sets], ignore_index=True)


def posterior_of(data: str, model: str, variant: str) -> Found:
    """Posterior of one variant, load-driven; n ≥ 0."""
    table = None if data == HIT else readings(data, SEED)
    return infer(study_of(data, variant, data=table, model=model, priors=PRIORS))


def _compared(data: str, model: str) -> pd.DataFrame:
    found = {variant: posterior_of(data, model, variant) for variant in VARIANTS}
    first = found[REFERENCE]
    rows = []
    for variant, one in found.items():
        if one.loo is None or first.loo is None:
            raise ValueError("variants are compared by leave-one-out")
        away = difference(one.loo, first.loo)
        kind = "digitised" if data == HIT else "simulated, noise"
        rows.append(
            {
                "data": data, "kind": kind, "model": model, "variant": variant,
                "log_z": one.evidence.log_z, "log_z_error": one.evidence.error,
                "log_z_less": one.evidence.log_z - first.evidence.log_z,
                "elpd": one.loo.elpd, "elpd_less": away.elpd, "difference_se": away.se,
                "distinguishable": away.distinguishable,
                "reliable": one.evidence.reliable, "converged": one.converged,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)
