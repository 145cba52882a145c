"""Noise integrated out: the integral, the draws given it, and where it is not done."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from numpy.random import SeedSequence, default_rng
from scipy.integrate import cumulative_simpson, simpson
from scipy.stats import kstest

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.integrated import Integrated, IntegratedNoise, NoiseIntegral, integrated
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.sampler import Target, sample
from bayesterra.stats.laws import Law
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import load_study

HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"
STATED = {"sinkage": '"1 mm"', "drawbar_pull": '"1.5 N"', "resistance_moment": '"0.3 N m"'}
LAW = '{{ dist = "loguniform", lower = "{}", upper = "{}" }}'
ESTIMATED = {
    "sinkage": f"{{ estimate = {LAW.format('0.1 mm', '10 mm')} }}",
    "drawbar_pull": f"{{ estimate = {LAW.format('0.1 N', '15 N')} }}",
    "resistance_moment": f"{{ estimate = {LAW.format('0.03 N m', '3 N m')} }}",
}
LAWS = [
    Law("loguniform", lower=1e-4, upper=1e-2),
    Law("uniform", lower=0.1, upper=15.0),
    Law("halfnorm", {"scale": 0.3}, lower=1e-3),
    Law("lognorm", {"s": 0.7, "scale": 2.0}),
    Law("halfcauchy", {"scale": 0.02}, lower=1e-3, upper=10.0),
]


def hit(folder: Path, more: str = "", **noise: str) -> Posterior:
    """Posterior of the HIT study with other noise."""
    text = (HIT / "study.toml").read_text(encoding="utf-8")
    for channel, stated in STATED.items():
        text = text.replace(f"{channel} = {stated}", f"{channel} = {noise.get(channel, stated)}")
    (folder / "study.toml").write_text(text + more, encoding="utf-8")
    (folder / "measurements.csv").write_bytes((HIT / "measurements.csv").read_bytes())
    return posterior(load_study(folder))


def log_joint(law: Law, count: int, total: float, t: FloatArray) -> FloatArray:
    """Log density of log σ with the readings."""
    sd = np.clip(np.exp(t), *law.range)
    density: FloatArray = law.log_density(sd) + t - count * (t + 0.5 * np.log(2 * np.pi)) - 0.5 * total / sd**2
    return density


def of_soil(whole: Posterior) -> Integrated:
    """The posterior with its noise integrated out."""
    inner = integrated(whole)
    assert inner is not None
    return inner


@cache
def _table_of(number: int, count: int) -> NoiseIntegral:
    return NoiseIntegral(LAWS[number], count)


def tabulated(law: Law, count: int) -> NoiseIntegral:
    """The integral of one of the laws, tabulated once."""
    return _table_of(LAWS.index(law), count)


def counting(integral: NoiseIntegral, total: float) -> tuple[FloatArray, FloatArray]:
    """Values of log σ that count, many, and the log density there with the readings."""
    grid = np.linspace(*integral.ends, 20_001)
    for _ in range(2):
        density = log_joint(integral.law, integral.count, total, grid)
        within = np.flatnonzero(density > density.max() - 50)
        grid = np.linspace(grid[max(within[0] - 1, 0)], grid[min(within[-1] + 1, len(grid) - 1)], 20_001)
    return grid, log_joint(integral.law, integral.count, total, grid)


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("count", [0, 1, 5, 300])
def test_the_table_is_the_integral(law: Law, count: int) -> None:
    """It is right to 1e-9 for residuals of nothing, of the noise, and far beyond it."""
    integral, middle = tabulated(law, count), law.median
    sums = max(count, 1) * np.array([0.0, 1e-9, 1e-3, 0.3, 1.0, 4.0, 30.0, 1e3, 1e5]) * middle**2
    for total, got in zip(sums, integral(sums), strict=True):
        grid, density = counting(integral, total)
        peak = density.max()
        assert got == pytest.approx(peak + np.log(simpson(np.exp(density - peak), x=grid)), abs=1e-9, rel=1e-9)


@pytest.mark.parametrize("law", LAWS, ids=str)
@pytest.mark.parametrize("count", [1, 5, 300])
def test_draws_given_the_residuals_have_their_law(law: Law, count: int) -> None:
    """Shares below the draws are uniform, whether the readings or the prior tell σ."""
    integral = tabulated(law, count)
    for number, share in enumerate((1e-6, 0.5, 1.0, 30.0)):
        total = share * count * law.median**2
        drawn = np.log(integral.draw(np.full(20_000, total), default_rng(number)))
        grid, density = counting(integral, total)
        mass = cumulative_simpson(np.exp(density - density.max()), x=grid, initial=0)
        assert kstest(np.interp(drawn, grid, mass / mass[-1]), "uniform").pvalue > 1e-4
        shares = np.linspace(0.0005, 0.9995, 1000)
        placed = np.log(integral._drawn(np.full(1000, total), shares))
        assert np.abs(np.interp(placed, grid, mass / mass[-1]) - shares).max() < 2e-4


@pytest.mark.parametrize("law", LAWS, ids=str)
def test_residuals_without_measure_have_no_density(law: Law) -> None:
    """Sums of squares that overflow have the log density −inf, and none of the others is touched."""
    integral = tabulated(law, 5)
    assert np.isneginf(integral(np.array([np.inf, 1.0]))).tolist() == [True, False]
    assert np.isneginf(integral.exactly(np.array([np.inf])))


def test_a_law_that_bends_within_its_range_is_sampled() -> None:
    """No panel ends at the bend of a triangular law, so that its table is not right to ten digits."""
    law = Law("triang", {"c": 0.37, "loc": 0.1, "scale": 2.0}, lower=0.2)
    assert not NoiseIntegral(law, 5).told
    assert all(tabulated(smooth, 5).told for smooth in LAWS)


def test_the_density_of_the_soil_is_that_of_all_with_noise_integrated(tmp_path: Path) -> None:
    """The whole density over that of the soil is a density of the three standard deviations."""
    whole = hit(tmp_path, **ESTIMATED)
    inner = of_soil(whole)
    assert inner.names == tuple(name for name in whole.names if not name.startswith("noise_"))
    soil = inner.cut_prior(3, default_rng(1))
    points, weights = np.polynomial.legendre.leggauss(40)
    ends = np.log([whole.prior.laws[name].range for name in whole.names[-3:]])
    logs = ends.mean(axis=1) + 0.5 * np.ptp(ends, axis=1) * points[:, None]
    grid = np.stack(np.meshgrid(*logs.T, indexing="ij"), axis=-1).reshape(-1, 3)
    size = np.prod(np.stack(np.meshgrid(*(0.5 * np.ptp(ends, axis=1) * weights[:, None]).T, indexing="ij")), axis=0)
    for theta in soil:
        sets = np.column_stack([np.tile(theta, (len(grid), 1)), np.exp(grid)])
        share = np.exp(whole.log_density(sets) - inner.log_density(theta[None]) + grid.sum(axis=1))
        assert float(share @ size.ravel()) == pytest.approx(1.0, abs=1e-6)


def test_stated_noise_stays_beside_estimated(tmp_path: Path) -> None:
    """Where one channel is estimated, the others count as they are stated."""
    whole = hit(tmp_path, resistance_moment=ESTIMATED["resistance_moment"])
    inner = of_soil(whole)
    for theta in inner.cut_prior(4, default_rng(2)):
        centre, law = float(inner.log_density(theta[None])[0]), whole.prior.laws[whole.names[-1]]
        grid = np.linspace(np.log(law.range[0]), np.log(law.range[1]), 20_001)
        sets = np.column_stack([np.tile(theta, (len(grid), 1)), np.clip(np.exp(grid), *law.range)])
        share = np.exp(whole.log_density(sets) - centre + grid)
        assert simpson(share, x=grid) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.parametrize(
    ("noise", "more"),
    [
        ({}, ""),
        ({"sinkage": ESTIMATED["sinkage"][:-1] + ", dof = 4 }"}, ""),
        ({"sinkage": ESTIMATED["sinkage"][:-1] + ', resolution = "0.5 mm" }'}, ""),
        ({"sinkage": ESTIMATED["sinkage"], "drawbar_pull": '{ fraction = 0.1, floor = "0.5 N" }'}, ""),
    ],
)
def test_what_cannot_be_integrated_is_sampled(tmp_path: Path, noise: dict[str, str], more: str) -> None:
    """Nothing estimated, Student's tails, rounding, a size that hangs on the model: the posterior itself."""
    whole = hit(tmp_path, more, **noise)
    assert integrated(whole) is None
    assert Target.of(whole, fewest=True).names == whole.names


def test_samples_hold_noise_that_follows_from_their_soil(tmp_path: Path) -> None:
    """Draws have a column for every parameter, each standard deviation from its law given the soil beside it."""
    whole = hit(tmp_path, **ESTIMATED)
    options = SamplingOptions(target_ess=100, walkers=32, max_steps=50, ensembles=4)
    plan = AdaptationOptions(particles=128, components=2, sweeps=1, refinements=(1,), more=(), shores=1, climbs=10)
    samples, again = (sample(whole, options, SeedSequence(3), adaptation=plan) for _ in range(2))
    assert samples.names == whole.names
    assert samples.diagnosis.tau.shape == (11,)
    assert np.array_equal(samples.chains, again.chains)
    x = samples.chains[:, ::5].reshape(-1, 11)
    likelihood = of_soil(whole).likelihood
    assert isinstance(likelihood, IntegratedNoise)
    soil = whole.prior.soil_values(x)
    sums = likelihood._sums(likelihood.forward(soil))
    for i, name in enumerate(("sinkage", "drawbar_pull", "resistance_moment")):
        law = whole.prior.laws[f"noise_{name}"]
        grid = np.linspace(np.log(law.range[0]), np.log(law.range[1]), 4001)
        mass = np.cumsum(np.exp(-5 * grid - 0.5 * sums[:, i, None] * np.exp(-2 * grid)), axis=1)
        drawn = np.log(x[:, whole.names.index(f"noise_{name}")])
        shares = [np.interp(t, grid, row / row[-1]) for t, row in zip(drawn, mass, strict=True)]
        assert kstest(shares, "uniform").pvalue > 1e-4
