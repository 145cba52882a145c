"""Which parameter group moves which outcome: the words of the paper's Table 9, with a rule behind them.

The paper states no thresholds. Ours: the influence of a single change is the outcome's error figure (16)
against the reference per relative change of the parameter; that of a parameter group is the root mean square
over its single changes. With G1 to G22 and M1 the words of Table 9 are then in the order of the figures, and
the thresholds lie in the gaps between them; the one between "very large" and "large" has only 8 % of room.
Errors (16) themselves cannot be ranked so: P_I moves z by 28 % in the median ("very large"), P_II moves F_DP
by 48 % ("large").
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.models import SOIL_FIELDS, WheelSoilModel
from bayesterra.parameters import PARAMETERS
from sensitivity.groups import GROUPS, REFERENCE, SECTION_4, Group, Setting
from sensitivity.responses import OUTCOMES, error_figures, respond_groups

THRESHOLDS: Mapping[str, float] = MappingProxyType(
    {"very large": 1.2, "large": 0.5, "relatively large": 0.35, "small": 0.2, "very small": 0.0}
)
"""Least influence of each class: relative change of the outcome per relative change of the parameter."""

TABLE_9: Mapping[tuple[str, str], str] = MappingProxyType(
    {
        ("P_I", "sinkage"): "very large",
        ("P_I", "drawbar_pull"): "small",
        ("P_I", "resistance_moment"): "very small",
        ("P_II", "sinkage"): "very small",
        ("P_II", "drawbar_pull"): "large",
        ("P_II", "resistance_moment"): "large",
        ("P_III", "sinkage"): "small",
        ("P_III", "drawbar_pull"): "relatively large",
        ("P_III", "resistance_moment"): "very small",
    }
)
"""The printed classes, Ding et al. 2015, Table 9."""


def influence_class(influence: float) -> str:
    """The word for an influence, by ``THRESHOLDS``."""
    return next(word for word, least in THRESHOLDS.items() if influence >= least)


def relative_change(group: Group, reference: Group = REFERENCE) -> float:
    """|change| of the group's one parameter over its reference value; c3, which is 0 there, over that of c1.

    c3 and c1 are both shares of the entrance angle.
    """
    (name,) = group.varied
    i, c1 = SOIL_FIELDS.index(name), SOIL_FIELDS.index("c1")
    scale = reference.values[i] if reference.values[i] else reference.values[c1]
    return abs((group.values[i] - reference.values[i]) / scale)


def single_changes(groups: Sequence[Group] = tuple(GROUPS.values())) -> tuple[Group, ...]:
    """The groups in which one parameter differs from the reference: all but G1, G8, G9 and G16."""
    return tuple(group for group in groups if len(group.varied) == 1)


def influences(
    model: WheelSoilModel, groups: Sequence[Group] = single_changes(), setting: Setting = SECTION_4
) -> pd.DataFrame:
    """Influence and class of each parameter group on each outcome.

    One row per pair: parameter_group, outcome, influence, largest (of a single change), word, printed.
    """
    figures = _per_change(model, groups, setting)
    kinds = np.array([PARAMETERS[group.varied[0]].group for group in groups])
    rows = [
        (kind, outcome, *_summary(figures[kinds == kind, i]), TABLE_9[kind, outcome])
        for kind in dict.fromkeys(kinds.tolist())
        for i, outcome in enumerate(OUTCOMES)
    ]
    names = ["parameter_group", "outcome", "influence", "largest", "word", "printed"]
    return pd.DataFrame(rows, columns=names)


def _per_change(model: WheelSoilModel, groups: Sequence[Group], setting: Setting) -> FloatArray:
    """Error (16) per relative change of the parameter (n, 3)."""
    values = respond_groups(model, [REFERENCE, *groups], setting).values
    changes = np.array([relative_change(group) for group in groups])
    return np.asarray(error_figures(values[1:], values[0]) / changes[:, None])


def _summary(figures: FloatArray) -> tuple[float, float, str]:
    influence = float(np.sqrt(np.mean(figures**2)))
    return influence, float(figures.max()), influence_class(influence)
