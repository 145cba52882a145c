"""Priors from results whose ridge bends: a mixture stands in, against quadrature; written, read, refused."""

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import xarray as xr
from scipy.stats import kstest, norm

from bayesterra.__main__ import main
from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError
from bayesterra.parameters import SOIL_PARAMETERS
from bayesterra.stats.dependence import MixtureCopula
from bayesterra.study.canonical import tables, write_study
from bayesterra.study.previous import PosteriorPrior, taken
from bayesterra.study.priors import Entry, Prior, Source
from bayesterra.study.study import load_study
from tests.support.two_wheels import HELD, MakeStudy, made

BEND, ACROSS, THIRD = 0.7, 0.2, 0.8
NAMES = ("n0", "n1", "c1")


@pytest.fixture(scope="session")
def make() -> MakeStudy:
    """See :func:`made`."""
    return made


def banana(n: int, seed: int) -> FloatArray:
    """Draws (n, 3): the second follows the square of the first, the third leans on the second."""
    z = np.random.default_rng(seed).standard_normal((n, 3))
    bent = BEND * (z[:, 0] ** 2 - 1.0) + ACROSS * z[:, 1]
    return np.column_stack([z[:, 0], bent, THIRD * bent + 0.5 * z[:, 2]])


def log_banana(x: FloatArray) -> FloatArray:
    """Their log density (n,)."""
    bent = (x[:, 1] - BEND * (x[:, 0] ** 2 - 1.0)) / ACROSS
    parts = np.column_stack([x[:, 0], bent, (x[:, 2] - THIRD * x[:, 1]) / 0.5])
    return np.asarray(norm.logpdf(parts).sum(axis=1))


def result_of(draws: FloatArray, title: str = "Bent") -> Any:
    """A result with these draws of n0, n1, c1 as its posterior."""
    columns = {name: (("chain", "draw"), x.reshape(4, -1)) for name, x in zip(NAMES, draws.T, strict=False)}
    return SimpleNamespace(draws=xr.DataTree.from_dict({"/posterior": xr.Dataset(columns)}), record={"title": title})


def prior_of(joint: PosteriorPrior, *, mixture: bool) -> Prior:
    """The prior that a joint law makes, by its mixture or by its correlations."""
    entries: dict[str, Entry] = {**dict.fromkeys(SOIL_PARAMETERS, 0.25), **joint.laws}
    if not mixture:
        return Prior(entries, correlation=joint.correlation)
    assert joint.mixture is not None
    return Prior(entries, mixtures={", ".join(joint.laws): joint.mixture})


def tails(x: FloatArray, weights: FloatArray) -> FloatArray:
    """5 and 95 % quantiles and standard deviations (d, 3) of weighted points; on a grid, of its cells."""
    found = []
    for column in x.T:
        values, cell = np.unique(column, return_inverse=True)
        masses = np.bincount(cell, weights)
        below = np.cumsum(masses) - 0.5 * masses
        sd = np.sqrt(np.cov(column, aweights=weights))
        found.append([*np.interp([0.05, 0.95], below / weights.sum(), values), sd])
    return np.array(found)


@pytest.mark.parametrize("d", [2, pytest.param(3, marks=pytest.mark.slow)])
def test_the_next_posterior_has_the_tails_of_quadrature(d: int) -> None:
    """A reading that cuts across the bend: correlations miss its tails, the mixture tells them."""
    joint = taken(Source(result_of(banana(16_000, 1)[:, :d])))
    assert joint.mixture is not None
    assert joint.mixture_fidelity is not None
    assert joint.mixture_fidelity.difference < 2 * joint.mixture_fidelity.noise < joint.fidelity.difference
    design = np.array([0.5, 1.0, 0.3])[:d]

    def log_reading(x: FloatArray) -> FloatArray:
        return np.asarray(-0.5 * ((x @ design - 0.6) / 0.3) ** 2)

    axes = [np.linspace(-4.0, 4.0, 161), np.linspace(-1.6, 6.0, 153), np.linspace(-4.0, 6.0, 121)][:d]
    grid = np.column_stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")])
    both = np.column_stack([grid, THIRD * grid[:, 1]]) if d == 2 else grid
    exact = tails(grid, np.exp(log_banana(both) + log_reading(grid)))
    off = {}
    for mixture in (False, True):
        x = prior_of(joint, mixture=mixture).sample({2: 60_000, 3: 150_000}[d], np.random.default_rng(2))
        found = tails(x, np.exp(log_reading(x)))
        off[mixture] = np.abs((found - exact)[:, :2] / exact[:, 2:]).max()
    assert off[False] > 0.2
    assert off[True] < 0.07


def test_the_joint_law_keeps_single_laws_and_the_bend() -> None:
    """Draws have the laws of the single parameters and the banana's law along, across and around it."""
    joint = taken(Source(result_of(banana(6000, 1)[:, :2])))
    prior = prior_of(joint, mixture=True)
    x, exact = prior.sample(40_000, np.random.default_rng(3)), banana(40_000, 4)
    for i, law in enumerate(prior.laws.values()):
        assert kstest(law.cdf(x[:, i]), "uniform").pvalue > 1e-3
    directions = np.linalg.eigh(np.cov(exact[:, :2].T))[1]
    for ours, theirs in zip((x @ directions).T, (exact[:, :2] @ directions).T, strict=True):
        assert kstest(ours, theirs).statistic < 0.03
    around = [part[:, 1] - BEND * (part[:, 0] ** 2 - 1.0) for part in (x, exact)]
    assert kstest(*around).statistic < 0.06
    weights = np.exp(Prior(prior.entries).log_density(x) - prior.log_density(x))
    assert weights.mean() == pytest.approx(1.0, abs=5 * weights.std() / np.sqrt(len(x)))


def test_wider_scores_leave_the_mixture_as_it_is() -> None:
    """Laws spread; the dependence of scores is the same."""
    result = result_of(banana(1600, 5)[:, :2])
    plain, wide = taken(Source(result)), taken(Source(result, widen=1.5))
    assert plain.mixture is not None
    assert wide.mixture == plain.mixture
    assert np.ptp(wide.laws["n0"].quantile(np.array([0.1, 0.9]))) > 1.3 * np.ptp(
        plain.laws["n0"].quantile(np.array([0.1, 0.9]))
    )


def test_straight_ridges_keep_their_correlations() -> None:
    """Whatever the number of parameters, no mixture is fitted to what correlations tell."""
    root = np.linalg.cholesky(np.array([[1.0, -0.95, 0.3], [-0.95, 1.0, -0.2], [0.3, -0.2, 1.0]]))
    for seed in range(5):
        draws = np.random.default_rng(seed).standard_normal((4000, 3)) @ root.T
        joint = taken(Source(result_of(np.exp(0.5 * draws))))
        assert (joint.mixture, joint.mixture_fidelity) == (None, None)
        assert joint.record()["joint_law"] == "correlations"


def test_a_fit_repeats_itself_and_touches_no_random_stream() -> None:
    """Twice the same numbers; the global generator stays where it was."""
    result, rng = result_of(banana(1600, 6)), np.random.RandomState(3)
    np.random.seed(3)  # noqa: NPY002
    assert taken(Source(result)).mixture == taken(Source(result)).mixture
    assert np.random.random() == rng.random_sample()  # noqa: NPY002


def bent_priors(**more: Any) -> dict[str, Any]:
    """Priors of c, φ and K of which a banana of the last two is taken from a result."""
    x = banana(1600, 7)
    columns = {"phi": np.radians(30.0 + 2.0 * x[:, 0]), "K": 0.012 + 0.001 * x[:, 1]}
    group = {
        name: (("chain", "draw"), values.reshape(4, -1), {"units": {"phi": "rad", "K": "m"}[name]})
        for name, values in columns.items()
    }
    draws = xr.DataTree.from_dict({"/posterior": xr.Dataset(group)})
    result = SimpleNamespace(draws=draws, record={"title": "Bent"})
    free = {name: value for name, value in HELD.items() if name not in ("c", "phi", "K")}
    cohesion = {"dist": "norm", "loc": 1000.0, "scale": 300.0, "lower": 0.0}
    return {**free, "c": cohesion, "from": [{"result": result}], **more}


def test_a_mixture_is_written_in_full_and_read_back(make: MakeStudy, tmp_path: Path) -> None:
    """The saved study has weights, means and covariances; its density is the same to the last bit."""
    study = make(priors=bent_priors(), pooling=None)
    ((names, mixture),) = study.prior.mixtures.items()
    assert names == "phi, K"
    assert any("correlations stand badly for the posterior of 'Bent'" in note for note in study.notes)
    assert any(f"a mixture of {len(mixture.weights)} normal laws" in note for note in study.notes)
    write_study(study, tmp_path)
    text = (tmp_path / "study.toml").read_text(encoding="utf-8")
    assert '[priors.mixture."phi, K"]\nweights = [' in text
    assert "[priors.correlation]" not in text
    again = load_study(tmp_path)
    assert again.prior == study.prior
    assert again.fingerprint == study.fingerprint
    x = study.prior.sample(200, np.random.default_rng(8))
    np.testing.assert_array_equal(again.prior.log_density(x), study.prior.log_density(x))
    head, _, weights = text.partition("weights = [")
    first, _, rest = weights.partition(",")
    second, _, rest = rest.partition(",")
    moved = f"{head}weights = [{float(first) + 1e-4!r},{float(second) - 1e-4!r},{rest}"
    (tmp_path / "study.toml").write_text(moved, encoding="utf-8")
    other = load_study(tmp_path)
    assert other.fingerprint["study"] != study.fingerprint["study"]
    assert other.prior != study.prior
    assert "priors.mixture" not in tables(make(priors={**HELD, "c": LAWS["c"]}, pooling=None))


def test_check_says_which_joint_law_is_used(
    make: MakeStudy, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Name, number of components and both errors, also from the saved study."""
    study = make(priors=bent_priors(), pooling=None)
    write_study(study, tmp_path)
    assert main(["check", str(tmp_path)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert re.search(r"phi, K: joined by a mixture of \d+ normal laws of scores", shown)
    said = r"a mixture of \d+ normal laws of scores, off by at most 0\.\d\d in probability, about phi and K"
    assert re.search(said + r" \(correlations by 0\.\d\d\)", shown)
    (record,) = (joint.record() for joint in study.taken)
    assert record["joint_law"] == "mixture"
    assert record["difference_of_mixture"] < 0.05 < 0.1 < record["difference_of_correlations"]
    assert not record["bad"]


def test_stated_correlations_straighten_what_they_touch(make: MakeStudy) -> None:
    """A correlation with a parameter beside the result: correlations for all of these, and a note."""
    study = make(priors=bent_priors(correlation={"c, phi": 0.5}), pooling=None)
    assert not study.prior.mixtures
    assert set(study.prior.correlation) == {"c, phi", "phi, K"}
    assert "phi has stated correlations, so 'Bent' gives these, not a mixture" in study.notes
    (joint,) = study.taken
    assert joint.record()["joint_law"] == "correlations"


ONE = {"weights": [0.5, 0.5], "means": [[-0.5, 0.0], [0.5, 0.0]],
       "covariances": [[[0.75, 0.5], [0.5, 1.0]], [[0.75, -0.5], [-0.5, 1.0]]]}  # fmt: skip
LAWS = {"c": {"dist": "norm", "loc": 1000.0, "scale": 300.0, "lower": 0.0},
        "phi": {"dist": "norm", "loc": 0.5, "scale": 0.05, "lower": 0.0, "upper": 1.0}}  # fmt: skip
WRONG: dict[str, tuple[Mapping[str, Any], str]] = {
    "unknown name": ({"c, phii": ONE}, r"unknown parameter 'phii' \(did you mean 'phi'\?\)"),
    "one name": ({"c": ONE}, "a key must name two parameters or more, each once"),
    "twice": ({"c, c": ONE}, "a key must name two parameters or more, each once"),
    "no table": ({"c, phi": 3}, "'mixture of 'c, phi'' must be a table"),
    "missing": ({"c, phi": {"weights": [1.0]}},
        r"needs weights, means, covariances \(got weights\)"),
    "no number": ({"c, phi": {**ONE, "weights": [0.5, "half"]}}, "mixture of 'c, phi': 'weights' must be"),
    "sum": ({"c, phi": {**ONE, "weights": [0.5, 0.6]}}, r"sum to 1 \(got the sum 1.1\)"),
    "too many": ({"c, phi, K": ONE}, r"must be of 3 parameters \(got 2\)"),
    "fixed": ({"c, Ks": ONE}, "mixture of 'c, Ks': 'Ks' must have a law of its own"),
    "two of them": ({"c, phi": ONE, "phi, K": ONE}, "'phi' must not stand in another mixture or in corr"),
}  # fmt: skip


@pytest.mark.parametrize(("mixture", "message"), WRONG.values(), ids=WRONG)
def test_stated_mixtures_that_are_wrong(make: MakeStudy, mixture: Mapping[str, Any], message: str) -> None:
    """One line with the key and the rule."""
    shear = {"dist": "uniform", "lower": 0.002, "upper": 0.05}
    with pytest.raises(StudyError, match=message) as caught:
        make(priors={**HELD, **LAWS, "K": shear, "mixture": mixture}, pooling=None)
    assert "\n" not in str(caught.value)


def test_a_mixture_may_be_stated(make: MakeStudy) -> None:
    """By hand, in any order of the names, beside correlations of others, but not of its own."""
    shear = {"dist": "uniform", "lower": 0.002, "upper": 0.05}
    priors = {**HELD, **LAWS, "K": shear}
    stated = make(priors={**priors, "mixture": {"c, phi": ONE}}, pooling=None).prior
    turned = {
        "weights": ONE["weights"],
        "means": np.array(ONE["means"])[:, ::-1].tolist(),
        "covariances": np.array(ONE["covariances"])[:, ::-1, ::-1].tolist(),
    }
    other = make(priors={**priors, "mixture": {"phi, c": turned}}, pooling=None).prior
    x = stated.sample(500, np.random.default_rng(9))
    np.testing.assert_allclose(other.log_density(x), stated.log_density(x), atol=1e-10)
    copula = MixtureCopula(**{key: _tuples(value) for key, value in ONE.items()})
    z = stated.scores(x)
    own = sum(law.log_density(x[:, i]) for i, law in enumerate(stated.laws.values()))
    np.testing.assert_allclose(stated.log_density(x), own + copula.log_density(z[:, :2]), atol=1e-10)
    with pytest.raises(StudyError, match="'phi' must not stand in another mixture or in correlations"):
        make(priors={**priors, "mixture": {"c, phi": ONE}, "correlation": {"phi, K": 0.3}}, pooling=None)
    q = np.random.default_rng(10).random((20_000, 3))
    x = stated.quantile(q)
    for i, law in enumerate(stated.laws.values()):
        assert kstest(law.cdf(x[:, i]), "uniform").pvalue > 1e-3
    assert replace(stated, mixtures={}) != stated


def _tuples(value: Any) -> Any:
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value
