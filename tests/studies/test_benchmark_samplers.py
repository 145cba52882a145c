"""The stored comparison with other samplers: its claims, its README, one density for all."""

import importlib
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

STUDY = Path(__file__).parents[2] / "studies" / "benchmarks" / "samplers"
DRIVES = ["load", "sinkage"]


@pytest.fixture
def tables(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The study's module of tables."""
    monkeypatch.syspath_prepend(str(STUDY))
    return importlib.import_module("tables")


@pytest.fixture
def problems(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The study's module of posteriors."""
    monkeypatch.syspath_prepend(str(STUDY))
    return importlib.import_module("problems")


def test_ours_is_right_in_every_stored_run(tables: ModuleType) -> None:
    """All 32 statistics of every stored run of ours are right at 20 000 effective draws."""
    table = tables.results()
    ours = table[table["sampler"] == "bayesterra"]
    assert set(ours["drive"]) == set(DRIVES)
    assert ours["right"].astype(bool).all()
    assert (ours["r_hat"] < 1.01).all()
    assert (ours[["ess_bulk", "ess_tail"]].min(axis=1) > 18_000).all()


def test_no_wrong_peer_counts(tables: ModuleType) -> None:
    """The peers behind the ratios are right with every seed, and each row of a sampler is stored once."""
    table = tables.results()
    assert not table.duplicated(["drive", "sampler", "space", "seed"]).any()
    for drive in DRIVES:
        right = table[(table["drive"] == drive) & ~tables.cut(table)].groupby(["sampler", "space"])["right"].all()
        for claim, space in list(zip(tables.CLAIMS, ("raw", "raw", "ours"), strict=True))[1:]:
            peer, ratio = tables.ratios(table, drive)[claim]
            assert right[(peer, space)]
            assert ratio > 1


def test_every_peer_was_run_in_both_spaces_of_both_drives(tables: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """The rows are those that the script makes, ours before, between and after the peers."""
    monkeypatch.syspath_prepend(str(STUDY))
    script = importlib.import_module("run")
    table = tables.results()
    for drive in DRIVES:
        rows = table[table["drive"] == drive]
        stored = list(zip(rows["sampler"], rows["drive"], rows["space"], rows["seed"], strict=True))
        assert stored == script.jobs(drive)


def test_the_readme_says_what_is_stored(tables: ModuleType) -> None:
    """Headline and tables of the README are those made from the stored files."""
    text = (STUDY / "README.md").read_text(encoding="utf-8")
    table = tables.results()
    assert tables.headline(table) in text
    assert tables.every_row(table) in text
    assert tables.plain("cost.csv") in text
    assert tables.plain("divide.csv") in text


@pytest.mark.slow
@pytest.mark.parametrize("drive", DRIVES)
@pytest.mark.parametrize("space", ["raw", "ours"])
def test_scalar_peers_sample_the_same_density(drive: str, space: str, problems: ModuleType) -> None:
    """The compiled density of single points is the package's, in value and in slope."""
    problem = problems.Problem(problems.simulated_study(drive))
    chosen = problem.space(space)
    u = chosen.from_physical(problem.prior_draws(50, np.random.default_rng(1)))
    many, one, gradient = chosen.densities
    expected = many(u)
    np.testing.assert_allclose([one(point) for point in u], expected, rtol=1e-9, atol=1e-9)
    best = u[expected.argmax()]
    value, slope = gradient(best)
    steps = 1e-6 * np.eye(8)
    differences = (many(best + steps) - many(best - steps)) / 2e-6
    np.testing.assert_allclose(value, expected.max(), rtol=1e-12)
    np.testing.assert_allclose(slope, differences, rtol=1e-4, atol=1e-5 * np.abs(slope).max())
