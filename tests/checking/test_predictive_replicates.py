"""Replicated tables: the likelihood without a model call is the likelihood, and so are the posteriors."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence, default_rng

from bayesterra.arrays import FloatArray
from bayesterra.checking import predictive
from bayesterra.checking.predictive import Modelled, Replicate, ReplicateOptions, replicates
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.sampling.evidence import PosteriorProposal
from bayesterra.stats.laws import Law
from bayesterra.stats.mixture import normalised
from bayesterra.study.noise import Noise
from bayesterra.study.study import Study

MakeStudy = Callable[..., Study]
MakeTable = Callable[..., pd.DataFrame]

NOISES: Mapping[str, Noise] = {
    "sinkage": Noise("sinkage", sd=1e-3, dof=4.0),
    "drawbar_pull": Noise("drawbar_pull", fraction=0.05, floor=0.5),
    "resistance_moment": Noise("resistance_moment", law=Law("halfnorm", {"scale": 0.3}, lower=0.03)),
}


def with_readings(density: Posterior, readings: FloatArray) -> Posterior:
    """The posterior of another table."""
    rows = density.likelihood.observations
    values = {name: readings[:, i] for i, name in enumerate(density.likelihood.channels)}
    other = replace(rows, values={**rows.values, **values})
    return replace(density, likelihood=replace(density.likelihood, observations=other))


@pytest.mark.parametrize("drive", ["load", "sinkage"])
def test_arithmetic_likelihood_is_the_likelihood(drive: str, make_study: MakeStudy, make_table: MakeTable) -> None:
    """For another table with a missing reading it differs from the exact one by one constant only."""
    table = make_table()
    if drive == "sinkage":
        table = table.rename(columns={"load [N]": "normal_force [N]"})
    density = posterior(make_study(drive=drive, data=table, noise=NOISES))
    x = draw_cut_prior(density, 200, default_rng(1)).x
    modelled = Modelled.of(density, x, density.explained(x, default_rng(1)))
    readings = modelled.mean[7] + 0.5 * modelled.scale[7]
    readings[2, 1] = np.nan
    exact = with_readings(density, readings).log_terms(x).sum(axis=(1, 2))
    found = modelled.log_likelihood(density.likelihood, readings)
    np.testing.assert_allclose(found - found[0], exact - exact[0], rtol=1e-12, atol=1e-8)


def test_many_rows_are_weighed_by_their_nodes(make_study: MakeStudy, make_table: MakeTable) -> None:
    """As by every row, of another table too, some readings missing; what chosen sets say is said of every row."""
    table = make_table(slips=tuple(np.linspace(0.05, 0.55, 150)))
    density, rng = posterior(make_study(data=table, free=("c", "phi"))), default_rng(3)
    x = draw_cut_prior(density, 4000, rng).x
    x = x[np.argsort(-density.log_density(x))[:300]]
    near, likelihood = PosteriorProposal.of(density, x), density.likelihood
    pool = predictive._Pool.of(near, near.mixture(rng), 300, rng)
    assert pool.modelled is None
    modelled = Modelled.of(density, pool.sets.x, density.explained(pool.sets.x, rng))
    other = modelled.mean[5] + 0.5 * modelled.scale[0] * rng.standard_normal(likelihood.measured.shape)
    other[3:9, 1] = np.nan
    for readings in (likelihood.measured, other):
        expected = normalised(pool.sets.log_base + modelled.log_likelihood(likelihood, readings))
        found = normalised(pool.log_weights(likelihood, readings))
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-12)
    chosen = np.array([4, 4, 9])
    np.testing.assert_allclose(pool.take(chosen).mean, modelled.mean[chosen], rtol=1e-7)
    np.testing.assert_allclose(pool.explained(chosen)["sinkage"], modelled.mean[chosen][:, :, 0], rtol=1e-7)


@pytest.fixture(scope="module")
def latent(make_study: MakeStudy, make_table: MakeTable) -> Posterior:
    """Strength and stiffness free, load measured with an error."""
    table = make_table(slips=(0.1, 0.3, 0.5)).rename(columns={"load [N]": "normal_force [N]"})
    return posterior(make_study(drive="both", data=table, free=("Ks", "phi"), load_range=[50.0, 110.0]))


@pytest.mark.parametrize("about", ["drawn", "read"])
def test_latent_loads_are_linear_enough(about: str, latent: Posterior) -> None:
    """With latent loads it is the exact one to a tenth, near the readings of any likely replicate.

    About loads that are drawn for each set, and about those that the replicate's normal forces say.
    """
    x = _likely(latent, 200)
    modelled = Modelled.of(latent, x, latent.explained(x, default_rng(1)))
    likelihood = latent.likelihood
    readings = modelled.mean[3] + modelled.scale[3] * default_rng(2).standard_normal(modelled.mean[3].shape)
    if about == "read":
        at = likelihood.forward.at_load(readings[:, likelihood.channels.index("normal_force")])
        modelled = Modelled.of(latent, x, at(latent.prior.soil_values(x), every_row=True))
    exact = with_readings(latent, readings).log_terms(x).sum(axis=(1, 2))
    difference = modelled.log_likelihood(likelihood, readings) - exact
    assert exact.std() > 0.5
    assert np.abs(difference - np.median(difference)).max() < 0.1


def test_limits_under_latent_loads_are_linear_enough(latent: Posterior) -> None:
    """Readings known by a limit only, one of them the only one of its row that tells the load."""
    rows, x = latent.likelihood.observations, _likely(latent, 200)
    pull, force = rows.values["drawbar_pull"], rows.values["normal_force"]
    nowhere = np.tile([-np.inf, np.inf], (len(rows), 1))
    ends = {"drawbar_pull": nowhere.copy(), "normal_force": nowhere.copy()}
    ends["drawbar_pull"][0], ends["normal_force"][1] = (-np.inf, pull[0] - 0.5), (force[1] + 1.0, np.inf)
    clipped = {name: np.clip(rows.values[name], *ends[name].T) for name in ends}
    limited = replace(rows, values={**rows.values, **clipped}, limits=ends)
    density = replace(latent, likelihood=replace(latent.likelihood, observations=limited))
    modelled = Modelled.of(density, x, density.explained(x, default_rng(1)))
    readings = density.likelihood.draw(density.explained(x[:1], default_rng(3)), np.empty((1, 0)), default_rng(4))
    other = readings[0]
    other[0, density.likelihood.channels.index("drawbar_pull")] = pull[0] - 0.5
    other[1, density.likelihood.channels.index("normal_force")] = force[1] + 1.0
    exact = with_readings(density, other).log_terms(x).sum(axis=(1, 2))
    difference = modelled.log_likelihood(density.likelihood, other) - exact
    assert exact.std() > 0.5
    assert np.abs(difference - np.median(difference)).max() < 0.1
    assert np.ptp(replace(modelled, limits=None).log_likelihood(latent.likelihood, other) - exact) > 0.3


def test_latent_loads_are_drawn_as_the_readings_tell(latent: Posterior) -> None:
    """Explaining readings that all lie at a shifted load moves the modelled ones there."""
    x = np.repeat(_likely(latent, 1), 4000, axis=0)
    modelled = Modelled.of(latent, x, latent.explained(x, default_rng(1)))
    assert modelled.slope is not None
    centre = modelled.mean.mean(axis=0)
    shifted = centre + 2.0 * modelled.slope.mean(axis=0)
    moved = modelled.explaining(latent.likelihood, shifted, default_rng(1)).mean
    np.testing.assert_allclose(moved.mean(axis=0) - shifted, 0.0, atol=0.05 * np.abs(shifted - centre).max())
    precision = ((modelled.slope / modelled.scale) ** 2).sum(axis=2).mean(axis=0)
    force = latent.likelihood.channels.index("normal_force")
    np.testing.assert_allclose(moved[:, :, force].std(axis=0), precision**-0.5, rtol=0.06)


def _likely(density: Posterior, n: int) -> FloatArray:
    """Posterior draws by importance from the prior."""
    x = draw_cut_prior(density, 4000, default_rng(5)).x
    level = density.log_terms(x).sum(axis=(1, 2))
    weights = np.exp(level - level.max())
    return x[default_rng(6).choice(len(x), size=n, p=weights / weights.sum())]


@pytest.mark.parametrize("options", [ReplicateOptions(), ReplicateOptions(pool=64, fewest=1e9, local=(2048, 2048))])
def test_every_replicate_has_its_own_posterior(options: ReplicateOptions, make_study: MakeStudy) -> None:
    """Modelled pull under a replicate's draws has the mean and spread that weighted prior draws have."""
    density = posterior(make_study(free=("c", "phi")))
    draws = _likely(density, 2000)
    options = replace(options, number=12, draws=2000)
    prior = draw_cut_prior(density, 20_000, default_rng(7)).x
    pulls = density.likelihood.predicted(density.outcomes(prior))[:, 2, 1]

    def compared(table: Replicate) -> tuple[float, float]:
        level = with_readings(density, table.readings).log_terms(prior).sum(axis=(1, 2))
        weights = np.exp(level - level.max())
        weights /= weights.sum()
        mean = weights @ pulls
        sd = np.sqrt(weights @ (pulls - mean) ** 2)
        found = table.modelled.mean[:, 2, 1]
        return (found.mean() - mean) / sd, found.std() / sd

    shifts, ratios = np.array(replicates(density, draws, SeedSequence(1), options, compared)).T
    assert np.abs(shifts).max() < 0.5
    assert np.abs(shifts).mean() < 0.12
    assert ratios.mean() == pytest.approx(1.0, abs=0.1)


def test_a_search_begins_near_the_posterior_of_its_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """A normal posterior in eight directions, and a table whose own lies two standard deviations away in each."""
    u, away, begun = 1.5 * default_rng(1).standard_normal((8192, 8)), 2.0, list[FloatArray]()

    def log_weights(likelihood: object, readings: float) -> FloatArray:
        total = np.asarray((u**2 / 4.5 - (u - readings) ** 2 / 2).sum(axis=1))
        total[::50] = -np.inf if readings else total[::50]  # readings that cannot be
        return total

    pool: Any = SimpleNamespace(sets=SimpleNamespace(u=u), log_weights=log_weights, take=lambda chosen: MagicMock())
    near: Any = SimpleNamespace(posterior=MagicMock(), shifted=begun.append)
    monkeypatch.setattr(predictive._Pool, "of", lambda *arguments: pool)
    table: Any = away
    predictive._settled(near, pool, log_weights(None, 0.0), table, default_rng(2), ReplicateOptions(local=(1,)))
    alone = normalised(log_weights(None, away)) @ u
    assert np.linalg.norm(begun[0] - away) < 0.7 * np.linalg.norm(alone - away)


def test_replicates_depend_on_the_seed_only(make_study: MakeStudy) -> None:
    """The same seed gives the same tables, in whatever order threads take them."""
    density = posterior(make_study(free=("c", "phi")))
    draws, options = _likely(density, 500), ReplicateOptions(number=8, pool=256)

    def readings(seed: int) -> Any:
        return np.array(replicates(density, draws, SeedSequence(seed), options, lambda table: table.readings))

    np.testing.assert_array_equal(readings(1), readings(1))
    assert not np.array_equal(readings(1), readings(2))
