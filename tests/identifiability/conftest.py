"""Small studies of every kind on one wheel, posteriors of theirs without a sampler, and one short run."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence, default_rng

from bayesterra.analysis.run import run
from bayesterra.identifiability.analysis import Identified, _record, analyse
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.models import M1, Soil, Wheel
from bayesterra.study.result import Result
from bayesterra.study.study import Study
from tests.support.adaptation import little_adaptation, rows_left_out_by_few
from tests.support.pages import plain_pages, undrawn
from tests.support.shared import Shared

TRUTH = {"Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 1e3, "phi": 0.51, "K": 0.01, "c1": 0.34, "c2": -0.02}
NOISE = {"sinkage": "3 mm", "drawbar_pull": "4 N", "resistance_moment": "1 N m"}
ESTIMATED = {"estimate": {"dist": "uniform", "lower": "1 mm", "upper": "6 mm"}}
MODULI = {
    "kc": {"dist": "uniform", "lower": 0.0, "upper": 2e5},
    "kphi": {"dist": "uniform", "lower": 5e5, "upper": 5e6},
}
SHORT = {"target_ess": 100, "walkers": 32, "max_steps": 1000}
PROPOSED = 20_000


def trial(
    *free: str, priors: Mapping[str, Any] | None = None, slips: Sequence[float] = (0.1, 0.3, 0.5), **tables: Any
) -> Study:
    """Readings of one wheel without error; whatever is not free has its true value."""
    wheel, soil = Wheel(0.15735, 0.165, 0.010, 30, 0.65), Soil(**TRUTH)
    at = np.array(slips)
    z = M1().sinkage(soil, wheel, at, 80.0)
    forces = M1().forces(soil, wheel, at, z)
    read = {"slip": at, "load [N]": 80.0, "sinkage [m]": z}
    read |= {"drawbar_pull [N]": forces.drawbar_pull, "resistance_moment [N m]": forces.resistance_moment}
    priors = dict(priors or {})
    gone = {*free, *priors, *(["Ks"] if "kc" in priors else [])}
    held = {name: value for name, value in TRUTH.items() if name not in gone}
    given = {"noise": NOISE, "sampling": SHORT, "title": "Trial", **tables}
    return Study(
        pd.DataFrame(read), {"A": wheel}, slip_reference="shearing",
        priors={"set": "paper-box", **held, **priors}, **given,
    )  # fmt: skip


VARIANTS: dict[str, Callable[[], Study]] = {
    "one parameter": lambda: trial("phi"),
    "noise only": lambda: trial(noise={**NOISE, "sinkage": ESTIMATED}),
    "moduli": lambda: trial("n0", priors=MODULI, noise={**NOISE, "sinkage": ESTIMATED}),
    "offset and c3": lambda: trial(
        "phi",
        priors={
            "sinkage_offset": {"dist": "norm", "loc": "0 mm", "scale": "2 mm"},
            "c3": {"dist": "uniform", "lower": 0.0, "upper": 0.2},
        },
    ),
    "unknown load": lambda: trial("c", "phi", drive="both", load_range=["60 N", "100 N"],
                                  noise={**NOISE, "normal_force": "8 N"}),
    "tied": lambda: trial("n0", "c", priors={"n1": "n0"}),
    "one slip": lambda: trial("Ks", "n0", "n1", slips=(0.3,)),
}  # fmt: skip


def analysed(study: Study, *, seed: int = 1, converged: bool = True) -> Identified:
    """Analyse draws of the posterior found by rejection among draws of the cut prior."""
    target = posterior(study)
    rng = default_rng(seed)
    x = draw_cut_prior(target, PROPOSED, rng).x
    gain = target.log_density(x) - target.log_prior(x)
    draws = x[np.log(rng.random(len(x))) < gain - gain.max()]
    found = analyse(target, x[:2000], draws, SeedSequence(seed))
    source = {"draws_from": "here", "draws": len(draws), "converged": converged}
    return Identified(study, found, _record(study, seed, found.seconds, source))


@pytest.fixture
def plain_pictures() -> Iterator[None]:
    """Pages whose pictures are empty, where words are looked for."""
    with undrawn():
        yield


@pytest.fixture(scope="session")
def moduli() -> Identified:
    """k_c and k_φ under one wheel width, n0 and the noise of the sinkage."""
    return analysed(VARIANTS["moduli"]())


@pytest.fixture(scope="session")
def pair(shared: Shared) -> Result:
    """A short run on cohesion and friction angle."""

    def made() -> Result:
        with little_adaptation(), rows_left_out_by_few():
            return run(trial("c", "phi"), seed=1)

    return shared("pair", made)


@pytest.fixture(scope="session")
def pair_folder(pair: Result, shared: Shared, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """That run as a folder."""

    def fill(folder: Path) -> None:
        with plain_pages():
            pair.save(folder / "pair-result")

    copy = tmp_path_factory.mktemp("identify")
    return shared.folder_of("saved-pair", fill, copy) / "pair-result"
