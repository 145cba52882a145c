"""Laws of residuals of one's own: against the laws that the package has, in studies, and what is refused."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtr

from bayesterra.errors import StudyError
from bayesterra.likelihood.page import noise_text
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.stats.tails import OwnTails, StudentT
from bayesterra.study.canonical import identity, write_study
from bayesterra.study.entries import noise_entry
from bayesterra.study.noise import Noise
from bayesterra.study.study import Study, load_study
from tests.support.own_laws import Clipped

MakeStudy = Callable[..., Study]
Z = np.array([-40.0, -3.0, -0.1, 0.0, 0.7, 5.0])


def own(residuals: object) -> OwnTails:
    """The law of residuals that an entry of [noise] states."""
    tails = noise_entry("drawbar_pull", {"sd": "1.5 N", "residuals": residuals}, bare=True).tails
    assert isinstance(tails, OwnTails)
    return tails


@pytest.mark.parametrize("dof", [1.0, 4.0, 30.0])
def test_a_law_of_scipy_is_the_one_that_the_package_has(dof: float) -> None:
    """Student's law by its functions agrees with that by its formulas in all that is asked of it."""
    ours, law = StudentT(dof), own({"dist": "t", "df": dof})
    for asked in ("log_density", "pull", "spread", "cdf", "log_cdf", "normal_score"):
        np.testing.assert_allclose(getattr(law, asked)(Z), getattr(ours, asked)(Z), rtol=1e-5, atol=1e-7, err_msg=asked)
    np.testing.assert_allclose(law.information, ours.information, rtol=1e-3)
    assert law.log_peak == pytest.approx(ours.log_peak)
    low, high = Z - 0.3, Z + 0.4
    np.testing.assert_allclose(law.log_between(low, high), ours.log_between(low, high), rtol=1e-9)
    assert stats.kstest(law.draw((4000,), np.random.default_rng(1)), stats.t(dof).cdf).pvalue > 1e-3


def test_the_variance_is_that_of_the_law() -> None:
    """As numbers with no more digits than it is used for; capped where there is none."""
    assert own("logistic").variance == pytest.approx(np.pi**2 / 3, rel=2e-3)
    assert own("cauchy").variance == 20.0


@pytest.mark.parametrize("residuals", ["laplace", "logistic", "cauchy", {"dist": "gennorm", "beta": 1.4}])
def test_normal_laws_stand_for_it(residuals: object) -> None:
    """The mixture has the density, within 2 %, and the probabilities of the law."""
    law = own(residuals)
    sd, shares = law.parts
    z = law.quantile(np.array([0.5, 0.7, 0.9, 0.99, 0.998]))
    mixed = (stats.norm.pdf(z[:, None], scale=sd) * np.exp(shares)).sum(axis=1)
    np.testing.assert_allclose(mixed, np.exp(law.log_density(z)), rtol=0.021)
    np.testing.assert_allclose((ndtr(z[:, None] / sd) * np.exp(shares)).sum(axis=1), law.cdf(z), atol=0.002)


@pytest.mark.parametrize("drive", ["load", "sinkage"])
def test_the_likelihood_has_its_densities(drive: str, make_study: MakeStudy) -> None:
    """A channel with a law of one's own has its densities of its scale; the others stay Gaussian."""
    noise = noise_entry("drawbar_pull", {"sd": "1.5 N", "residuals": "laplace"}, bare=False)
    density = posterior(make_study(noise={"drawbar_pull": noise}, drive=drive))
    x = draw_cut_prior(density, 5, np.random.default_rng(1)).x
    outcomes = density.outcomes(x)
    pointwise = density.likelihood.pointwise(outcomes, density.noise_values(x))
    predicted = density.likelihood.predicted(outcomes)[:, :, 1]
    off = np.abs(density.likelihood.measured[:, 1] - predicted) / 1.5
    np.testing.assert_allclose(pointwise[:, :, 1], -off - np.log(3.0), rtol=1e-9)


def test_unknown_loads_are_summed_over(make_study: MakeStudy) -> None:
    """Under the drive `both` a law by its functions gives what the compiled code of the same law gives."""
    values = []
    for noise in (Noise("drawbar_pull", sd=1.5, dof=4.0), Noise("drawbar_pull", sd=1.5, residuals=own(stats.t(4)))):
        study = make_study(noise={"drawbar_pull": noise}, drive="both")
        density = posterior(study)
        x = draw_cut_prior(density, 40, np.random.default_rng(1)).x
        values.append(density.log_density(x))
    assert np.isfinite(values[0]).sum() > 20
    np.testing.assert_allclose(values[1], values[0], atol=0.01)


def test_errors_that_tie_rows_take_mixtures_of_normal_laws(make_study: MakeStudy) -> None:
    """A law that is one agrees with the package's own; one that is none is refused, and the entry named."""
    errors = {"discrepancy": {"drawbar_pull": {"sd": 2.0, "length": 0.3}}}
    values = []
    for noise in (Noise("drawbar_pull", sd=1.5, dof=4.0), Noise("drawbar_pull", sd=1.5, residuals=own(stats.t(4)))):
        density = posterior(make_study(noise={"drawbar_pull": noise}, **errors))
        values.append(density.log_density(draw_cut_prior(density, 20, np.random.default_rng(1)).x))
    assert np.isfinite(values[0]).all()
    np.testing.assert_allclose(values[1], values[0], atol=0.03)
    flat = noise_entry("drawbar_pull", {"sd": 1.5, "residuals": {"dist": "gennorm", "beta": 4}}, bare=True)
    with pytest.raises(StudyError, match=r"residuals of 'drawbar_pull' must be a mixture of normal laws \(the nearest"):
        make_study(noise={"drawbar_pull": flat}, **errors)


def test_a_file_names_it(make_study: MakeStudy, tmp_path: Path) -> None:
    """A law of scipy needs no leave; one's own is code, runs where that is allowed, and its file is part of a run."""
    stated = {"sd": 1.5, "residuals": stats.gennorm(1.4)}
    study = make_study(noise={"drawbar_pull": noise_entry("drawbar_pull", stated, bare=True)})
    for name in ("scipy", "own"):
        (tmp_path / name).mkdir()
    write_study(study, tmp_path / "scipy")
    text = (tmp_path / "scipy" / "study.toml").read_text()
    assert 'residuals = { dist = "gennorm", beta = 1.4 }' in text
    assert load_study(tmp_path / "scipy").fingerprint == study.fingerprint

    stated = {"sd": 1.5, "residuals": Clipped(3.0)}
    study = make_study(noise={"drawbar_pull": noise_entry("drawbar_pull", stated, bare=True)})
    write_study(study, tmp_path / "own")
    with pytest.raises(StudyError, match=r"runs the code of the module 'tests.support.own_laws': allow it"):
        load_study(tmp_path / "own")
    again = load_study(tmp_path / "own", allow_code=True)
    assert again.fingerprint == study.fingerprint
    assert noise_text(again, "drawbar_pull").endswith("1.5, tests.support.own_laws:Clipped law, reach 3.0")
    assert again.noise["drawbar_pull"].tails.name == "tests.support.own_laws:Clipped law, reach 3.0"
    assert len(identity(again, 1)["code of the noise of drawbar_pull"]) == 64


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("laplase", r"'dist' must be a continuous scipy.stats law, got 'laplase' \(did you mean 'laplace'\?\)"),
        ("gennorm", r"'drawbar_pull.residuals': gennorm needs its argument 'beta'"),
        ({"dist": "laplace", "b": 2}, r"unknown argument 'b' of laplace"),
        ("semicircular", r"the law must have a density above 0 everywhere \(its logpdf\(300\) is -inf\)"),
        ({"dist": "levy_stable", "alpha": 1.5, "beta": 0}, r"the law levy_stable is too slow: scipy needs millisec"),
        (stats.norminvgauss(1.0, 0.0), r"the law norminvgauss is too slow"),
        ({"dist": "gennorm", "beta": -1}, r"the law 'ppf' must return finite numbers"),
        ("expon", r"the law must be symmetric about 0 \(its median is 0.693\)"),
        (stats.norm(0.5), r"the law must be symmetric about 0 \(its median is 0.5\)"),
        (stats.skewnorm(0.0, scale=2.0).ppf, r"needs 'logpdf', 'logcdf' and 'ppf', as laws of scipy.stats have them"),
        (Clipped(-1.0), r"the law must be one law: 'logpdf' is not the derivative of 'logcdf'"),
        ({"use": "tests.support.own_laws:Nothing"}, r"'drawbar_pull.residuals' use = .* cannot be loaded \(Attribute"),
    ],
)
def test_what_is_no_law_is_refused(entry: Any, message: str) -> None:
    """With the entry, what was found, and a near name."""
    with pytest.raises(StudyError, match=message):
        own(entry)


def test_degrees_of_freedom_and_a_law_are_too_much() -> None:
    """One of them."""
    with pytest.raises(StudyError, match="noise of 'sinkage' has 'dof' and 'residuals': state one of them"):
        noise_entry("sinkage", {"sd": "1 mm", "dof": 4, "residuals": "laplace"}, bare=False)
