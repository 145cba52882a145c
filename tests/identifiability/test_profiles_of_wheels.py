"""Profiles of real models against random search, and what they say of studies whose answer is known."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayesterra.analysis.simulation import simulate
from bayesterra.arrays import FloatArray
from bayesterra.identifiability.profiles import Profile, Profiles, profiles
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.models import Wheel
from bayesterra.stats.laws import Law
from bayesterra.study.noise import Noise
from bayesterra.study.priors import Tie
from bayesterra.study.study import Study

WHEEL = Wheel(0.15735, 0.165, 0.010, 30, 0.65)
WIDE = Wheel(0.15735, 0.280, 0.010, 30, 0.65)
TRUTH = {
    "Ks": 1.5e6, "n0": 0.8, "n1": 0.6, "c": 900.0, "phi": 0.52, "K": 0.012, "c1": 0.35, "c2": 0.2,
}  # fmt: skip
SLIPS = (0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6)
CHANNELS = {"sinkage": "m", "normal_force": "N", "drawbar_pull": "N", "resistance_moment": "N m"}
NOISE = {"sinkage": 2e-4, "normal_force": 0.5, "drawbar_pull": 0.3, "resistance_moment": 0.05}


def study_of(
    *, drive: str = "load", slips: tuple[float, ...] = SLIPS, wheels: tuple[Wheel, ...] = (WHEEL,),
    noise: Any = None, priors: Any = None, truth: Any = None, **options: Any,
) -> Study:  # fmt: skip
    """A study on data simulated from ``TRUTH`` with M1; priors other than the paper's box as given."""
    names = [f"wheel{i}" for i in range(len(wheels))]
    table = pd.DataFrame({"wheel": np.repeat(names, len(slips)), "slip": np.tile(slips, len(wheels))})
    if drive == "load":
        table["load [N]"] = 80.0
    outcomes = [name for name in CHANNELS if not (drive == "load" and name == "normal_force")]
    for name in outcomes:
        table[f"{name} [{CHANNELS[name]}]"] = 0.012 if name == "sinkage" else 80.0
    whole, laws = dict(zip(names, wheels, strict=True)), {"set": "paper-box", **(priors or {})}
    level = {name: {**NOISE, **(noise or {})}[name] for name in outcomes}
    parts: dict[str, Any] = {"model": "M1", "drive": drive, "priors": laws, "noise": level, **options}
    study = Study(table, whole, slip_reference="shearing", **parts)
    known = {name: value for name, value in TRUTH.items() if name in study.prior.entries}
    ties = study.prior.ties
    known = {name: value for name, value in {**known, **(truth or {})}.items() if name not in ties}
    return Study(simulate(study, known), whole, slip_reference="shearing", **parts)


def search(density: Posterior, profile: Profile, at: int, rng: np.random.Generator, generations: int = 120) -> float:
    """Highest log density with a parameter held, by evolution of the densest of many random sets."""
    own, ends = (density.names.index(profile.name), np.array([law.range for law in density.prior.laws.values()]))
    size = np.ptp(ends, axis=1)

    def level(x: FloatArray) -> FloatArray:
        x[:, own] = profile.values[at]
        prior, likelihood = density.log_prior_and_likelihood(x)
        return np.asarray(likelihood + (prior if profile.kind == "posterior" else 0.0))

    pool = draw_cut_prior(density, 3000, rng).x
    kept = pool[np.argsort(-level(pool))[:60]]
    for _ in range(generations):
        spread = np.linalg.cholesky(np.cov((kept / size).T) + 1e-14 * np.eye(len(ends)))
        middle = 0.5 * (kept[rng.integers(len(kept), size=240)] + kept.mean(axis=0))
        new = middle + 0.9 * size * (rng.standard_normal((240, len(ends))) @ spread.T)
        new = np.vstack([kept, np.clip(new, ends[:, 0], ends[:, 1])])
        kept = new[np.argsort(-level(new))[:60]]
    return float(level(kept).max())


def beaten_by(density: Posterior, found: Profiles, kind: str, points: int, generations: int = 120) -> float:
    """By how much random search gets above the profiles at most, at points where 2 Δ log density < 12."""
    rng, worst = np.random.default_rng(9), -np.inf
    for profile in found.found[kind]:
        usable = np.flatnonzero(profile.rise < 12)
        for at in usable[np.linspace(0, len(usable) - 1, points).astype(int)]:
            reached = found.log_density[kind] - profile.rise[at] / 2
            worst = max(worst, search(density, profile, int(at), rng, generations) - reached)
    return worst


@pytest.fixture(scope="module")
def eight() -> tuple[Posterior, Profiles]:
    """All eight parameters free, three channels at eight slips."""
    density = posterior(study_of())
    return density, profiles(density, rng=np.random.default_rng(1))


@pytest.mark.slow
def test_random_search_does_not_beat_the_profiles(eight: tuple[Posterior, Profiles]) -> None:
    """At three values of each of eight parameters 29 000 sets per value find nothing better, within 0.02."""
    density, found = eight
    assert beaten_by(density, found, "likelihood", 3) < 0.02


@pytest.mark.slow
def test_the_search_finds_what_a_poor_profile_misses(eight: tuple[Posterior, Profiles]) -> None:
    """The same search gets above a profile that was put 0.5 too low, so that it can tell."""
    density, found = eight
    poor = replace(found, log_density={"likelihood": found.log_density["likelihood"] - 0.5})
    assert beaten_by(density, poor, "likelihood", 1) > 0.3


@pytest.mark.slow
def test_profiles_do_not_depend_on_the_starts(eight: tuple[Posterior, Profiles]) -> None:
    """Other random starts, or draws near the truth, lead to the same intervals; most points are confirmed."""
    density, found = eight
    truth = np.array([TRUTH[name] for name in density.names])
    near = truth * (1 + 1e-3 * np.random.default_rng(3).standard_normal((50, 8)))
    again = profiles(density, rng=np.random.default_rng(2), draws=near, references=truth[None])
    assert again.gain["likelihood"] > 0
    for one, other in zip(found.found["likelihood"], again.found["likelihood"], strict=True):
        width = np.ptp(one.interval(95))
        assert other.interval(95) == pytest.approx(one.interval(95), abs=0.005 * width)
        assert one.shape == other.shape
        assert min(one.trust, other.trust) > 0.8


def test_intervals_of_tight_data_hold_the_truth(eight: tuple[Posterior, Profiles]) -> None:
    """K_s may be anything, as n0 and n1 make up for it; the others' 95 % intervals hold the truth."""
    _, found = eight
    assert found.profile("Ks").shape == "flat"
    assert str(found.table["compensated_by"][0]).startswith("n0 +")
    for name in ("n0", "n1", "phi", "K", "c1", "c2"):
        low, high = found.profile(name).interval(95)
        assert low < TRUTH[name] < high
        assert found.profile(name).shape == "two-sided"


@pytest.mark.slow
def test_a_posterior_profile_is_searched_on_its_own() -> None:
    """Under the planetary priors nothing beats the posterior profiles either, and K_s ends on both sides."""
    density = posterior(study_of(priors={"set": "planetary"}))
    found = profiles(density, rng=np.random.default_rng(1))
    assert beaten_by(density, found, "posterior", 1) < 0.02
    assert found.profile("Ks", "likelihood").shape == "flat"
    assert found.profile("Ks", "posterior").shape == "two-sided"


@pytest.mark.slow
def test_cohesion_is_flat_where_readings_are_poor() -> None:
    """With forces read to 200 N and 50 N m no cohesion of the range is unlikely: c is flat."""
    noise = {"drawbar_pull": 200.0, "resistance_moment": 50.0, "sinkage": 5e-3}
    found = profiles(posterior(study_of(noise=noise)), rng=np.random.default_rng(1))
    profile = found.profile("c")
    assert profile.shape == "flat"
    assert profile.interval(95) == (0.0, 5000.0)
    assert np.isnan(profile.crossings(68)).all()


def test_one_slip_leaves_the_bearing_parameters_open() -> None:
    """From one slip n1 has no effect at all, as n0 keeps N = n0 + n1 s where it is; K_s is flat, too."""
    held = {name: TRUTH[name] for name in ("c", "phi", "K", "c1", "c2")}
    noise = {"sinkage": 2e-3, "drawbar_pull": 3.0, "resistance_moment": 0.6}
    density = posterior(study_of(slips=(0.3,), priors=held, noise=noise))
    found = profiles(density, rng=np.random.default_rng(1))
    assert found.profile("Ks").shape == "flat"
    n1 = found.profile("n1")
    assert n1.shape == "flat"
    assert n1.rise.max() < 1e-4
    assert np.ptp(n1.path @ np.array([0.0, 1.0, 0.3])) < 1e-3
    assert np.isnan(found.profile("n0").crossings(95)[0])


OFFSET = Law("norm", {"loc": 0.0, "scale": 1e-3})
MODULI = {"kc": Law("uniform", {}, -5e4, 2e5), "kphi": Law("uniform", {}, 1e5, 1e7)}
ESTIMATED = Noise("drawbar_pull", law=Law("loguniform", {}, 0.01, 10.0))
RELATIVE = Noise("drawbar_pull", fraction=0.05, floor=0.1, dof=4.0)
FEW = {name: TRUTH[name] for name in ("n1", "K", "c1", "c2")}
CASES: dict[str, dict[str, Any]] = {
    "sinkage drive": {"drive": "sinkage"},
    "both": {"drive": "both", "load_range": (10.0, 200.0), "priors": FEW, "slips": SLIPS[::2]},
    "noise": {"noise": {"drawbar_pull": ESTIMATED}, "truth": {"noise_drawbar_pull": 0.3}, "priors": FEW},
    "relative": {"noise": {"drawbar_pull": RELATIVE}, "priors": FEW},
    "two widths": {
        "wheels": (WHEEL, WIDE), "slips": SLIPS[::2], "truth": {"kc": 5e4, "kphi": 1.2e6},
        "priors": {**MODULI, "K": TRUTH["K"], "c1": TRUTH["c1"]},
    },
    "one width": {"truth": {"kc": 5e4, "kphi": 1.2e6}, "priors": {**MODULI, **FEW}},
    "tie and offset": {
        "priors": {**FEW, "c2": Tie("n1"), "sinkage_offset": OFFSET, "n1": Law("uniform", {}, 0.0, 0.6)},
        "truth": {"sinkage_offset": 5e-4, "n1": 0.3},
    },
}  # fmt: skip


QUICK = ("one width",)
"""Kinds that share most with the others; all are tested with the slow tests."""


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[] if case in QUICK else [pytest.mark.slow]) for case in CASES]
)
def test_every_kind_of_study_has_profiles(case: str) -> None:
    """All drives, estimated and relative noise, moduli, ties and zero errors: search finds nothing better."""
    density = posterior(study_of(**CASES[case]))
    found = profiles(density, rng=np.random.default_rng(1))
    kind = "posterior" if case == "tie and offset" else "likelihood"
    assert beaten_by(density, found, kind, 1, 80) < 0.02
    assert min(profile.trust for profile in found.found[kind]) > 0.7


def test_moduli_of_one_width_are_flat_together() -> None:
    """One width leaves k_c flat, k_φ making up for it."""
    found = profiles(posterior(study_of(**CASES["one width"])), rng=np.random.default_rng(1))
    assert found.profile("kc").shape == "flat"
