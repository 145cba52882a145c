"""Collinearity indices of subsets, on sensitivities with known angles."""

import numpy as np
import pandas as pd
import pytest

from bayesterra.arrays import FloatArray
from bayesterra.identifiability.local import Collinearity, LocalAnalysis, collinearity, collinearity_index


def of(columns: FloatArray, names: tuple[str, ...], readings: int = 4) -> Collinearity:
    """Collinearity of sensitivities (q, d) or (n, q, d), in units of noise and prior."""
    filled = np.zeros((*columns.shape[:-2], max(columns.shape[-2], len(names)), len(names)))
    filled[..., : columns.shape[-2], :] = columns
    roots = np.linalg.qr(filled.reshape(-1, *filled.shape[-2:]), mode="r")
    return collinearity(LocalAnalysis(names, readings, np.asarray(roots), np.ones(len(names)), pd.DataFrame()))


def gamma(found: Collinearity, *names: str) -> float:
    """Index of the subset of these parameters."""
    subset = " ".join(name for name in found.names if name in names)
    return float(found.table.loc[found.table["subset"] == subset, "gamma"].iloc[0])


def test_two_parameters_have_the_index_of_their_angle() -> None:
    """For an angle α between two columns the smallest eigenvalue is 1 − |cos α|."""
    for angle in (0.5, 1.0, 1.57):
        columns = np.array([[30.0, 70.0 * np.cos(angle)], [0.0, 70.0 * np.sin(angle)]])
        expected = 1.0 / np.sqrt(1.0 - abs(np.cos(angle)))
        assert gamma(of(columns, ("n0", "K")), "n0", "K") == pytest.approx(expected, rel=1e-12)


def test_every_subset_is_judged_by_its_smallest_eigenvalue() -> None:
    """All 247 subsets of eight parameters: 1/√λ_min of the normalised SᵀS, whatever the columns' lengths."""
    rng = np.random.default_rng(1)
    names = ("Ks", "n0", "n1", "c", "phi", "K", "c1", "c2")
    columns = rng.standard_normal((20, 8)) * 10.0 ** rng.integers(-3, 4, 8)
    found = of(columns, names)
    assert len(found.table) == 2**8 - 8 - 1
    unit = columns / np.linalg.norm(columns, axis=0)
    for row in found.table.sample(40, random_state=1).itertuples():
        chosen = unit[:, [names.index(name) for name in str(row.subset).split()]]
        expected = 1.0 / np.sqrt(np.linalg.eigvalsh(chosen.T @ chosen)[0])
        assert row.gamma == pytest.approx(expected, rel=1e-9)


def test_dependent_parameters_have_no_finite_index() -> None:
    """A parameter that changes nothing, or the same as another, makes its subsets infinitely collinear."""
    columns = np.array([[10.0, 20.0, 5.0, 0.0], [10.0, 20.0, -5.0, 0.0], [0.0, 0.0, 9.0, 0.0]])
    found = of(columns, ("n0", "n1", "phi", "c"))
    assert np.isinf(gamma(found, "n0", "n1"))
    assert np.isinf(gamma(found, "c", "phi"))
    assert np.isinf(gamma(found, "n0", "n1", "c", "phi"))
    assert gamma(found, "n1", "phi") == pytest.approx(1.0)
    assert found.largest() == ("n0", "phi")


def test_the_largest_determined_subset_follows_the_threshold() -> None:
    """Three parameters of which two are nearly parallel: a pair at the usual threshold, all at a lax one."""
    columns = np.array([[10.0, 10.0, 0.0], [0.0, 0.2, 0.0], [0.0, 0.0, 10.0]])
    found = of(columns, ("c", "phi", "K"))
    assert gamma(found, "c", "phi") == pytest.approx(70.7, rel=0.01)
    assert found.largest() in {("c", "K"), ("phi", "K")}
    assert found.largest(critical=100.0) == ("c", "phi", "K")


def test_parameters_that_are_hardly_seen_do_not_count_as_determined() -> None:
    """A small index is not enough: prior sd over the sd left, |s_j|, must reach 3."""
    found = of(np.diag([10.0, 2.9, 3.1]), ("c", "phi", "K"))
    assert found.largest() == ("c", "K")
    assert of(np.diag([10.0, 1.0]), ("c", "phi")).largest() == ("c",)
    assert of(np.diag([1.0, 1.0]), ("c", "phi")).largest() == ()
    assert of(np.array([[5.0]]), ("phi",)).largest() == ("phi",)


def test_importance_is_the_root_mean_square_over_readings() -> None:
    """δ_msqr = √(Σ s² / readings), |s| the root of the sum."""
    columns = np.array([[3.0, 1.0], [4.0, 1.0], [0.0, 1.0], [0.0, 1.0]])
    found = of(columns, ("c", "phi")).importance.set_index("parameter")
    assert found["delta_msqr"]["c"] == pytest.approx(2.5)
    assert found["delta_msqr"]["phi"] == pytest.approx(1.0)
    assert found["length"]["c"] == pytest.approx(5.0)


def test_more_parameters_than_readings_are_dependent() -> None:
    """Three columns of two rows have no finite index."""
    assert np.isinf(collinearity_index(np.array([[1.0, 0.0, 0.6], [0.0, 1.0, 0.8]])))


def test_over_several_sets_the_median_counts() -> None:
    """A single set at which two parameters separate does not make them determined."""
    parallel, apart = np.array([[10.0, 10.0], [0.0, 0.1]]), np.array([[10.0, 0.0], [0.0, 1e6]])
    found = of(np.stack([parallel, apart, parallel, apart, parallel]), ("c", "phi"))
    assert found.importance["length"][1] == pytest.approx(np.hypot(10.0, 0.1))
    assert gamma(found, "c", "phi") == pytest.approx(gamma(of(parallel, ("c", "phi")), "c", "phi"))
    assert len(found.largest()) == 1
    both = of(np.stack([parallel, apart]), ("c", "phi")).table
    assert both["highest"][0] == pytest.approx(both["gamma"][0])
