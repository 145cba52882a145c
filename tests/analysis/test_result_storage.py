"""Result folders: what is written is what is read, and damage is noticed."""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayesterra.analysis.result import read_result
from bayesterra.checking.validation_page import cross_validation_section
from bayesterra.errors import ResultError, StudyError
from bayesterra.likelihood.posterior import posterior
from bayesterra.parameters import PARAMETERS
from bayesterra.stats.diagnostics import array_ess
from bayesterra.study.result import Result
from tests.support.pages import plain_pages

TABLES = Result.TABLES
GROUPS = {
    "posterior", "sample_stats", "log_prior", "log_likelihood", "prior", "prior_predictive",
    "posterior_predictive", "observed_data", "constant_data",
}  # fmt: skip
SUMMARY = [
    "parameter", "unit", "mode", "mean", "median", "sd", "hdi90_lo", "hdi90_hi",
    "mcse_mean", "mcse_median", "mcse_sd", "ess_bulk", "ess_tail", "r_hat", "prior_mean", "prior_sd", "mode_at",
    "hdi90_lo_half", "hdi90_hi_half", "hdi90_lo_double", "hdi90_hi_double",
]  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _plain_pages() -> Iterator[None]:
    """What is stored beside the page is what these tests are about."""
    with plain_pages():
        yield


@pytest.fixture(scope="module")
def folder(small_result: Result, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The small result, written."""
    path = tmp_path_factory.mktemp("written")
    small_result.write(path)
    return path


@pytest.fixture(scope="module")
def again(folder: Path) -> Result:
    """The small result, read back."""
    return read_result(folder)


def test_draws_come_back_bit_for_bit(small_result: Result, again: Result) -> None:
    """Every variable of every group is read as it was written, with its units."""
    for node in small_result.draws.subtree:
        other = again.draws[node.path]
        assert set(other.data_vars) == set(node.data_vars), node.path
        for name, values in node.data_vars.items():
            found = other[str(name)]
            np.testing.assert_array_equal(found.to_numpy(), values.to_numpy(), err_msg=str(name))
            assert found.dims == values.dims
            assert found.attrs == values.attrs
    np.testing.assert_array_equal(again.values(), small_result.values())


@pytest.mark.parametrize("table", TABLES)
def test_tables_come_back(table: str, small_result: Result, again: Result) -> None:
    """Every table is read with the same columns and the same values to the last digit."""
    pd.testing.assert_frame_equal(getattr(again, table), getattr(small_result, table), check_exact=True)


def test_record_and_study_come_back(small_result: Result, again: Result) -> None:
    """The record is the same, the study depends on the same things, and the verdict stays."""
    assert again.record["verdict"] == small_result.record["verdict"]
    assert again.record["fingerprints"] == small_result.record["fingerprints"]
    assert again.study.fingerprint == small_result.study.fingerprint
    assert again.converged == small_result.converged
    assert again.names == small_result.names


def test_a_second_writing_gives_the_same_tables(again: Result, folder: Path, tmp_path: Path) -> None:
    """Read and written again, text files are the same byte for byte."""
    again.write(tmp_path)
    for name in ("run.json", "study.toml", "measurements.csv", *(f"{table}.csv" for table in TABLES)):
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes(), name


def test_draws_file_has_the_promised_groups(folder: Path, small_result: Result) -> None:
    """The netCDF file opens without this package: groups, dimensions, names and SI values as promised."""
    with xr.open_datatree(folder / "draws.nc", engine="h5netcdf") as tree:
        assert set(tree.children) >= GROUPS
        posterior_group = tree["posterior"]
        assert list(posterior_group.data_vars) == ["Ks", "n0", "n1", "c", "phi", "K", "c1", "c2"]
        assert posterior_group["Ks"].dims == ("chain", "draw")
        assert posterior_group.sizes["chain"] == 4
        assert 1e5 <= float(posterior_group["Ks"].min()) <= float(posterior_group["Ks"].max()) <= 1e7
        assert float(posterior_group["phi"].max()) < np.radians(50.0)


def test_stored_densities_are_those_of_the_draws(small_result: Result) -> None:
    """Recomputed at the stored draws, log density, priors and likelihoods add up."""
    density, draws = posterior(small_result.study), small_result.draws
    x = small_result.values()[::50]
    stored = draws["sample_stats"]["lp"].to_numpy().ravel()[::50]
    np.testing.assert_allclose(stored, density.log_density(x), rtol=1e-9)
    rows = draws["log_likelihood"].to_dataset()
    parts = [v.sel(draw=rows["draw"]) for v in draws["log_prior"].data_vars.values()]
    parts += [v.fillna(0.0).sum("row") for v in rows.data_vars.values()]
    np.testing.assert_allclose(sum(parts), draws["sample_stats"]["lp"].sel(draw=rows["draw"]), rtol=1e-9)


def test_arviz_agrees_with_the_reported_size(small_result: Result) -> None:
    """ArviZ's own effective sample size on the stored draws is the reported one within 20 %."""
    summary = small_result.summary.set_index("parameter")
    for name in small_result.names:
        chains = small_result.draws["posterior"][name].to_numpy()
        for method in ("bulk", "tail"):
            reported = summary.loc[name, f"ess_{method}"]
            assert array_ess(chains, method) == pytest.approx(reported, rel=0.2), (name, method)


def test_summary_has_the_promised_columns_in_field_units(small_result: Result) -> None:
    """Columns as promised; figures are those of the draws in the unit named, and HDIs hold their share."""
    summary = small_result.summary
    assert list(summary.columns) == SUMMARY
    for name, row in summary.set_index("parameter").loc[list(small_result.names)].iterrows():
        draws = small_result.draws["posterior"][str(name)].to_numpy() / PARAMETERS[str(name)].scale
        found = row[["mean", "median", "sd"]].to_numpy(float)
        np.testing.assert_allclose(found, [draws.mean(), np.median(draws), draws.std()], rtol=1e-9)
        inside = (draws >= row["hdi90_lo"]) & (draws <= row["hdi90_hi"])
        assert inside.mean() == pytest.approx(0.9, abs=0.01)
        assert row["mcse_mean"] == pytest.approx(row["sd"] / np.sqrt(row["ess_bulk"]), rel=0.3)


def test_the_record_is_plain_json_without_places(folder: Path) -> None:
    """The record parses strictly and names neither folders nor people."""

    def refuse(word: str) -> float:
        raise AssertionError(f"{word} is no JSON")

    text = (folder / "run.json").read_text(encoding="utf-8")
    record = json.loads(text, parse_constant=refuse)
    assert record["seed"] == 1
    assert all({"name", "value", "threshold", "passed"} <= set(c) for c in record["verdict"]["checks"])
    assert sum(record["prior_support"]["shares"].values()) == pytest.approx(1.0)
    assert str(Path.home()) not in text
    assert str(folder) not in text


@pytest.mark.parametrize("name", ["draws.nc", "run.json", "summary.csv", "study.toml"])
def test_an_incomplete_folder_says_what_is_missing(name: str, folder: Path, tmp_path: Path) -> None:
    """Each missing file is named."""
    copied(folder, tmp_path).joinpath(name).unlink()
    with pytest.raises(ResultError, match=rf"not a complete result folder: {name} missing"):
        read_result(tmp_path)


@pytest.mark.parametrize("name", ["draws.nc", "run.json", "summary.csv"])
def test_a_damaged_file_is_noticed(name: str, folder: Path, tmp_path: Path) -> None:
    """A file cut short is one line about a damaged folder, not a traceback of another library."""
    path = copied(folder, tmp_path) / name
    path.write_bytes(path.read_bytes()[: 0 if name == "summary.csv" else path.stat().st_size // 2])
    with pytest.raises(ResultError, match="is damaged: ") as caught:
        read_result(tmp_path)
    assert "\n" not in str(caught.value)


def test_a_spoilt_study_is_reported_as_one(folder: Path, tmp_path: Path) -> None:
    """A mistake in the copied study file is named like any mistake in a study."""
    path = copied(folder, tmp_path) / "study.toml"
    path.write_text("titel = 'x'\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    with pytest.raises(StudyError, match="titel"):
        read_result(tmp_path)


def test_no_such_folder(tmp_path: Path) -> None:
    """A folder that is not there is said to be so."""
    with pytest.raises(ResultError, match="is not a result folder: there is no such folder"):
        read_result(tmp_path / "nowhere")


def copied(folder: Path, target: Path) -> Path:
    """Copy all files of a folder."""
    for path in folder.iterdir():
        (target / path.name).write_bytes(path.read_bytes())
    return target


def test_a_data_frame_has_one_row_per_draw(small_result: Result) -> None:
    """Chain, draw and the parameters in SI, in the order of the file."""
    frame = small_result.to_dataframe()
    assert list(frame.columns[:2]) == ["chain", "draw"]
    assert set(small_result.names) <= set(frame.columns)
    np.testing.assert_array_equal(frame[list(small_result.names)].to_numpy(), small_result.values())


def test_rows_keep_the_numbers_that_they_had_in_the_table_of_the_run(small_result: Result, tmp_path: Path) -> None:
    """Of a table whose first two rows were left out; its page is made again whole."""
    rows = small_result.study.observations
    study = small_result.study.having(observations=replace(rows, rows=tuple(row + 2 for row in rows.rows)))
    groups = {
        name: group.to_dataset().assign_coords(row=group["row"] + 2) if "row" in group.coords else group.to_dataset()
        for name, group in small_result.draws.children.items()
    }
    loo = small_result.record["loo"]
    later = {**loo, "rows": [{**row, "row": row["row"] + 2} for row in loo["rows"]]}
    shifted = replace(
        small_result, study=study, draws=xr.DataTree.from_dict(groups), record={**small_result.record, "loo": later},
        predictive=small_result.predictive.assign(row=small_result.predictive["row"] + 2),
    )  # fmt: skip
    shifted.save(tmp_path / "out")
    again = read_result(tmp_path / "out")
    assert again.study.observations.rows == study.observations.rows
    blocks = cross_validation_section(again)
    assert blocks
