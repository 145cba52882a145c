"""ArviZ itself opens what is written; folders of the older layout are read."""

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayesterra.analysis.comparison import compare
from bayesterra.analysis.result import curves_dataset, draws_tree, read_result
from bayesterra.arrays import FloatArray
from bayesterra.checking.predictive import one_in, predict_curves, predict_rows
from bayesterra.likelihood.posterior import posterior
from bayesterra.models import Wheel
from bayesterra.prediction.prediction import predict
from bayesterra.runtime.netcdf import write_tree
from bayesterra.study.study import Study
from tests.support.pages import undrawn

with suppress(FileNotFoundError):  # two processes that note the day of ArviZ's warning at once disturb each other
    import arviz  # noqa: F401
az: Any = pytest.importorskip("arviz", minversion="0.23")
OF_READINGS = "y" if az.__version__.startswith("0.") else "var_names"
"""Keyword by which the two generations of ArviZ take the name of a channel."""

CHANNELS = ("sinkage", "drawbar_pull", "resistance_moment")
TABLE = pd.DataFrame(
    {
        "slip": [0.1, 0.2, 0.3, 0.35, 0.4, 0.5],
        "load [N]": 80.0,
        "sinkage [mm]": [6.6, 10.0, 14.2, 16.1, 19.0, 23.5],
        "drawbar_pull [N]": [13.6, 19.0, 20.5, 21.0, 21.5, 22.0],
        "resistance_moment [N m]": [3.7, 4.8, 5.4, 5.5, 5.7, 5.9],
        "use": [1, 1, 0, 1, 1, 1],
    }
)
HELD = {"Ks": 2.5e6, "n0": 0.87, "n1": 1.1, "K": 0.0131, "c1": 0.39, "c2": -0.2}
DRIVES: dict[str, dict[str, Any]] = {
    "load": {},
    "rows that hang together": {"ripple": {"drawbar_pull": {"sd": 0.5, "memory": 2.0}}},
    "both": {"drive": "both", "load_range": ["50 N", "120 N"]},
}
OLDER = Path(__file__).parent / "older"
"""A result of the version before rows that are left out had groups of their own, its draws thinned."""


def drawn(count: int) -> FloatArray:
    """Draws (4, count, 2) of c and φ around a soil that explains the table."""
    return np.array([300.0, 0.5]) + np.array([30.0, 0.005]) * np.random.default_rng(3).standard_normal((4, count, 2))


def written(path: Path, *, copies: int = 1, count: int = 100, **given: Any) -> Study:
    """Write draws with ``copies`` of the table, the third row of each left out."""
    noise = {"sinkage": "1 mm", "drawbar_pull": "1 N", "resistance_moment": "0.2 N m"}
    table = pd.concat([TABLE] * copies)
    if given.get("drive") == "both":
        table, noise = (table.rename(columns={"load [N]": "normal_force [N]"}), {**noise, "normal_force": "2 N"})
    wheel = Wheel(0.135, 0.165, 0.015, 24, 0.75)
    study = Study(table, {"A": wheel}, slip_reference="shearing", model="M2", noise=noise,
                  priors={"set": "paper-box", **HELD}, **given)  # fmt: skip
    target, rng = posterior(study), np.random.default_rng(4)
    x = drawn(count)
    assert target.names == ("c", "phi")
    kept = x[:, :: one_in(len(table), 4 * count)]
    flat, labels = kept.reshape(-1, 2), {name: np.zeros(x.shape[:2]) for name in ("walker", "step")}
    rows, before = (predict_rows(study, target, flat, rng, before=one) for one in (False, True))
    by_chain = type(rows)(rows.channels, rows.modelled, rows.readings.reshape(*kept.shape[:2], len(table), -1))
    tree = draws_tree(
        study, target, x, labels, flat, {"posterior_predictive": by_chain, "prior_predictive": before},
        curves_dataset(predict_curves(study, target, flat[:20], rng)),
    )  # fmt: skip
    write_tree(tree, path)
    return study


@pytest.fixture(scope="module")
def driven(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], tuple[Path, Study]]:
    """File of draws and study by drive, each written once."""

    @cache
    def made(drive: str) -> tuple[Path, Study]:
        path = tmp_path_factory.mktemp("driven") / "draws.nc"
        return path, written(path, **DRIVES[drive])

    return made


@pytest.mark.parametrize("drive", DRIVES)
def test_rows_of_the_fit_have_one_dimension(drive: str, driven: Callable[[str], tuple[Path, Study]]) -> None:
    """Every group has the rows in the fit under ``row``; the one left out is kept, readings too."""
    path, study = driven(drive)
    with xr.open_datatree(path, engine="h5netcdf") as tree:
        for name in ("log_likelihood", "prior_predictive", "posterior_predictive", "observed_data", "constant_data"):
            assert tree[name]["row"].to_numpy().tolist() == [1, 2, 4, 5, 6], name
            for values in tree[name].data_vars.values():
                assert values.dims[-1] == "row", (name, values.name)
        assert set(tree["predictions"].data_vars) == set(study.noise)
        left = tree["predictions_constant_data"]
        for group in (tree["predictions"], left):
            assert group["row"].to_numpy().tolist() == [3]
        assert left["slip"].item() == 0.3
        for name in study.noise:
            assert left[name].item() == study.observations.values[name][2]
        for node in tree.subtree:
            assert node.attrs["inference_library"] == "bayesterra"
            assert node.attrs["inference_library_version"] == "0.1.0"


def test_of_many_rows_fewer_draws_are_kept_row_by_row(tmp_path: Path) -> None:
    """2000 at most, evenly spaced and to seven digits; parameters and log densities of all, and ArviZ reads them."""
    study = written(tmp_path / "draws.nc", copies=20, count=1200)
    target, x = posterior(study), drawn(1200)
    data: Any = az.from_netcdf(tmp_path / "draws.nc")
    assert dict(data["posterior"].sizes) == {"chain": 4, "draw": 1200}
    expected = target.log_density(x.reshape(-1, 2)).reshape(4, 1200)
    np.testing.assert_allclose(data["sample_stats"]["lp"], expected, rtol=1e-12)
    for name in ("log_likelihood", "prior_predictive", "posterior_predictive"):
        for values in data[name].data_vars.values():
            assert values.dtype == np.float32
            assert values.sizes["chain"] * values.sizes["draw"] == 1600
    rows = target.log_terms(x[:, ::3].reshape(-1, 2)).reshape(4, 400, 100, 3)
    for i, channel in enumerate(CHANNELS):
        np.testing.assert_allclose(data["log_likelihood"][channel], rows[..., i], rtol=1e-6)
        found, raw = az.loo(data, var_name=channel), -np.log(np.mean(np.exp(-rows[..., i]), axis=(0, 1))).sum()
        assert found.n_data_points == 100
        assert float(found.elpd_loo if hasattr(found, "elpd_loo") else found.elpd) == pytest.approx(raw, abs=0.5)


@pytest.mark.filterwarnings("ignore:Passing a dict or None as alias_mapping")  # matplotlib 3.11 of ArviZ 0.23
@pytest.mark.parametrize("drive", DRIVES)
def test_arviz_leaves_rows_out(drive: str, driven: Callable[[str], tuple[Path, Study]]) -> None:
    """Summary and loo of every term; loo_pit, and its plot, where every reading has a term of its own."""
    data: Any = az.from_netcdf(driven(drive)[0])
    assert az.summary(data).index.tolist() == ["c", "phi"]
    terms = tuple(data["log_likelihood"].data_vars)
    assert terms == (CHANNELS if drive == "load" else ("readings",))
    for term in terms:
        found = az.loo(data, var_name=term)
        assert found.n_data_points == 5
        rows = data["log_likelihood"][term].to_numpy().reshape(-1, 5)
        raw = -np.log(np.mean(np.exp(-rows), axis=0)).sum()
        assert float(found.elpd_loo if hasattr(found, "elpd_loo") else found.elpd) == pytest.approx(raw, abs=0.2)
    for channel in terms if drive == "load" else ():
        found = az.loo_pit(data, **{OF_READINGS: channel})
        pit = found if OF_READINGS == "y" else found[channel]
        below = data["posterior_predictive"][channel] <= data["observed_data"][channel]
        np.testing.assert_allclose(pit, below.mean(("chain", "draw")), atol=0.15)
        az.plot_loo_pit(data, **{OF_READINGS: channel})
    plt.close("all")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Passing a dict or None as alias_mapping")
def test_arviz_draws_the_draws(tmp_path: Path) -> None:
    """Five plots of either generation; a sixth, of left-out rows, stands above."""
    written(tmp_path / "draws.nc")
    data: Any = az.from_netcdf(tmp_path / "draws.nc")
    for plot in (az.plot_trace, az.plot_pair, az.plot_forest, az.plot_rank, az.plot_autocorr):
        plot(data, var_names=["c", "phi"])
    plt.close("all")


def test_the_older_layout_is_read() -> None:
    """Results with all rows under ``row``, and the fit's under ``used_row``, are read and reported on."""
    result = read_result(OLDER)
    assert result.draws["log_likelihood"].sizes["used_row"] == 5
    assert result.draws["observed_data"].sizes["row"] == 6
    with undrawn():
        assert "φ" in result.page().html()
    assert not predict(result, slip=[0.3], load="80 N").table.empty
    assert list(compare({"one": result, "other": result}).results) == ["one", "other"]
