"""The paper's claims, each beside a measure and a threshold; the verdict follows from these two alone.

``sentences.csv`` has what is claimed and what would confirm it; here stands how each figure is taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
from claim_measures import DETERMINED, GROUPS, NOISES, SETTINGS, FloatArray, near
from paper_data import FORCES, printed

HERE = Path(__file__).parent
Kept = Mapping[str, pd.DataFrame]
CONFIRMED, REFUTED, OPEN = "confirmed", "refuted", "not decided"
VERY_LARGE, LARGE, LITTLE = 5.0, 2.5, 1.0
"""Nats about a group with the others known: 'very large' and 'large' from, 'very small' up to."""
CHANNEL = {"z": 0, "F_DP": 1, "M_DR": 2}
G1 = near("G1")
WHEELS = tuple(name for name in SETTINGS if name != "G1")
WORDS = {
    "z, P_I": "very large", "z, P_II": "very small", "z, P_III": "small",
    "F_DP, P_I": "small", "F_DP, P_II": "large", "F_DP, P_III": "relatively large",
    "M_DR, P_I": "very small", "M_DR, P_II": "large", "M_DR, P_III": "very small",
}  # fmt: skip
"""Table 9."""
RANGES = {
    "very large": (VERY_LARGE, np.inf), "large": (LARGE, np.inf), "relatively large": (LARGE, np.inf),
    "small": (0.0, LARGE), "very small": (0.0, LITTLE),
}  # fmt: skip
Measure = Callable[[float], tuple[str, str]]


@dataclass(frozen=True)
class Found:
    """Figures at the full, half and quarter noise, or one where noise plays no part; a verdict for each."""

    measured: tuple[str, ...]
    words: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """One word, or the word at each noise."""
        if len(set(self.words)) == 1:
            return self.words[0]
        names = ("full", "half", "quarter")
        return "; ".join(f"{name}: {word}" for name, word in zip(names, self.words, strict=True))


def by_noise(measure: Measure) -> Found:
    """A figure at every noise."""
    found = [measure(noise) for noise in NOISES]
    return Found(tuple(text for text, _ in found), tuple(word for _, word in found))


def word(holds: bool) -> str:
    """The verdict where it is one or the other."""
    return CONFIRMED if holds else REFUTED


def nats(output: str, group: str, noise: float) -> tuple[float, float]:
    """Nats of an output on a group about G1: the other groups unknown, and known."""
    one = (CHANNEL[output],)
    return G1.nats(group, noise, one), G1.nats(group, noise, one, GROUPS[group])


def says(output: str, group: str, low: float, high: float) -> Measure:
    """What an output says of a group, between two limits if the others are known."""

    def measure(noise: float) -> tuple[str, str]:
        unknown, known = nats(output, group, noise)
        return f"{unknown:.1f} ({known:.1f}) nats", word(low <= known < high)

    return measure


def each(group: str, noise: float, *, known: bool) -> dict[str, float]:
    """Nats of every output on a group."""
    return {output: nats(output, group, noise)[known] for output in CHANNEL}


def told(values: Mapping[str, float], digits: int = 1) -> str:
    """Names with their figures."""
    return ", ".join(f"{name} {value:.{digits}f}" for name, value in values.items()) + " nats"


def contractions(group: str, noise: float) -> FloatArray:
    """Contractions (7, k) along the directions of a group, G1 and the six wheels."""
    return np.array([near(name).contractions(group, noise) for name in SETTINGS])


def span(values: FloatArray, digits: int = 2) -> str:
    """Lowest and highest value."""
    return f"{np.min(values):.{digits}f} to {np.max(values):.{digits}f}"


def everything(noise: float) -> tuple[str, str]:
    """Determined directions of all groups about G1."""
    found = [int((G1.contractions(group, noise) >= DETERMINED).sum()) for group in GROUPS]
    return f"{sum(found)} of 8 ({', '.join(map(str, found))} of P_I, P_II, P_III)", word(sum(found) < 8)


def pull_most(noise: float) -> tuple[str, str]:
    """What F_DP says of each group."""
    found = {group: nats("F_DP", group, noise)[1] for group in GROUPS}
    return told(found), word(max(found, key=found.__getitem__) == "P_II")


def bearing(noise: float) -> tuple[str, str]:
    """What each output says of P_I."""
    found = each("P_I", noise, known=True)
    return told(found), word(found["z"] > 1.5 * max(found["F_DP"], found["M_DR"]))


def two_bearing(noise: float) -> tuple[str, str]:
    """Determined directions of P_I."""
    found = contractions("P_I", noise)
    counts = (found >= DETERMINED).sum(axis=1)
    return f"{counts.min()} to {counts.max()} of 3; the third {span(found[:, -1])}", word(set(counts) == {2})


def fixed(noise: float) -> tuple[str, str]:
    """What holding K_s does to n0."""
    free, held = G1.sd(noise)[1], np.sqrt(G1.covariance(noise, range(1, 8))[0, 0])
    return f"sd of n0 {free:.2f}, with K_s held {held:.3f}", word(held > 0.5 * free)


def slips(noise: float) -> tuple[str, str]:
    """Where c and K are told."""
    early, late = (np.diag(G1.information(noise, (1, 2), rows)) for rows in ([0, 1, 2], [3, 4, 5]))
    c, k = late[3] / (early + late)[3], early[5] / (early + late)[5]
    text = f"of c {100 * c:.0f} % at slips 0.3 to 0.6, of K {100 * k:.0f} % at 0 to 0.2"
    return text, word(min(c, k) > 0.5)


def shearing(noise: float) -> tuple[str, str]:
    """The third direction of P_II."""
    third = contractions("P_II", noise)[:, -1]
    return f"it contracts by {span(third)}", word(third.max() < DETERMINED)


def least(noise: float) -> tuple[str, str]:
    """All outputs on each group."""
    found = {group: G1.nats(group, noise) for group in GROUPS}
    return told(found), word(found["P_III"] < 0.5 * min(found["P_I"], found["P_II"]))


def most_on_pull(noise: float) -> tuple[str, str]:
    """What each output says of P_III."""
    found = each("P_III", noise, known=False)
    return told(found, 2), word(max(found, key=found.__getitem__) == "F_DP")


def typical(noise: float) -> tuple[str, str]:
    """Shifts where c2 is held at 0."""
    moved = np.abs(G1.shift(noise, {7: 0.3}))
    text = ", ".join(f"{name} {moved[i]:.1f}" for name, i in (("n0", 1), ("n1", 2), ("c", 3), ("φ", 4), ("c1", 6)))
    return f"{text} sd", word(moved.max() < 1)


def given_shear(noise: float) -> tuple[str, str]:
    """What F_DP says of P_I and P_III with P_II known."""
    free = GROUPS["P_I"] + GROUPS["P_III"]
    found = {group: G1.nats(group, noise, (1,), free) for group in ("P_I", "P_III")}
    return told(found, 2), word(found["P_III"] > found["P_I"])


def order(noise: float) -> tuple[str, str]:
    """Which output says most of each group."""
    found = {group: {o: nats(o, group, noise)[0] for o in CHANNEL} for group in GROUPS}
    best = [max(values, key=values.__getitem__) for values in found.values()]
    return ", ".join(f"{g} {b}" for g, b in zip(GROUPS, best, strict=True)), word(best == ["z", "M_DR", "F_DP"])


def accuracy(noise: float) -> tuple[str, str]:
    """Posterior sds of c and φ."""
    sd = np.array([near(name).sd(noise) for name in WHEELS])
    c, phi = sd[:, 3] / 1e3, np.degrees(sd[:, 4])
    return f"sd of c {span(c)} kPa, of φ {span(phi, 1)}°", word(bool(c.max() < 0.1 and phi.max() < 2))


def held_sd(name: str, noise: float) -> FloatArray:
    """Posterior sds (8,) with K_s held."""
    return np.append(0.0, np.sqrt(np.diag(near(name).covariance(noise, range(1, 8)))))


def lugs(noise: float) -> tuple[str, str]:
    """How many differences between wheels with other lugs are told."""
    table, count, names = printed(10), {}, ("Ks", "n0", "n1", "c", "phi", "K")
    scales = {"c": 1e3, "phi": float(np.radians(1)), "K": 1e-3}
    for name, sign in {"n0": -1, "n1": 1, "c": -1, "phi": 1, "K": 1}.items():
        count[name] = 0
        for a, b in (("Wh11", "Wh12"), ("Wh21", "Wh22"), ("Wh31", "Wh32")):
            both = np.hypot(held_sd(a, noise), held_sd(b, noise))[names.index(name)]
            away = sign * float(table.loc[a, name] - table.loc[b, name]) * scales.get(name, 1.0)
            count[name] += int(away > 2 * both)
    text = ", ".join(f"{'φ' if n == 'phi' else n} {c}" for n, c in count.items())
    return f"{text} of 3 told", CONFIRMED if sum(count.values()) == 15 else OPEN


def steady(noise: float) -> tuple[str, str]:
    """Posterior sd of K."""
    sd = 1e3 * np.array([held_sd(name, noise)[5] for name in WHEELS])
    return f"sd of K {span(sd, 1)} mm", REFUTED if 2 * np.sqrt(2) * sd.max() < 13.8 - 10.1 else OPEN


def insensitive(noise: float) -> tuple[str, str]:
    """What knowing c1 and c2 does to φ."""
    free, held = (float(np.degrees(np.sqrt(c[4, 4]))) for c in (G1.covariance(noise), G1.covariance(noise, range(6))))
    return f"sd of φ {free:.1f}°, {held:.1f}° with them known", word(held > 0.8 * free)


def angles_of(kept: Kept) -> Measure:
    """Determined directions of P_III, about seven soils and as sampled for G1."""

    def measure(noise: float) -> tuple[str, str]:
        found = contractions("P_III", noise)
        counts = (found >= DETERMINED).sum(axis=1)
        text = f"{counts.min()} to {counts.max()} of 2 ({span(found[:, 0])}; {span(found[:, 1])})"
        sampled = kept["posterior-directions"].query("noise == @noise and scope == 'P_III' and view == 'marginal'")[
            "contraction"
        ]
        beside = f"; sampled G1 {', '.join(f'{v:.2f}' for v in sampled)}" if len(sampled) else ""
        return text + beside, word(set(counts) == {2})

    return measure


def model_error(kept: Kept, model: str) -> Found:
    """Where the posterior mode of another model lies on noise-free readings of M1."""
    table = kept["model-errors"].query("model == @model and Ks_held")
    phi, c = (table.query("parameter == @name")["mode"].to_numpy() for name in ("phi", "c"))
    misfit = table[["misfit_sinkage", "misfit_drawbar_pull", "misfit_resistance_moment"]].max().max()
    text = f"fits within {misfit:.2f} sd of the noise, yet φ is {span(-phi, 1)} sd too low, c {span(c, 1)} too high"
    return Found((text,), (word(bool(max(-phi.min(), c.max()) < 1)),))


def evidence(kept: Kept, variant: str) -> Found:
    """Log evidence of a variant less that of the paper's model, by readings and model."""
    table = kept["variants-comparison"].query("variant == @variant")
    less = table["log_z_less"]
    text = ", ".join(f"{r['data']} {r['model']} {r['log_z_less']:+.1f}" for r in table.to_dict("records"))
    verdict = CONFIRMED if (less < -3).all() else OPEN if (less < -3).any() else REFUTED
    return Found((text,), (verdict,))


def of_starts(kept: Kept) -> Found:
    """The c that IM1 returns by the paper's solver from several starts."""
    table = kept["solver-starts"].query("solver == 'lsqcurvefit' and parameter == 'c' and data == 'Wh11'")
    ends = table.set_index("start")["c"]
    text = "Wh11, true c 0.103: " + ", ".join(f"{ends[s]:.2f} from {s:g}" for s in (0.05, 0.2, 1.0, 3.0)) + " kPa"
    return Found((text,), (word(bool(np.ptp(ends) < 0.05)),))


def of_stiffness(kept: Kept) -> Found:
    """Posterior sd of K_s, and where the paper's solver leaves it."""
    sd = kept["posteriors"].query("parameter == 'Ks' and model == 'M1' and drive == 'load'")["sd"] / (
        9900 / np.sqrt(12)
    )
    ends = kept["solver-starts"].query("solver == 'lsqcurvefit' and parameter == 'Ks' and data == 'Wh11'")
    where = ", ".join(f"{r['Ks']:.0f} from {r['start']:g}" for r in ends.to_dict("records"))
    text = f"sd {span(sd.to_numpy())} of the prior's; that it ends at its start is the solver's: {where}"
    return Found((text,), (word(bool((sd > 0.9).all())),))


def of_passes(kept: Kept) -> Found:
    """Last changes of IM1 with the paper's tolerance."""
    import im_fits

    table = im_fits.stops(kept["paths"]).query("delta == 0.002 and data != 'HIT'")
    found = {name: table[f"last_change_{name}"].max() for name in ("c", "phi", "K")}
    text = ", ".join(f"{'φ' if n == 'phi' else n} up to {v:.1f} %" for n, v in found.items())
    return Found((text,), (word(max(found.values()) < 10),))


def of_products(kept: Kept) -> Found:
    """Straight products (22) beside straight stresses (20)."""
    away = kept["straight-lines"].query("case != 'exponent'")["products"].abs()
    text = f"median {away.median():.2f} %, below 1 % in {(away < 1).sum()} of {len(away)}, at most {away.max():.1f} %"
    return Found((text,), (word(bool((away < 1).mean() > 0.5)),))


def of_lines(kept: Kept) -> Found:
    """Straight stresses beside (4), by exponent."""
    table = kept["straight-lines"].query("case == 'exponent'")
    text = ", ".join(f"N = {r['N']:g}: {r['lines']:+.0f} %" for r in table.to_dict("records"))
    return Found((text,), (word(bool((table["lines"].abs() < 10).all())),))


def of_omission(kept: Kept) -> Found:
    """Share of IM3's deviation that F_Nτ makes, by solver."""
    true, shares = printed(10)["phi"], {}
    fits = kept["solver-fits"].query("solver == 'lsqcurvefit' and method == 'IM3'").set_index("data")["phi"]
    other = kept["fits"].query("method == 'IM3' and Ks_held").set_index("data")["phi"]
    for name, at, table in (("paper's solver", fits, "solver-without-shear"), ("converged", other, "without-shear")):
        without = kept[table].set_index("data")["phi"].loc[true.index]
        shares[name] = float(((without - at.loc[true.index]) / (true - at.loc[true.index])).mean())
    text = ", ".join(f"{100 * v:.0f} % ({n})" for n, v in shares.items())
    above = [v > 0.5 for v in shares.values()]
    return Found((text,), (CONFIRMED if all(above) else OPEN if any(above) else REFUTED,))


def of_models(kept: Kept) -> Found:
    """Evidence of M2 and M3 beside M1."""
    less = kept["comparison"].query("model != 'M1'")["log_z_less_M1"].to_numpy()
    fits = kept["solver-fits"].query("data != 'HIT' and solver == 'lsqcurvefit'")
    worst = fits[[f"error_{name}" for name in FORCES]].max().max()
    text = f"log evidence {np.min(less):+.1f} to {np.max(less):+.1f}; every fit error below {worst:.1f} %"
    return Found((text,), (word(bool(np.abs(less).max() < 3)),))


def of_ranking(kept: Kept) -> Found:
    """Bias of φ by model."""
    low = {m: -kept["model-errors"].query("model == @m and Ks_held and parameter == 'phi'")["mode"] for m in MODELS}
    text = ", ".join(f"{m} {span(v.to_numpy(), 1)}" for m, v in low.items()) + " sd too low"
    top = [v.max() for v in low.values()]
    return Found((text,), (word(top[0] < low["M2"].min() and top[1] < low["M3"].min()),))


MODELS = ("M1", "M2", "M3")
MANY_WHEELS = (
    "one c and φ by 6.1 where true, refused by 217 where not; K each wheel's own by 255; n0, c1, c2, K_s"
    " cannot be told: many-wheels, simulated with a fifth of the noise; the paper's readings are unpublished"
)
HOLDOUT = "yes on readings that M1 makes; on the CMU wheel 5 of 13 sinkages and 8 of 13 pulls (misfit/leave-slip-out)"


def found(kept: Kept) -> dict[str, Found]:
    """The figures of every claim of ``sentences.csv`` by id, and of the nine words of Table 9."""
    least_of = {"bearing-moment": ("M_DR", "P_I"), "shear-depth": ("z", "P_II"), "angle-moment": ("M_DR", "P_III")}
    pull = kept["sensitivity"].set_index("statement").loc["F_DPτ is influenced by P_II only", "ours"]
    noisy = {
        "all": everything, "pull-most": pull_most, "bearing": bearing, "two-bearing": two_bearing, "fixed": fixed,
        "slips": slips, "shearing": shearing, "least": least, "most-on-pull": most_on_pull, "typical": typical,
        "given-shear": given_shear, "angles": angles_of(kept), "order": order, "accuracy": accuracy, "lugs": lugs,
        "steady": steady, "insensitive": insensitive,
        **{name: says(*pair, 0.0, LITTLE) for name, pair in least_of.items()},
        **{name: says(*name.split(", "), *RANGES[asked]) for name, asked in WORDS.items()},
    }  # fmt: skip
    plain = {
        "no-shear": model_error(kept, "M3"), "im2": model_error(kept, "M2"),
        "pull-shear": Found((str(pull),), (REFUTED,)), "redundant": of_stiffness(kept), "start": of_starts(kept),
        "together": of_passes(kept), "products": of_products(kept), "lines": of_lines(kept),
        "constant": evidence(kept, "constant n"), "rim": evidence(kept, "R_j = r"), "tip": evidence(kept, "R_j = R"),
        "omission": of_omission(kept), "models": of_models(kept), "ranking": of_ranking(kept),
        "soil": Found((MANY_WHEELS,), (OPEN,)), "ensured": Found((HOLDOUT,), (OPEN,)),
    }  # fmt: skip
    return {**{name: by_noise(measure) for name, measure in noisy.items()}, **plain}


def table(kept: Kept) -> pd.DataFrame:
    """Every claim with its figures and verdict, in the order of the paper."""
    said = pd.read_csv(HERE / "sentences.csv", keep_default_na=False).to_dict("records")
    nine = [
        {
            "id": name, "section": "Table 9", "claim": "influence of {1} on {0}: {2}".format(*name.split(", "), asked),
            "shown": "Tables 6 to 8, one soil and wheel",
            "threshold": f"{low:g} nats or more known" if high == np.inf else f"less than {high:g} nats known",
        }
        for name, asked in WORDS.items() for low, high in [RANGES[asked]]
    ]  # fmt: skip
    at = 1 + next(i for i, row in enumerate(said) if row["id"] == "order")
    figures, rows = found(kept), []
    for row in [*said[:at], *nine, *said[at:]]:
        one = figures[row["id"]]
        full, half, quarter = one.measured * (3 if len(one.measured) == 1 else 1)
        noise = {"full": full, "half": half, "quarter": quarter, "by_noise": len(one.measured) > 1}
        rows.append({**row, **noise, "verdict": one.verdict})
    return pd.DataFrame(rows)
