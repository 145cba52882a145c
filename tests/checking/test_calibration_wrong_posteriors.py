"""A right posterior passes; wrong ones, made wrong in ways that convergence figures cannot see, fail."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence

from bayesterra.arrays import FloatArray
from bayesterra.checking.calibration import calibrate
from bayesterra.checking.ranks import shift_and_width
from bayesterra.checking.short_runs import Fitted, ShortRuns
from bayesterra.likelihood.posterior import Posterior
from bayesterra.sampling.coordinates import Coordinates, coordinates
from bayesterra.study.study import Study

from .conftest import MakeStudy, exact

VAGUE = {"sinkage": 50e-3, "drawbar_pull": 100.0}
"""Noise that leaves K all of its prior: there the Jacobian of log K matters most."""


@dataclass(frozen=True)
class WithoutJacobian:
    """Coordinates that forget the Jacobian."""

    right: Coordinates

    def from_physical(self, x: FloatArray) -> FloatArray:
        """See :class:`Coordinates`."""
        return self.right.from_physical(x)

    def to_physical(self, u: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See :class:`Coordinates`."""
        return self.right.to_physical(u)[0], np.zeros(len(u))


@pytest.mark.slow
def test_the_right_posterior_passes(make_small: MakeStudy, quick: ShortRuns) -> None:
    """The default sampler is calibrated, and every replication converged."""
    found = calibrate(make_small("K", noise=VAGUE), n=20, seed=3, fit=quick)
    assert found.verdict == "calibrated"
    assert found.unsettled == 0
    assert set(found.tested) == {
        "K", "log_likelihood", "sinkage_at_largest_slip", "drawbar_pull_at_largest_slip",
    }  # fmt: skip


@pytest.mark.slow
def test_a_dropped_jacobian_fails(make_small: MakeStudy, quick: ShortRuns, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sampling log K as though the prior were flat there converges, to draws of K that are too low."""

    def wrong(posterior: Posterior) -> WithoutJacobian:
        return WithoutJacobian(coordinates(posterior))

    monkeypatch.setattr("bayesterra.sampling.sampler.coordinates", wrong)
    found = calibrate(make_small("K", noise=VAGUE), n=25, seed=3, fit=quick)
    assert found.verdict == "not calibrated"
    assert found.unsettled == 0
    assert shift_and_width(found.ranks("K"))[0] < -0.4


@pytest.mark.slow
def test_a_posterior_that_believes_in_half_of_the_noise_fails(make_small: MakeStudy, quick: ShortRuns) -> None:
    """Its sampling converges, and its intervals are half as wide as they should be."""
    wrong = make_small("n0", noise={"sinkage": 0.5e-3, "drawbar_pull": 0.75})

    def halved(simulated: Study, seed: SeedSequence) -> Fitted:
        return quick(wrong.with_data(simulated.observations.values), seed)

    found = calibrate(make_small("n0"), n=30, seed=3, fit=halved)
    assert found.verdict == "not calibrated"
    assert found.unsettled == 0
    assert 0.35 < shift_and_width(found.ranks("n0"))[1] < 0.7


@pytest.mark.parametrize("drive", ["load", "sinkage", "both"])
def test_every_drive_simulates_what_its_posterior_assumes(make_small: MakeStudy, drive: str) -> None:
    """Exact draws are calibrated with sinkage as an outcome, with sinkage given, and with latent loads."""
    slip, sinkage = [0.1, 0.3, 0.5], [5.0, 8.0, 12.0]
    table = {"slip": slip, "sinkage [mm]": sinkage, "drawbar_pull [N]": 15.0}
    table |= {"load [N]": 80.0} if drive == "load" else {"normal_force [N]": 80.0}
    options = {"load_range": ("40 N", "120 N")} if drive == "both" else {}
    study = make_small("phi", data=pd.DataFrame(table), drive=drive, **options)
    found = calibrate(study, n=100, seed=1, fit=exact)
    assert found.verdict == "calibrated", found.tests
    assert len(found.tested) == (3 if drive == "both" else 4)


def test_forgotten_latent_loads_fail(make_small: MakeStudy) -> None:
    """Readings made with loads from their prior, fitted as though the load were the measured force, fail."""
    table = {"slip": [0.1, 0.3, 0.5], "sinkage [mm]": 5.0, "drawbar_pull [N]": 15.0, "normal_force [N]": 80.0}
    both = make_small("phi", data=pd.DataFrame(table), drive="both", load_range=("40 N", "120 N"))
    load = make_small("phi", data=pd.DataFrame(table | {"load [N]": 80.0}), noise={"normal_force": 0.1})

    def forgetful(simulated: Study, seed: SeedSequence) -> Fitted:
        return exact(load.with_data(_shared(simulated, load)), seed)

    assert calibrate(both, n=60, seed=1, fit=forgetful).verdict == "not calibrated"


def _shared(simulated: Study, other: Study) -> dict[str, FloatArray]:
    """Readings of channels that the other study has too."""
    return {name: v for name, v in simulated.observations.values.items() if name in other.noise}
