"""Which parameters can be determined together: collinearity of every subset of the sensitivities.

Brun, Reichert & Künsch 2001, Water Resour. Res. 37, 1015. With sensitivities s_j in units of the noise and of
the prior's standard deviations, and s̃_j = s_j / |s_j|, the collinearity index of a subset K of the parameters
is γ_K = 1 / √(smallest eigenvalue of S̃_Kᵀ S̃_K): what a change of one parameter does to the readings can be
made up for by the others but for a fraction 1 / γ_K. The importance of a parameter by itself is
δ_msqr = √(Σ s_j² / readings). Over several parameter sets the median of each figure is taken.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray, IntArray
from bayesterra.identifiability.local import SINGULAR, LocalAnalysis

CRITICAL = 15.0
"""Collinearity index above which a subset is not determined.

Usual thresholds lie between 10 and 20: 10 to 15 with Brun et al. (2001), 20 in the R package FME (Soetaert &
Petzoldt 2010, J. Stat. Softw. 33(3)).
"""
INFORMATIVE = 3.0
"""|s_j| from which a parameter counts as seen: the others known, a third of the prior's sd is left."""


@dataclass(frozen=True)
class Collinearity:
    """Collinearity indices of all subsets of two and more parameters.

    Attributes
    ----------
    names : the d free parameters.
    table : one row per subset, the most collinear of each size last: size, subset (names, joined by a blank),
        gamma (inf where a combination of its parameters changes no reading), highest (95 % of the sets are
        below).
    importance : one row per parameter: parameter, delta_msqr, length (|s_j|, prior sd over the sd that the
        readings alone would leave if all others were known).
    """

    names: tuple[str, ...]
    table: pd.DataFrame
    importance: pd.DataFrame

    def gamma(self, *names: str) -> float:
        """Index of the subset of these parameters."""
        subset = " ".join(name for name in self.names if name in names)
        return float(self.table.loc[self.table["subset"] == subset, "gamma"].iloc[0])

    def largest(self, critical: float = CRITICAL) -> tuple[str, ...]:
        """The largest determined subset: index up to ``critical``, each parameter seen (``INFORMATIVE``).

        The least collinear one where there are several; one parameter, or none, where no pair will do.
        """
        seen = set(self.importance.loc[self.importance["length"] >= INFORMATIVE, "parameter"])
        chosen = [set(subset.split()) <= seen for subset in self.table["subset"]]
        fine = self.table[np.array(chosen, dtype=bool) & (self.table["gamma"] <= critical)]
        if len(fine):
            best = fine[fine["size"] == fine["size"].max()].sort_values("gamma", kind="stable")
            return tuple(str(best["subset"].iloc[0]).split())
        top = self.importance.sort_values("length", ascending=False, kind="stable")["parameter"]
        return tuple(name for name in top[:1] if name in seen)


def collinearity(local: LocalAnalysis, sets: int = 200) -> Collinearity:
    """Collinearity at the parameter sets of a local analysis, ``sets`` of them evenly taken at most.

    There are 2^d − d − 1 subsets of d parameters.
    """
    chosen = np.unique(np.linspace(0, len(local.roots) - 1, sets).astype(int))
    lengths = np.sqrt((local.roots[chosen] ** 2).sum(axis=1))
    unit = local.roots[chosen] / np.where(lengths > 0, lengths, 1.0)[:, None]
    parts = [_of_size(local.names, unit, size) for size in range(2, len(local.names) + 1)]
    length = np.median(lengths, axis=0)
    importance = pd.DataFrame(
        {
            "parameter": list(local.names),
            "delta_msqr": length / np.sqrt(max(local.readings, 1)),
            "length": length,
        }
    )
    columns = ["size", "subset", "gamma", "highest"]
    table = pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)
    return Collinearity(local.names, table, importance)


def _of_size(names: Sequence[str], unit: FloatArray, size: int) -> pd.DataFrame:
    """Indices of all subsets of one size; ``unit`` (n, d, d) has columns of unit length."""
    chosen: IntArray = np.array(list(combinations(range(len(names)), size)), dtype=np.int64)
    gamma = collinearity_index(unit[:, :, chosen].transpose(0, 2, 1, 3))
    subsets = [" ".join(names[i] for i in subset) for subset in chosen]
    middle, highest = np.quantile(gamma, [0.5, 0.95], axis=0, method="higher")  # inf has no neighbours
    table = pd.DataFrame({"size": size, "subset": subsets, "gamma": middle, "highest": highest})
    return table.sort_values("gamma", kind="stable")


def collinearity_index(unit: FloatArray) -> FloatArray:
    """Index γ (...) of matrices (..., q, k) with columns of unit length; inf where they are dependent."""
    values = np.linalg.svd(unit, compute_uv=False)
    smallest = values[..., -1] if unit.shape[-2] >= unit.shape[-1] else np.zeros(unit.shape[:-2])
    dependent = smallest <= SINGULAR
    return np.asarray(np.where(dependent, np.inf, 1.0 / np.where(dependent, 1.0, smallest)))
