"""The cut prior of a study as a problem for Sobol indices and Shapley effects.

The cut to where the model has answers makes parameters dependent: θ2 < θm < θ1 joins c1, c2 and c3;
N = n0 + n1 s > 0 joins n0 and n1; K_s = k_c/b + k_φ > 0 joins k_c and k_φ; and that the load must be carried
joins all bearing, shearing and contact parameters. Inputs that hold together what the first three join are
independent but for the last, whose share :class:`Coupling` tells. Nothing of it is approximated: partners
are drawn given what they share under the whole cut (:mod:`sensitivity.problems`).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, frozen
from bayesterra.errors import StudyError
from bayesterra.likelihood.forward import Forward
from bayesterra.likelihood.posterior import INSIDE, Posterior
from bayesterra.models import Conditions
from bayesterra.parameters import CHANNELS, MODULI, PARAMETERS, SIZES, SoilColumns
from bayesterra.study.drive import Drive
from sensitivity.groups import Setting
from sensitivity.problems import Problem

Inputs = dict[str, tuple[int, ...]]


@dataclass(frozen=True)
class Coupling:
    """What the cut joins.

    Attributes
    ----------
    inputs : name and columns of inputs that the rules for few parameters leave independent.
    refused : share of the stated prior that each of these rules refuses, by the rule.
    carrying : share of what they leave that cannot carry the load; it joins what ``inputs`` keep apart.
    """

    inputs: Inputs
    refused: Mapping[str, float]
    carrying: float


def cut_coupling(posterior: Posterior, rng: Generator, n: int = 20_000) -> Coupling:
    """Look at ``n`` draws of the stated prior for what the cut joins."""
    x = posterior.prior.sample(n, rng)
    rules = _rules(posterior, x)
    joined = [_columns(posterior, names) for names, broken in rules.values() if broken.any()]
    left = ~np.any([broken for _, broken in rules.values()], axis=0)
    beyond = posterior.reasons(x[left]) != INSIDE
    refused = {rule: float(broken.mean()) for rule, (_, broken) in rules.items()}
    return Coupling(_inputs(posterior, joined), refused, float(beyond.mean()) if left.any() else np.nan)


def _rules(posterior: Posterior, x: FloatArray) -> dict[str, tuple[tuple[str, ...], BoolArray]]:
    """Rules for few parameters, those they join, and which sets (n,) break them in some row."""
    soil, forward = posterior.prior.soil_values(x), posterior.likelihood.forward
    slip = forward.conditions.slip
    n0, n1, c1, c2, c3 = (soil[:, [SoilColumns[name]]] for name in ("n0", "n1", "c1", "c2", "c3"))
    ratio = c1 + c2 * slip
    angles = np.asarray(((ratio > c3) & (ratio < 1) & (c3 >= -1)).all(axis=1))
    exponents = np.asarray((n0 + n1 * slip * ("n1" not in forward.model.holds) > 0).all(axis=1))
    rules: dict[str, tuple[tuple[str, ...], BoolArray]] = {
        "θ2 < θm < θ1": (("c1", "c2", "c3"), ~angles),
        "n0 + n1 s > 0": (("n0", "n1"), ~exponents),
    }
    if posterior.prior.uses_moduli:
        kc, kphi = (soil[:, [SoilColumns[name]]] for name in MODULI)
        modulus = kc / forward.conditions.width + kphi
        rules["k_c/b + k_φ > 0"] = (MODULI, np.asarray(~(modulus > 0).all(axis=1)))
    return rules


def _columns(posterior: Posterior, names: Iterable[str]) -> set[int]:
    """Columns of x behind some parameters, fixed ones left out, tied ones by what they are tied to."""
    roots = {posterior.prior.root(name) for name in names}
    return {i for i, name in enumerate(posterior.names) if name in roots}


def _inputs(posterior: Posterior, joined: list[set[int]]) -> Inputs:
    """Every free soil parameter once: alone, or with those it is joined to."""
    blocks = [{column} for column in _soil_columns(posterior)]
    for group in joined:
        touched = [block for block in blocks if block & group]
        blocks = [block for block in blocks if not block & group] + ([set().union(*touched)] if touched else [])
    ordered = sorted(tuple(sorted(block)) for block in blocks)
    return {" + ".join(posterior.names[i] for i in block): block for block in ordered}


def _soil_columns(posterior: Posterior) -> list[int]:
    """Columns of x that an output can depend on."""
    return [i for i, name in enumerate(posterior.names) if not name.startswith(SIZES)]


def single_inputs(posterior: Posterior) -> Inputs:
    """Each free parameter by itself, dependent as the cut makes them."""
    return _inputs(posterior, [])


def group_inputs(posterior: Posterior) -> Inputs:
    """The parameter groups P_I (with k_c and k_φ), P_II and P_III; what belongs to none stands by itself."""
    found: dict[str, tuple[int, ...]] = {}
    for i in _soil_columns(posterior):
        name = posterior.names[i]
        group = "P_I" if name in MODULI else PARAMETERS[name].group or name
        found[group] = (*found.get(group, ()), i)
    return found


def study_problem(posterior: Posterior, inputs: Inputs, forward: Forward | None = None) -> Problem:
    """Outputs of ``forward``, or of the rows in the fit, over the cut prior of a study.

    The prior is cut to the support of the study and to where ``forward`` has an answer. Outputs are in field
    units, those of a row one after the other. A latent load is held at what its row knows best.

    Raises
    ------
    StudyError : the prior correlates parameters, which then cannot be drawn given each other's inputs.
    """
    if posterior.prior.correlated:
        names = ", ".join(posterior.names[i] for i in posterior.prior.correlated)
        raise StudyError(f"sensitivity indices need independent prior laws (got correlations of {names})")
    rows = forward or posterior.likelihood.forward
    scales, columns = _chosen(rows)

    def answer(x: FloatArray) -> tuple[FloatArray, BoolArray]:
        inside = posterior.reasons(x) == INSIDE
        values = np.full((len(x), len(rows.conditions.slip) * len(columns)), np.nan)
        if inside.any():
            outcomes = rows(posterior.prior.soil_values(x[inside]))
            values[inside] = (outcomes.values[:, :, columns] / scales).reshape(int(inside.sum()), -1)
            inside[inside] = outcomes.status == 0
        return values, inside

    return Problem(inputs, _outputs(rows), posterior.prior.sample, answer)


def forward_at(posterior: Posterior, setting: Setting) -> Forward:
    """The study's model, load-driven, under another wheel or load or at other slips."""
    conditions = Conditions.of(setting.wheel, setting.slips)
    given = frozen(np.full(len(setting.slips), setting.load))
    return Forward(posterior.likelihood.forward.model, Drive.LOAD, conditions, given)


def _chosen(rows: Forward) -> tuple[FloatArray, list[int]]:
    """Field units and columns of the outcomes that answer to the soil: in the drive ``both`` F_N does not."""
    idle = "normal_force" if rows.drive.latent_load else ""
    names = [name for name in rows.outcomes if name != idle]
    return np.array([CHANNELS[name].scale for name in names]), [rows.outcomes.index(name) for name in names]


def _outputs(rows: Forward) -> pd.DataFrame:
    """Outcome with its unit, slip, and what drives each row."""
    columns = _chosen(rows)[1]
    names = [f"{name} [{CHANNELS[name].unit}]" for name in np.array(rows.outcomes)[columns]]
    drive = CHANNELS["sinkage" if rows.drive.by_sinkage else "load"]
    return pd.DataFrame(
        {
            "row": np.repeat(np.arange(len(rows.given)) + 1, len(names)),
            "slip": np.repeat(rows.conditions.slip, len(names)),
            f"{drive.name} [{drive.unit}]": np.repeat(rows.given / drive.scale, len(names)),
            "output": names * len(rows.given),
        }
    )
