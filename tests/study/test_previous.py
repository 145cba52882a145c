"""Priors from earlier results: read from folders, joined by correlations, written out in full, or refused."""

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from scipy import integrate, stats

import bayesterra as bt
from bayesterra.__main__ import main
from bayesterra.errors import StudyError
from bayesterra.parameters import SOIL_PARAMETERS
from bayesterra.stats.dependence import MixtureCopula
from bayesterra.stats.laws import Law
from bayesterra.stats.quantile_law import QuantileLaw
from bayesterra.study.canonical import write_study
from bayesterra.study.previous import Fidelity, PosteriorPrior, taken
from bayesterra.study.priors import Prior, Source
from bayesterra.study.study import Study, load_study

Earlier = Callable[..., Path]

FROM = '[priors]\nset = "paper-box"\n\n[[priors.from]]\nresult = "../earlier"\n{}\n'
R = np.array([[1.0, -0.8, 0.3], [-0.8, 1.0, 0.0], [0.3, 0.0, 1.0]])


def bearing_and_friction(n: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Draws of a plate and shear test with a known joint law: lognormal k_c and k_φ, normal n."""
    z = rng.standard_normal((n, 3)) @ np.linalg.cholesky(R).T
    return {"kc": 15e3 * np.exp(0.3 * z[:, 0]), "kphi": 2e6 * np.exp(0.2 * z[:, 1]), "n": 1.0 + 0.05 * z[:, 2]}


UNITS = {"kc": "Pa m", "kphi": "Pa/m^n", "n": "1", "phi": "rad", "c": "Pa", "n0": "1", "Ks": "Pa/m^N"}


@pytest.fixture
def earlier(tmp_path: Path) -> Earlier:
    """Write a result folder ``earlier`` with given draws beside the folder of the study."""

    def written(draws: Mapping[str, np.ndarray], chains: int = 4, record: object = None) -> Path:
        folder = tmp_path / "earlier"
        folder.mkdir()
        group = xr.Dataset(
            {
                name: (("chain", "draw"), values.reshape(chains, -1), {"units": UNITS[name]})
                for name, values in draws.items()
            }
        )
        xr.DataTree.from_dict({"/posterior": group}).to_netcdf(folder / "draws.nc", engine="h5netcdf")
        text = json.dumps(record or {"title": "Two plates", "verdict": {"converged": True}})
        (folder / "run.json").write_text(text, encoding="utf-8")
        return folder

    return written


@pytest.fixture
def study_with(tmp_path: Path, write: Callable[..., Path]) -> Callable[[str], Path]:
    """Write the small study in a folder of its own with another text in the place of its priors."""

    def written(priors: str) -> Path:
        folder = tmp_path / "study"
        folder.mkdir(exist_ok=True)
        small = write()
        head, _, _ = small.read_text(encoding="utf-8").partition("[priors]")
        (folder / "study.toml").write_text(head + priors, encoding="utf-8")
        (small.parent / "measurements.csv").replace(folder / "measurements.csv")
        return folder / "study.toml"

    return written


def test_a_plate_test_is_the_prior_of_a_wheel_study(earlier: Earlier, study_with: Callable[[str], Path]) -> None:
    """Laws keep the quantiles of the draws, correlations those of their scores; names change as asked."""
    draws = bearing_and_friction(8000, np.random.default_rng(1))
    earlier(draws)
    study = load_study(study_with(FROM.format('take = { kc = "kc", kphi = "kphi", n0 = "n" }')))
    for here, there in (("kc", "kc"), ("kphi", "kphi"), ("n0", "n")):
        law = study.prior.laws[here]
        assert isinstance(law, QuantileLaw)
        q = np.array([0.02, 0.2, 0.5, 0.8, 0.98])
        assert np.abs(law.cdf(np.quantile(draws[there], q)) - q).max() < 5e-3
        assert law.source.startswith("posterior of 'Two plates' (earlier), ")
    found = [study.prior.correlation[pair] for pair in ("kc, kphi", "kc, n0", "kphi, n0")]
    np.testing.assert_allclose(found, [-0.8, 0.3, 0.0], atol=0.03)
    assert study.prior.laws["phi"].dist == "uniform"
    (joint,) = study.taken
    assert joint.fidelity.difference < joint.fidelity.noise
    assert not [note for note in study.notes if "earlier" in note]


def test_the_study_is_written_in_full_and_read_back(
    earlier: Earlier, study_with: Callable[[str], Path], tmp_path: Path
) -> None:
    """Tables and correlations are written as numbers: without the earlier folder the density is the same."""
    folder = earlier(bearing_and_friction(4000, np.random.default_rng(2)))
    text = FROM.format('take = { kc = "kc", kphi = "kphi", n0 = "n" }\nwiden = 1.5')
    study = load_study(study_with(text + '\n[priors.correlation]\n"phi, c" = -0.5\n'))
    (tmp_path / "again").mkdir()
    write_study(study, tmp_path / "again")
    for file in folder.iterdir():
        file.unlink()
    again = load_study(tmp_path / "again")
    assert again.prior == study.prior
    assert again.prior.sources == study.prior.sources
    assert again.fingerprint == study.fingerprint
    x = study.prior.sample(50, np.random.default_rng(3))
    np.testing.assert_array_equal(again.prior.log_density(x), study.prior.log_density(x))
    uncorrelated = Prior(study.prior.entries, study.prior.width)
    assert uncorrelated != study.prior


def test_the_joint_density_is_normalised_and_keeps_its_margins() -> None:
    """Two correlated laws: the density over the plane integrates to 1, over one law to the other."""
    wide = Law("gamma", {"a": 2.5, "scale": 300.0}, upper=5000.0)
    angle = QuantileLaw(lower=0.0, upper=1.5, scores=(-1.0, 0.0, 1.0), values=(0.4, 0.55, 0.62))
    fixed = dict.fromkeys(SOIL_PARAMETERS, 0.25)
    prior = Prior({**fixed, "c": wide, "phi": angle}, correlation={"c, phi": -0.8})

    def density(c: float, phi: float) -> float:
        return float(np.exp(prior.log_density(np.array([[c, phi]]))[0]))

    for phi in (0.3, 0.5, 0.61, 0.7):
        own = integrate.quad(density, 0.0, 5000.0, args=(phi,), points=[50.0, 500.0, 2000.0], limit=200)[0]
        assert own == pytest.approx(float(np.exp(angle.log_density(np.array(phi)))), rel=1e-5)
    # the plane in scores, on which the density is smooth
    z, weights = np.polynomial.legendre.leggauss(200)
    z, weights = 8.0 * z, 8.0 * weights
    grid = np.column_stack([axis.ravel() for axis in np.meshgrid(wide.at_score(z), angle.at_score(z))])
    log_area = stats.norm.logpdf(prior.scores(grid)).sum(axis=1) - Prior(prior.entries).log_density(grid)
    total = np.exp(prior.log_density(grid) + log_area) @ np.outer(weights, weights).ravel()
    assert total == pytest.approx(1.0, abs=1e-6)


def test_draws_have_the_stated_correlation_and_density() -> None:
    """Draws follow their laws and correlation, and weights to an independent prior average to 1."""
    fixed = dict.fromkeys(SOIL_PARAMETERS, 0.25)
    laws = {"c": Law("halfnorm", {"scale": 1000.0}), "phi": Law("norm", {"loc": 0.5, "scale": 0.1}),
            "K": Law("uniform", lower=0.001, upper=0.05), "n0": Law("norm", {"loc": 1.0})}  # fmt: skip
    prior = Prior({**fixed, **laws}, correlation={"c, phi": -0.7, "c, K": 0.4})
    x = prior.sample(20_000, np.random.default_rng(4))
    for i, law in enumerate(prior.laws.values()):
        assert stats.kstest(law.cdf(x[:, i]), "uniform").pvalue > 1e-3
    np.testing.assert_allclose(np.corrcoef(prior.scores(x).T), prior.score_correlation, atol=0.03)
    assert prior.names == ("n0", "c", "phi", "K")
    assert prior.correlated == [1, 2, 3]
    independent = Prior(prior.entries)
    ratio = np.exp(independent.log_density(x) - prior.log_density(x))
    assert ratio.mean() == pytest.approx(1.0, abs=5 * ratio.std() / np.sqrt(len(x)))
    assert prior.log_density(x).mean() > independent.log_density(x).mean() + 0.3


def test_the_posterior_of_one_reading_is_the_prior_of_the_next() -> None:
    """Linear and Gaussian, where the answer is known: first readings, then another, as both at once."""
    rng, names = np.random.default_rng(12), ("n0", "n1", "c1")
    mean, root = np.array([1.0, 0.5, 0.3]), np.diag([0.2, 0.4, 0.1]) @ np.linalg.cholesky(R)
    first = mean + rng.standard_normal((8000, 3)) @ root.T
    result = SimpleNamespace(draws=_tree(dict(zip(names, first.T, strict=True))), record={"title": "First"})
    joint = taken(Source(result))
    design, reading, sd = np.array([1.0, 0.5, -1.0]), 1.0, 0.05
    gain = root @ root.T @ design / (design @ root @ root.T @ design + sd**2)
    exact = mean + gain * (reading - design @ mean)
    exact_sd = np.sqrt(np.diag(root @ root.T - np.outer(gain, design @ root @ root.T)))
    fixed = {name: 0.25 for name in SOIL_PARAMETERS if name not in names}
    away = []
    for correlation in (joint.correlation, {}):
        x = Prior({**fixed, **joint.laws}, correlation=correlation).sample(200_000, rng)
        weights = np.exp(-0.5 * ((x @ design - reading) / sd) ** 2)
        weights /= weights.sum()
        centre = weights @ x
        spread = np.sqrt(weights @ (x - centre) ** 2)
        away.append(np.abs([(centre - exact) / exact_sd, spread / exact_sd - 1.0]).max())
    assert away[0] < 0.05
    assert away[1] > 0.15


def test_a_result_object_stands_for_its_folder(earlier: Earlier, study_with: Callable[[str], Path]) -> None:
    """In Python the result itself may be given; the ranges of its own prior hold."""
    draws = bearing_and_friction(4000, np.random.default_rng(5))
    folder = earlier(draws)
    prior = SimpleNamespace(laws={"kc": Law("uniform", lower=0.0, upper=60e3)}, reference=1.0)
    result = SimpleNamespace(
        draws=xr.open_datatree(folder / "draws.nc", engine="h5netcdf").load(),
        record={"title": "Two plates"},
        study=SimpleNamespace(prior=prior),
    )
    table = pd.read_csv(study_with("").parent / "measurements.csv")
    wheel = bt.Wheel(0.15735, 0.165, 0.010, 30, 0.65)
    study = Study(
        table,
        {"A": wheel},
        slip_reference="shearing",
        noise={"sinkage": 1e-3, "drawbar_pull": 1.5},
        priors={"set": "paper-box", "from": [{"result": result, "take": {"kc": "kc", "kphi": "kphi"}}]},
    )
    assert study.prior.laws["kc"].range == (0.0, 60e3)
    assert study.prior.laws["kphi"].range == (-np.inf, np.inf)
    assert any("kphi is taken from 'Two plates' without its exponent" in note for note in study.notes)


def test_without_take_all_that_have_the_same_name_are_taken(earlier: Earlier) -> None:
    """Names that only one side knows are left alone."""
    folder = earlier(bearing_and_friction(4000, np.random.default_rng(6)))
    assert tuple(taken(Source(folder)).take) == ("kc", "kphi")


def test_bent_ridges_are_reported() -> None:
    """Draws on a parabola: the laws hold, and the note says that correlations do not tell the rest."""
    rng = np.random.default_rng(7)
    n0 = rng.standard_normal(4000)
    n1 = n0**2 + 0.1 * rng.standard_normal(4000)
    result = SimpleNamespace(draws=_tree({"n0": n0, "n1": n1}), record={"title": "Bent"})
    found = taken(Source(result))
    assert found.fidelity.poor
    assert "correlations stand badly for the posterior of 'Bent', above all about n0 and n1" in found.notes[0]
    straight = SimpleNamespace(
        draws=_tree({"n0": n0, "n1": 0.9 * n0 + 0.1 * rng.standard_normal(4000)}), record={"title": "Straight"}
    )
    assert taken(Source(straight)).fidelity.difference < taken(Source(straight)).fidelity.noise


def _tree(draws: Mapping[str, np.ndarray]) -> xr.DataTree:
    columns = {name: (("chain", "draw"), values.reshape(4, -1)) for name, values in draws.items()}
    return xr.DataTree.from_dict({"/posterior": xr.Dataset(columns)})


WRONG = {
    "no folder": ('result = "../nowhere"', r"nowhere' is not a result folder: there is no such folder"),
    "missing parameter": ('result = "../earlier"\ntake = { phi = "phi" }',
        r"'take': 'Two plates' \(earlier\) has no draws of 'phi' \(has kc, kphi, n\)"),
    "unknown here": ('result = "../earlier"\ntake = { fi = "n" }',
        r"'take': unknown parameter 'fi' \(known: Ks, n0,"),
    "other dimension": ('result = "../earlier"\ntake = { phi = "n" }',
        r"'phi' and 'n' must have the same dimension \(got rad and pure number\)"),
    "one twice": ('result = "../earlier"\ntake = { n0 = "n", n1 = "n" }',
        "'take': 'n' is taken more than once"),
    "narrowed": ('result = "../earlier"\nwiden = 0.5', r"'widen' must be at least 1 \(got 0.5\)"),
    "unknown key": ('result = "../earlier"\ntakes = {}',
        r"'from': unknown key 'takes' \(did you mean 'take'\?\)"),
    "no result": ('take = { n0 = "n" }', "'from' needs a 'result', the folder of a finished result"),
    "no table": ('result = "../earlier"\ntake = "n"',
        r"'take' must be a table such as { n0 = \"n\" }: here = there \(got 'n'\)"),
    "given and taken": ('result = "../earlier"\ntake = { n0 = "n" }\n[priors.n0]\ndist="norm"\nloc=1',
        r"'n0' is given and taken from 'Two plates' \(earlier\): leave one of them out"),
    "kc alone": ('result = "../earlier"\ntake = { kc = "kc" }', "'kc' needs 'kphi' beside it"),
    "contradiction": ('result = "../earlier"\ntake = { kc = "kc", kphi = "kphi" }\n[priors.correlation]\n'
        '"kc, c" = 0.9\n"c, kphi" = 0.9', "correlations must be such that all can hold at once"),
    "correlation twice": ('result = "../earlier"\ntake = { kc = "kc", kphi = "kphi" }\n[priors.correlation]\n'
        '"kc, kphi" = 0.1', "correlation of 'kc, kphi' is given and taken from"),
    "correlation of what is fixed": ('result = "../earlier"\ntake = { n0 = "n" }\n[priors.correlation]\n'
        '"n0, c3" = 0.1', "correlation of 'n0, c3': 'c3' must have a law of its own"),
    "too large": ('result = "../earlier"\n[priors.correlation]\n"n0, c" = 1.0',
        r"correlation of 'n0, c' must lie between -1 and 1 \(got 1\)"),
    "one name": ('result = "../earlier"\n[priors.correlation]\n"c" = 0.1', 'a key must name two parameters'),
    "unknown name": ('result = "../earlier"\n[priors.correlation]\n"c, fi" = 0.1', "unknown parameter 'fi'"),
}  # fmt: skip


@pytest.mark.parametrize(("text", "message"), WRONG.values(), ids=WRONG)
def test_what_cannot_be_is_said_in_a_line(
    text: str, message: str, earlier: Earlier, study_with: Callable[[str], Path]
) -> None:
    """Each mistake names the file, the key and the rule."""
    earlier(bearing_and_friction(2000, np.random.default_rng(8)))
    priors = f'[priors]\nset = "paper-box"\n\n[[priors.from]]\n{text}\n'
    with pytest.raises(StudyError, match=message) as caught:
        load_study(study_with(priors))
    assert "\n" not in str(caught.value)
    assert "study.toml: " in str(caught.value)


def test_an_unfinished_or_empty_or_short_result_is_refused(
    tmp_path: Path, earlier: Earlier, study_with: Callable[[str], Path]
) -> None:
    """A run that goes on, a folder without draws, a prior without readings, and 300 draws are no priors."""
    file = study_with(FROM.format('take = { n0 = "n" }'))
    (tmp_path / "earlier.part").mkdir()
    with pytest.raises(StudyError, match="its run has not ended"):
        load_study(file)
    draws = bearing_and_friction(300, np.random.default_rng(9))
    folder = earlier(draws)
    with pytest.raises(StudyError, match=r"at least 400 effective draws .* \(got \d+ of 'n' from 'Two plates'"):
        load_study(file)
    xr.DataTree.from_dict({"/prior": xr.Dataset()}).to_netcdf(folder / "draws.nc", engine="h5netcdf")
    with pytest.raises(StudyError, match="holds a prior without readings"):
        load_study(file)
    (folder / "draws.nc").write_bytes(b"nothing")
    with pytest.raises(StudyError, match="is damaged: "):
        load_study(file)
    (folder / "draws.nc").unlink()
    with pytest.raises(StudyError, match=r"is not a finished result folder: draws\.nc missing"):
        load_study(file)


def test_a_result_that_has_not_converged_is_named(earlier: Earlier) -> None:
    """Its draws are taken, with a note."""
    draws = bearing_and_friction(4000, np.random.default_rng(10))
    folder = earlier(draws, record={"title": "Half done", "verdict": {"converged": False}})
    assert (
        "'Half done' (earlier), whose posterior is a prior here, has not converged"
        in taken(Source(folder, {"n0": "n"})).notes
    )


def test_check_shows_the_joint_prior_and_its_source(
    earlier: Earlier, study_with: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    """The overview has quantiles, correlations and where they come from."""
    earlier(bearing_and_friction(4000, np.random.default_rng(11)))
    file = study_with(FROM.format('take = { kc = "kc", kphi = "kphi", n0 = "n" }'))
    assert main(["check", str(file)]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "kc, kphi, n0: posterior of 'Two plates' (earlier), " in shown
    assert "tabulated (median" in shown
    assert "Prior correlations of normal scores" in shown
    assert re.search(r"kphi −0\.(79|80|81)", shown)


def test_a_record_has_every_figure_under_its_own_name() -> None:
    """Difference and its noise are two numbers."""
    fidelity = Fidelity(("c", "phi"), 0.25, 0.04)
    made = PosteriorPrior("'box'", {"c": "c"}, 1.5, 812.0, {}, {}, fidelity, ())
    assert made.record() == {
        "from": "'box'", "take": {"c": "c"}, "widen": 1.5, "effective_draws": 812.0,
        "worst_pair": ["c", "phi"], "largest_difference": 0.25, "its_noise": 0.04, "bad": True,
        "joint_law": "correlations", "components": None,
        "difference_of_correlations": 0.25, "difference_of_mixture": None,
    }  # fmt: skip
    one = MixtureCopula((1.0,), ((0.0, 0.0),), (((1.0, 0.5), (0.5, 1.0)),))
    bent = replace(made, mixture=one, mixture_fidelity=Fidelity(("phi", "K"), 0.03, 0.05))
    assert bent.record() == {
        **made.record(), "worst_pair": ["phi", "K"], "largest_difference": 0.03, "its_noise": 0.05,
        "bad": False, "joint_law": "mixture", "components": 1, "difference_of_mixture": 0.03,
    }  # fmt: skip
