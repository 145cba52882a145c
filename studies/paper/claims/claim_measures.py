"""What readings say of each parameter group: nats, directions, shifts, at three noises, about G1 and Table 10.

About a soil the posterior is taken as normal: prior and likelihood as normal laws, the prior with the covariance of the
flat prior ``paper-box`` after its physical cut, the likelihood with the derivatives of M1 at the soil. Sampled
posteriors of G1 (``posterior_directions``) stand beside it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from paper_data import LOAD, NOISE, OUTCOMES, SLIPS, SOILS, TRANSITION, study
from paper_wheels import WHEELS
from sensitivity.groups import REFERENCE, Setting
from sensitivity.responses import respond

import bayesterra as bt
from bayesterra.identifiability.analysis import identify
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.models import M1, Soil

FloatArray = NDArray[np.float64]
FREE = ("Ks", "n0", "n1", "c", "phi", "K", "c1", "c2")
GROUPS: Mapping[str, list[int]] = {"P_I": [0, 1, 2], "P_II": [3, 4, 5], "P_III": [6, 7]}
NOISES = (1.0, 0.5, 0.25)
"""Parts of 1 mm, 1.5 N and 0.3 N m."""
DETERMINED = 0.9
"""Contraction of the variance from which a direction counts as determined, as in studies/identifiability."""
SETTINGS: Mapping[str, tuple[Soil, str, tuple[float, float]]] = {
    "G1": (REFERENCE.soil, "Wh31", (0.15, 0.5)),
    **{wheel: (soil, wheel, TRANSITION) for wheel, soil in SOILS.items()},
}
"""Soil, wheel and transition slips: those of Section 4 for G1, of Section 5.2 for Table 10."""


@cache
def prior_covariance() -> FloatArray:
    """Covariance (8, 8) of the flat prior of Table 17's bounds after the physical cut at the slips of the tests."""
    blank = pd.DataFrame({"slip": SLIPS, "load [N]": LOAD, "sinkage [m]": 0.01, "drawbar_pull [N]": 0.0,
                          "resistance_moment [N m]": 0.0})  # fmt: skip
    density = posterior(study("Wh31", blank))
    x = draw_cut_prior(density, 4000, np.random.default_rng(1), batch=4096).x
    return np.asarray(np.cov(x.T))


@dataclass(frozen=True)
class Near:
    """Posterior near a soil as a normal law.

    Attributes
    ----------
    slopes : (8, 6, 3) derivatives of the outcomes in standard deviations of the full noise.
    """

    slopes: FloatArray

    def information(
        self, noise: float, channels: Sequence[int] = (0, 1, 2), rows: Sequence[int] | None = None
    ) -> FloatArray:
        """Fisher information (8, 8) of some channels and rows."""
        chosen = self.slopes[:, :, list(channels)]
        flat = (chosen if rows is None else chosen[:, list(rows)]).reshape(len(FREE), -1) / noise
        return np.asarray(flat @ flat.T)

    def covariance(
        self, noise: float, free: Sequence[int] = range(8), channels: Sequence[int] = (0, 1, 2)
    ) -> FloatArray:
        """Posterior covariance of some parameters with the others known."""
        ix = np.ix_(list(free), list(free))
        return np.linalg.inv(np.linalg.inv(_given(free)) + self.information(noise, channels)[ix])

    def nats(
        self, group: str, noise: float, channels: Sequence[int] = (0, 1, 2), free: Sequence[int] = range(8)
    ) -> float:
        """How much a group's block shrinks, nats: half the log ratio of the determinants, prior over posterior."""
        at = [list(free).index(i) for i in GROUPS[group]]
        block = np.ix_(at, at)
        prior, after = _given(free)[block], self.covariance(noise, free, channels)[block]
        return 0.5 * float(np.linalg.slogdet(prior)[1] - np.linalg.slogdet(after)[1])

    def contractions(self, group: str, noise: float, free: Sequence[int] = range(8)) -> FloatArray:
        """Contraction of the variance along the group's own directions, the best first."""
        at = [list(free).index(i) for i in GROUPS[group]]
        block = np.ix_(at, at)
        root = np.linalg.inv(np.linalg.cholesky(_given(free)[block]))
        left = np.linalg.eigvalsh(root @ self.covariance(noise, free)[block] @ root.T)
        return np.asarray(1 - left)

    def mutual(self, one: str, other: str, noise: float) -> float:
        """Mutual information between two groups in the posterior, nats."""
        after = self.covariance(noise)
        parts = [
            np.linalg.slogdet(after[np.ix_(i, i)])[1] for i in (GROUPS[one], GROUPS[other], GROUPS[one] + GROUPS[other])
        ]
        return 0.5 * float(parts[0] + parts[1] - parts[2])

    def sd(self, noise: float) -> FloatArray:
        """Posterior standard deviations (8,), SI."""
        return np.sqrt(np.diag(self.covariance(noise)))

    def shift(self, noise: float, held: Mapping[int, float]) -> FloatArray:
        """Shift of the free parameters, in their posterior sd, where some are held off the truth by so much."""
        free = [i for i in range(8) if i not in held]
        information = self.information(noise)
        after = self.covariance(noise, free)
        moved = -after @ information[np.ix_(free, list(held))] @ np.array(list(held.values()))
        out = np.zeros(8)
        out[free] = moved / np.sqrt(np.diag(after))
        return out


def _given(free: Sequence[int]) -> FloatArray:
    """Prior covariance of some parameters, the others at their values (as if independent of them)."""
    return prior_covariance()[np.ix_(list(free), list(free))]


@cache
def near(name: str) -> Near:
    """The normal law near G1 or the soil of a wheel."""
    soil, wheel, transition = SETTINGS[name]
    base, size = soil.as_array(), np.sqrt(np.diag(prior_covariance()))
    scale = np.array([NOISE[channel] for channel in OUTCOMES])
    setting, model = Setting(WHEELS[wheel], LOAD, SLIPS), M1(transition_slips=transition)
    slopes = []
    for i in range(len(FREE)):
        two = np.array([base, base])
        two[0, i] += 3e-4 * size[i]
        two[1, i] -= 3e-4 * size[i]
        values = respond(model, two, setting).values
        slopes.append((values[0] - values[1]) / (6e-4 * size[i]) / scale)
    return Near(np.array(slopes))


def groups() -> pd.DataFrame:
    """Nats by soil, noise, output and group, with the others unknown and known."""
    rows = []
    for name in SETTINGS:
        for noise in NOISES:
            for label, channels in (*((c, (i,)) for i, c in enumerate(OUTCOMES)), ("all", (0, 1, 2))):
                for group, members in GROUPS.items():
                    at = {"soil": name, "noise": noise, "output": label, "group": group}
                    unknown, known = (near(name).nats(group, noise, channels, f) for f in (range(8), members))
                    rows.append({**at, "unknown": unknown, "known": known})
    return pd.DataFrame(rows)


def directions() -> pd.DataFrame:
    """Contractions along the directions of each group, everything unknown, and how many are determined."""
    rows = []
    for name in SETTINGS:
        for noise in NOISES:
            for group in GROUPS:
                found = near(name).contractions(group, noise)
                words = " ".join(f"{v:.3f}" for v in found)
                rows.append({"soil": name, "noise": noise, "group": group, "contractions": words,
                             "determined": int((found >= DETERMINED).sum())})  # fmt: skip
    return pd.DataFrame(rows)


def mutual() -> pd.DataFrame:
    """Mutual information between groups."""
    pairs = (("P_I", "P_III"), ("P_II", "P_III"), ("P_I", "P_II"))
    return pd.DataFrame(
        [
            {"soil": name, "noise": noise, "pair": f"{a}, {b}", "nats": near(name).mutual(a, b, noise)}
            for name in SETTINGS for noise in NOISES for a, b in pairs
        ]
    )  # fmt: skip


def posterior_directions(noises: Sequence[float] = NOISES) -> pd.DataFrame:
    """The same contractions by sampled posteriors (``identify``) of G1 on Wh31, simulated readings with noise."""
    rows = []
    for noise in noises:
        made = identify(g1_study(noise), seed=1)
        table = made.found.information.directions
        rows.append(table[["scope", "view", "rank", "combination", "contraction"]].assign(noise=noise))
    return pd.concat(rows, ignore_index=True)


def g1_study(noise: float):
    """Simulated readings of G1 on Wh31 with a part of the noise, and a study that knows that noise."""
    soil, wheel, transition = SETTINGS["G1"]
    values = respond(
        M1(transition_slips=transition), soil.as_array()[None], Setting(WHEELS[wheel], LOAD, SLIPS)
    ).values[0]
    scale = noise * np.array([NOISE[channel] for channel in OUTCOMES])
    values = values + scale * np.random.default_rng(1).standard_normal(values.shape)
    table = pd.DataFrame(values, columns=["sinkage [m]", "drawbar_pull [N]", "resistance_moment [N m]"])
    table.insert(0, "slip", SLIPS)
    table.insert(1, "load [N]", LOAD)
    return bt.Study(
        table, {wheel: WHEELS[wheel]}, kind="simulated", slip_reference="shearing",
        title=f"G1 on Wh31, {noise} of the noise",
        noise={channel: noise * NOISE[channel] for channel in OUTCOMES}, priors={"set": "paper-box"},
        model_options={"transition_slips": list(transition)},
    )  # fmt: skip
