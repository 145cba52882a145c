"""Tables of many rows: nodes tell the rows as the model itself does, or the model is run at every row."""

from typing import Any

import numpy as np
import pandas as pd
import pytest
from paper_wheels import WHEELS

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.likelihood.forward import Forward, Nodes
from bayesterra.likelihood.integrated import NoiseIntegral, integrated
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior, draw_cut_prior, posterior
from bayesterra.likelihood.sensitivities import score_and_information, sensitivities
from bayesterra.models import ForwardModel
from bayesterra.parameters import columns_of

ROWS = 200
KNOWN: dict[str, Any] = {"sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3}
ESTIMATED = {"estimate": {"dist": "halfnorm", "scale": 2.0, "lower": 0.2}}
SIZES = np.array([1e-3, 1.5, 0.3])


def table(rows: int = ROWS, loads: tuple[float, ...] = (80.0,), wheels: tuple[str, ...] = ("Wh32",)) -> pd.DataFrame:
    """Readings of that many rows at slips in no order, loads and wheels in turn."""
    rng = np.random.default_rng(5)
    slip = rng.uniform(0.02, 0.6, rows)
    return pd.DataFrame(
        {
            "wheel": np.resize(wheels, rows),
            "slip": slip,
            "load [N]": np.resize(loads, rows),
            "sinkage [mm]": 5 + 30 * slip + rng.normal(0.0, 1.0, rows),
            "drawbar_pull [N]": 14 + 20 * slip + rng.normal(0.0, 1.5, rows),
            "resistance_moment [N m]": 4 + 5 * slip + rng.normal(0.0, 0.3, rows),
        }
    )


def target(data: pd.DataFrame, **more: Any) -> Posterior:
    """Posterior of a study of these readings, all nine parameters of its soil free."""
    options: dict[str, Any] = {"noise": KNOWN, "priors": {"set": "paper-box"}, "model": "M1", **more}
    return posterior(bt.Study(data, WHEELS, slip_reference="shearing", kind="simulated", **options))


def soils(of: Posterior, count: int = 200) -> tuple[FloatArray, FloatArray]:
    """Soil arrays and noise of draws from the prior, a few of them outside the support."""
    x = draw_cut_prior(of, count, np.random.default_rng(1)).x
    soil = of.prior.soil_values(x)
    soil[:5, columns_of(("n1",))] = -9.0
    return soil, of.noise_values(x)


@pytest.mark.parametrize("model", ["M1", "M2", "M3"])
def test_rows_told_by_nodes_are_those_of_the_model(model: str) -> None:
    """To 1e-3 of the noise over the prior, whose soils bend in places, half of them to 1e-6; all codes too."""
    whole = target(table(), model=model)
    forward, soil = whole.likelihood.forward, soils(whole)[0]
    nodes = forward.nodes
    assert nodes is not None
    assert len(nodes.load) < 40
    told = forward.at_nodes(nodes, soil)[1]
    assert 0.4 < told.mean() < 0.9
    for every_row in (False, True):
        fast, exact = forward(soil, every_row=every_row), forward.exact(soil, every_row=every_row)
        np.testing.assert_array_equal(fast.status, exact.status)
        np.testing.assert_array_equal(np.isnan(fast.values), np.isnan(exact.values))
        off = np.nanmax(np.abs((fast.values - exact.values) / SIZES)[exact.status == 0], axis=(1, 2))
        assert off.max() < 1e-3
        assert np.median(off) < 1e-6
        assert np.isfinite(fast.values[told]).all()
    np.testing.assert_array_equal(whole.likelihood.status(soil), exact.status)
    assert set(exact.status.tolist()) >= {0, 1}


def test_nodes_tell_no_soil_that_bends_between_them() -> None:
    """Such soils are off by more than the noise where the nodes are believed; some are run at every row in the end."""
    whole = target(table())
    forward, soil = whole.likelihood.forward, soils(whole)[0]
    assert forward.nodes is not None
    at_nodes, told = forward.at_nodes(forward.nodes, soil)
    exact = forward.exact(soil)
    off = np.abs(forward.nodes.at_rows(at_nodes.values) - exact.values).max(axis=1) / SIZES
    answered = np.isfinite(off).all(axis=1)
    assert off[answered & ~told].max() > 1.0
    assert not told[~answered].any()
    assert forward.finer.nodes is not None
    assert forward.finer.finer.nodes is None
    assert forward.finer.at_nodes(forward.finer.nodes, soil)[1].sum() > told.sum()


@pytest.mark.parametrize(
    "noise", [KNOWN, {**KNOWN, "drawbar_pull": ESTIMATED, "sinkage": 2e-3}], ids=["known", "estimated"]
)
def test_the_likelihood_of_many_rows_is_that_of_each(noise: dict[str, Any]) -> None:
    """Three loads, two wheels, gaps among the readings and rows with standard deviations of their own."""
    data = table(450, (60.0, 80.0, 100.0), ("Wh32", "Wh32", "Wh32", "Wh11", "Wh11", "Wh11"))
    data.loc[::7, "drawbar_pull [N]"] = np.nan
    data["resistance_moment_sd [N m]"] = np.where(data.index % 5, np.nan, 0.2)
    whole = target(data, noise=noise)
    likelihood, (soil, sizes) = whole.likelihood, soils(whole, 60)
    forward = likelihood.forward
    assert forward.nodes is not None
    told = forward.at_nodes(forward.nodes, soil)[1]
    assert told.any()
    assert not told.all()
    expected = likelihood.log_density(forward.exact(soil), sizes)
    found = likelihood.log_likelihood(soil, sizes)
    np.testing.assert_array_equal(np.isfinite(found), np.isfinite(expected))
    np.testing.assert_allclose(found[told], expected[told], rtol=5e-6, atol=1e-4)
    rest = np.isfinite(expected) & ~told
    np.testing.assert_allclose(found[rest], expected[rest], rtol=5e-6, atol=1e-4)


def test_soils_that_fit_best_are_told_to_seven_digits() -> None:
    """Their log likelihood by all nodes is that by all rows; nowhere is it the very same."""
    whole = target(table())
    likelihood, (soil, sizes) = whole.likelihood, soils(whole)
    found = likelihood.log_likelihood(soil, sizes)
    expected = likelihood.log_density(likelihood.forward.exact(soil), sizes)
    best = np.argsort(-np.where(np.isfinite(expected), expected, -np.inf))[:20]
    assert 0.0 < np.abs(found[best] / expected[best] - 1).max() < 1e-7


def test_noise_is_drawn_from_sums_by_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Sums of squared residuals of soils, some of which bend, are those of the model at every row."""
    inner = integrated(target(table(), noise=dict.fromkeys(KNOWN, ESTIMATED)))
    assert inner is not None
    soil = soils(inner, 60)[0][5:]
    likelihood = inner.likelihood
    monkeypatch.setattr(NoiseIntegral, "draw", lambda self, own, rng: own)
    sums = likelihood.integrated_out(soil, np.random.default_rng(1))
    misfit = likelihood.measured - likelihood.predicted(likelihood.forward.exact(soil))
    np.testing.assert_allclose(sums, (misfit**2).sum(axis=1), rtol=1e-3)


def test_nodes_tell_derivatives_too(monkeypatch: pytest.MonkeyPatch) -> None:
    """Exactly enough for a mode: those of the model at every row."""
    whole = target(table())
    x = draw_cut_prior(whole, 40, np.random.default_rng(2)).x
    forward = whole.likelihood.forward
    assert forward.nodes is not None
    x = x[forward.at_nodes(forward.nodes, whole.prior.soil_values(x))[1]][:3]
    fast, slope = sensitivities(whole, x), score_and_information(whole, x)
    monkeypatch.setattr(Nodes, "of", lambda *_, **__: None)
    again = target(table())
    exact, expected = sensitivities(again, x), score_and_information(again, x)
    np.testing.assert_allclose(fast.values, exact.values, rtol=1e-6, atol=1e-9)
    size = np.abs(exact.by_parameter).max(axis=(0, 1))
    assert (np.abs(fast.by_parameter - exact.by_parameter).max(axis=(0, 1)) <= 1e-5 * size).all()
    for found, right in zip(slope, expected, strict=True):
        np.testing.assert_allclose(found, right, rtol=1e-5, atol=1e-6 * np.abs(right).max())


@pytest.mark.parametrize(
    "noise", [{"fraction": 0.1, "floor": 0.5}, {"sd": 1.5, "dof": 4.0}, {"sd": 1.5, "resolution": 0.5}]
)
def test_other_laws_of_noise_are_taken_row_by_row(noise: dict[str, Any]) -> None:
    """Sums of squares do not tell them; the outcomes are told by nodes all the same."""
    likelihood = (whole := target(table(), noise={**KNOWN, "drawbar_pull": noise})).likelihood
    soil, sizes = soils(whole, 50)
    expected = likelihood.log_density(likelihood.forward.exact(soil), sizes)
    np.testing.assert_allclose(likelihood.log_likelihood(soil, sizes), expected, rtol=5e-6, atol=1e-4)


def test_few_rows_many_loads_and_other_drives_have_no_nodes() -> None:
    """Nor have models of one's own, which may jump; with a row of its own wheel beside, that row is its own node."""
    assert target(table(20)).likelihood.forward.nodes is None
    own = table()
    own["load [N]"] = np.linspace(60.0, 90.0, ROWS)
    assert target(own).likelihood.forward.nodes is None
    by_sinkage = target(
        table().drop(columns="load [N]"), drive="sinkage", noise={"drawbar_pull": 1.5, "resistance_moment": 0.3}
    )
    assert by_sinkage.likelihood.forward.nodes is None
    mixed = table()
    mixed.loc[17, "load [N]"] = 95.0
    forward = (whole := target(mixed)).likelihood.forward
    assert forward.nodes is not None
    soil = soils(whole, 20)[0]
    at_nodes, told = forward.at_nodes(forward.nodes, soil)
    np.testing.assert_array_equal(
        forward(soil).values[told, 17], at_nodes.values[told][:, forward.nodes.load == 95.0][:, 0]
    )
    assert np.abs((forward(soil).values - forward.exact(soil).values)[told] / SIZES).max() < 1e-3


def test_rows_alike_are_modelled_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """And told to the last bit, codes included, whatever their order."""
    data = table(12).loc[np.tile([3, 1, 7, 3, 11, 1], 3)].reset_index(drop=True)
    likelihood: Likelihood = (whole := target(data)).likelihood
    forward, soil = likelihood.forward, soils(whole, 50)[0]
    run: list[int] = []
    response_at = type(forward.model).response_at

    def counted(model: ForwardModel, theta: FloatArray, rows: Any, load: FloatArray, **more: bool) -> Any:
        run.append(len(rows.slip))
        return response_at(model, theta, rows, load, **more)

    monkeypatch.setattr(type(forward.model), "response_at", counted)
    for every_row in (False, True):
        found = forward.exact(soil, every_row=every_row)
        values, status = response_at(forward.model, soil[:, :9], forward.conditions, forward.given, every_row=every_row)
        np.testing.assert_array_equal(found.values, values)
        np.testing.assert_array_equal(found.status, status.max(axis=1))
    assert run == [4, 4]


def test_many_sets_are_worked_on_in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Seven at a time as all at once."""
    whole = target(table())
    likelihood, (soil, sizes) = whole.likelihood, soils(whole, 20)
    expected, rows = likelihood.log_likelihood(soil, sizes), likelihood.log_rows(soil, sizes)[1]
    monkeypatch.setattr("bayesterra.likelihood.likelihood.DOUBLES", 7.5 * 3 * ROWS)
    worked: list[int] = []
    at_nodes = Forward.at_nodes

    def counted(self: Forward, nodes: Nodes, soil: FloatArray) -> Any:
        worked.append(len(soil))
        return at_nodes(self, nodes, soil)

    monkeypatch.setattr(Forward, "at_nodes", counted)
    np.testing.assert_allclose(likelihood.log_likelihood(soil, sizes), expected, rtol=1e-10)
    np.testing.assert_allclose(likelihood.log_rows(soil, sizes)[1], rows, rtol=1e-10, atol=1e-12)
    assert max(worked) == 7
