"""Local analysis: spectrum, directions in words and bounds, against closed forms."""

import time
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from bayesterra.arrays import FloatArray
from bayesterra.identifiability.local import collinearity, cramer_rao, local_analysis
from bayesterra.identifiability.structure import structure
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.study.study import Study, load_study
from tests.support.fisher import fisher_information

HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"


@pytest.fixture(scope="module")
def hit() -> Posterior:
    """The posterior of the shipped HIT study: eight parameters, M1, drive load."""
    return posterior(load_study(HIT))


@pytest.fixture(scope="module")
def prior(hit: Posterior) -> FloatArray:
    """Draws of its cut prior."""
    return draw_cut_prior(hit, 1000, np.random.default_rng(1)).x


def linear() -> Posterior:
    """M3 under a load is linear in cohesion and zero error of the sinkage; both have normal laws."""
    whole = load_study(HIT)
    soil = {"Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "phi": 0.51, "K": 0.01, "c1": 0.34, "c2": -0.02}
    normal: dict[str, Any] = {
        "c": {"dist": "norm", "loc": 3000.0, "scale": 300.0},
        "sinkage_offset": {"dist": "norm", "scale": 1e-3},
    }
    table = pd.read_csv(HIT / "measurements.csv")
    return posterior(
        Study(
            table,
            dict(whole.wheels),
            model="M3",
            slip_reference="shearing",
            noise={"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3},
            priors={"set": "paper-box", **soil, **normal},
        )
    )


def test_a_linear_model_with_normal_prior_has_its_bound_for_posterior_sd() -> None:
    """With the prior's information the bound is the exact posterior sd, from the density's curvature."""
    post = linear()
    assert post.names == ("c", "sinkage_offset")
    rng = np.random.default_rng(1)
    draws = np.array([3000.0, 0.0]) + rng.standard_normal((100_000, 2)) * [300.0, 1e-3]
    local = local_analysis(post, np.array([3000.0, 0.0]), draws)
    step, origin = np.array([100.0, 5e-4]), np.array([3000.0, 0.0])
    corners = [origin + step * np.array(s) for s in ((1, 0), (-1, 0), (0, 1), (0, -1), (0, 0))]
    level = post.log_density(np.array(corners))
    curvature = np.array([level[0] + level[1], level[2] + level[3]]) - 2 * level[4]
    np.testing.assert_allclose(local.table["local_sd"], step / np.sqrt(-curvature), rtol=0.01)
    np.testing.assert_allclose(local.table["expected"], 1 - (step / [300.0, 1e-3]) ** 2 / -curvature, rtol=0.01)
    offset = 1.0 / np.sqrt(5 / 1e-3**2)
    assert local.table["cramer_rao"][1] == pytest.approx(offset, rel=1e-12)


def test_the_root_is_that_of_the_averaged_information(hit: Posterior, prior: FloatArray) -> None:
    """RᵀR is the mean Fisher information over the draws, in units of the prior's standard deviations."""
    unit = prior.std(axis=0)
    local = local_analysis(hit, prior[:250], prior)
    assert local.roots.shape == (250, 8, 8)
    expected = fisher_information(hit, prior[:250]).mean(axis=0) * np.outer(unit, unit)
    size = np.sqrt(np.diagonal(expected))
    np.testing.assert_allclose(
        local.root.T @ local.root / np.outer(size, size), expected / np.outer(size, size), atol=1e-12
    )


def test_the_spectrum_is_that_of_the_information(hit: Posterior, prior: FloatArray) -> None:
    """Eigenvalues fall; at one set they are the squared singular values of the root, as are the decades."""
    local = local_analysis(hit, prior[:50], prior)
    assert (np.diff(local.spectra, axis=1) < 0).all()
    single = local_analysis(hit, prior[0], prior)
    eigenvalues = np.linalg.svd(single.root, compute_uv=False) ** 2
    np.testing.assert_allclose(single.spectra[0], eigenvalues, rtol=1e-9)
    assert single.decades == pytest.approx(np.log10(eigenvalues[0] / eigenvalues[-1]))


def test_bounds_of_a_root_are_those_of_the_inverse() -> None:
    """Bounds are √diag(I⁻¹), with the prior's correlation √diag((I + C⁻¹)⁻¹)."""
    root = np.random.default_rng(1).standard_normal((6, 4)) * [1.0, 1e-3, 10.0, 1e3]
    information = root.T @ root
    expected = np.sqrt(np.diagonal(np.linalg.inv(information)))
    np.testing.assert_allclose(cramer_rao(root), expected, rtol=1e-8)
    correlation = np.full((4, 4), -0.3) + 1.3 * np.eye(4)
    total = information + np.linalg.inv(correlation)
    expected = np.sqrt(np.diagonal(np.linalg.inv(total)))
    np.testing.assert_allclose(cramer_rao(root, correlation), expected, rtol=1e-8)


def test_a_direction_without_information_opens_the_bounds_of_its_parameters_only() -> None:
    """If only a sum of two parameters is seen, neither has a bound; others keep theirs."""
    root = np.array([[1.0, 1.0, 0.0, 0.0], [2.0, 2.0, 1.0, 0.0], [0.0, 0.0, 2.0, 0.0]])
    bounds = cramer_rao(root)
    assert np.isinf(bounds[[0, 1, 3]]).all()
    assert bounds[2] == pytest.approx(np.sqrt(5.0 / 21.0), rel=1e-12)  # inverse of [[5, 2], [2, 5]]
    np.testing.assert_allclose(cramer_rao(root, np.eye(4))[3], 1.0)


def test_bounds_stand_beside_the_sd_of_draws(hit: Posterior, prior: FloatArray) -> None:
    """The table holds prior and posterior sd; bounds with the prior are below both others."""
    draws = prior[:200] * [1, 0.1, 1, 1, 1, 1, 1, 1]
    table = local_analysis(hit, prior[:50], prior, draws).table
    assert list(table["parameter"]) == list(hit.names)
    np.testing.assert_allclose(table["posterior_sd"], draws.std(axis=0))
    assert (table["with_prior"] < np.minimum(table["prior_sd"], table["cramer_rao"]) * (1 + 1e-9)).all()
    assert (table["with_prior"] <= table["local_sd"]).all()
    assert local_analysis(hit, prior[0], prior).table["posterior_sd"].isna().all()


def test_bounds_are_averaged_as_variances(hit: Posterior, prior: FloatArray) -> None:
    """local_sd is the root mean square of the bounds at each set; at one set it is the bound itself."""
    each = [local_analysis(hit, x, prior).table for x in prior[:3]]
    for table in each:
        np.testing.assert_allclose(table["local_sd"], table["with_prior"], rtol=1e-9)
    expected = np.sqrt(np.mean([table["local_sd"] ** 2 for table in each], axis=0))
    together = local_analysis(hit, prior[:3], prior).table
    np.testing.assert_allclose(together["local_sd"], expected, rtol=1e-12)
    np.testing.assert_allclose(together["expected"], 1 - (expected / prior.std(axis=0)) ** 2, atol=1e-12)


def test_no_answer_anywhere_is_refused(hit: Posterior, prior: FloatArray) -> None:
    """A set that carries no row is no place for a local analysis."""
    hopeless = prior[0].copy()
    hopeless[[0, 3, 4]] = 1.0, 0.0, 0.0
    with pytest.raises(ValueError, match="no answer in some row for every parameter set"):
        local_analysis(hit, hopeless, prior)


def test_a_study_before_its_measurements(tmp_path: Path) -> None:
    """Channels that are yet to be measured count as read: the information is that of any readings there."""
    text = (HIT / "study.toml").read_text(encoding="utf-8")
    (tmp_path / "study.toml").write_text(text, encoding="utf-8")
    (tmp_path / "measurements.csv").write_text("slip,load [N]\n" + "".join(f"{s},80\n" for s in (0.1, 0.4)))
    planned = posterior(load_study(tmp_path, prior_only=True))
    done = "slip,load [N],sinkage [mm],drawbar_pull [N],resistance_moment [N m]\n0.1,80,5,14,3\n0.4,80,14,23,6\n"
    (tmp_path / "measurements.csv").write_text(done)
    read = posterior(load_study(tmp_path))
    prior = draw_cut_prior(planned, 200, np.random.default_rng(1)).x
    before, after = (local_analysis(post, prior, prior) for post in (planned, read))
    assert before.readings == after.readings == 6
    np.testing.assert_array_equal(before.root, after.root)
    assert structure(planned, prior).rank == structure(read, prior).rank == 6


def test_all_of_it_takes_less_than_five_seconds(hit: Posterior) -> None:
    """Prior draws, structure, information over 1000 draws, all subsets: eight parameters in M1."""
    start = time.perf_counter()
    draws = draw_cut_prior(hit, 1000, np.random.default_rng(2)).x
    structure(hit, draws[:300])
    collinearity(local_analysis(hit, draws, draws))
    assert time.perf_counter() - start < 5.0
