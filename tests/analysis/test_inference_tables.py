"""Tables of one result agree: draws, summary, verdicts, record, least squares and what a terminal shows."""

from collections.abc import Iterator

import numpy as np
import pytest

from bayesterra.arrays import FloatArray
from bayesterra.parameters import CHANNELS, PARAMETERS
from bayesterra.report.blocks import Table
from bayesterra.report.numbers import interval, resolution, rounded
from bayesterra.study.result import Result, identifiability_rows, summary_rows


def predicted(result: Result, group: str, channel: str, row: int) -> FloatArray:
    """Draws of a reading in field units; rows that are not in the fit stand in ``predictions``."""
    used = row in result.draws[group]["row"].to_numpy()
    values = result.draws[group if used else "predictions"][channel].sel(row=row)
    return np.asarray(values.to_numpy().ravel() / CHANNELS[channel].scale)


def test_predictive_quantiles_are_those_of_the_posterior_predictive_draws(small_result: Result) -> None:
    """Row by row and channel by channel; what was predicted before the readings is wider."""
    narrower = 0
    for row in small_result.predictive.to_dict("records"):
        channel, number = str(row["channel"]), int(row["row"])
        own = predicted(small_result, "posterior_predictive", channel, number)
        found = [row[name] for name in ("mean", "q05", "q50", "q95")]
        expected = [np.nanmean(own), *np.nanquantile(own, [0.05, 0.5, 0.95])]
        np.testing.assert_allclose(found, expected, rtol=1e-9)
        assert row["no_answer"] == pytest.approx(np.isnan(own).mean())
        if not row["used"]:
            continue
        assert row["observed"] == pytest.approx(
            float(small_result.draws["observed_data"][channel].sel(row=number)) / CHANNELS[channel].scale
        )
        before = predicted(small_result, "prior_predictive", channel, number)
        narrower += np.nanstd(own) < np.nanstd(before)
    assert narrower == small_result.predictive["used"].sum() > 0


def test_predictions_have_the_draws_that_they_are_made_with(small_result: Result) -> None:
    """Evenly spaced ones, 2000 at most; those after the readings have the numbers that they have in the posterior."""
    draws = small_result.draws
    sizes = {name: dict(node.sizes) for name, node in draws.children.items()}
    for made, of in (("posterior_predictive", "posterior"), ("prior_predictive", "prior")):
        assert sizes[made]["chain"] == sizes[of]["chain"]
        assert 1000 <= sizes[made]["chain"] * sizes[made]["draw"] <= 2000
    one = draws["posterior"]["draw"].to_numpy()[:: sizes["posterior"]["draw"] // sizes["posterior_predictive"]["draw"]]
    for name in ("posterior_predictive", "log_likelihood"):
        np.testing.assert_array_equal(draws[name]["draw"], one)


def test_settings_and_labels_are_those_of_the_draws(small_result: Result) -> None:
    """Ensembles, walkers, kept steps and their distance: the record says what the draws show."""
    record, study, stats = small_result.record, small_result.study, small_result.draws["sample_stats"]
    assert record["settings"] == {
        name: getattr(study.sampling, name) for name in ("target_ess", "ensembles", "walkers", "max_steps")
    }
    assert stats.sizes["chain"] == record["settings"]["ensembles"]
    assert np.unique(stats["walker"]).tolist() == list(range(record["settings"]["walkers"]))
    sampling = record["sampling"]
    steps = range(0, sampling["steps"], sampling["kept_one_step_in"])
    assert np.unique(stats["step"]).tolist() == list(steps)
    assert stats.sizes["draw"] == len(steps) * record["settings"]["walkers"]
    assert min(small_result.summary["ess_bulk"][: len(small_result.names)]) >= record["verdict"]["ess"]


def test_verdicts_rest_on_the_spreads_of_the_summary(small_result: Result) -> None:
    """Standard deviations are the same in both tables, and contraction is 1 less the ratio of variances."""
    table = small_result.identifiability.set_index("parameter")
    for name, row in summary_rows(small_result).items():
        if name not in table.index:
            continue
        scale, own = PARAMETERS[name].scale, table.loc[name]
        before, after = small_result.values("prior"), small_result.values()
        i = small_result.names.index(name)
        np.testing.assert_allclose([row.prior_sd * scale, row.sd * scale], [own["prior_sd"], own["posterior_sd"]])
        np.testing.assert_allclose([before[:, i].std(), after[:, i].std()], [own["prior_sd"], own["posterior_sd"]])
        if not small_result.study.prior.laws[name].logarithmic:
            assert own["contraction"] == pytest.approx(1 - (row.sd / row.prior_sd) ** 2)


def test_directions_are_counted_from_their_contractions(small_result: Result) -> None:
    """As many as there are free parameters; determined are those that lose nine tenths of their variance."""
    found = small_result.record["directions"]
    contractions = np.array(found["contractions"])
    assert found["of"] == len(contractions) == len(small_result.names)
    assert found["determined"] == (contractions >= 0.9).sum()
    alone = (small_result.identifiability["verdict"] == "determined").sum()
    assert found["determined"] > alone  # combinations, not parameters: the two must not be taken for one
    assert (np.diff(contractions) <= 0).all()


def test_least_squares_are_those_of_the_record(small_result: Result) -> None:
    """Values, errors and credible levels of every method, in its own rows."""
    record = small_result.record
    densities = small_result.draws["sample_stats"]["lp"].to_numpy()
    for method, rows in small_result.least_squares.groupby("method"):
        fit, standing = record["fits"].get(method, {"missing": ()}), record["standings"][method]
        density = -np.inf if standing["log_density"] is None else standing["log_density"]
        assert standing["credible_level"] == pytest.approx((densities > density).mean())
        for row in rows.to_dict("records"):
            name = str(row["parameter"])
            if name.startswith("error_"):
                assert row["value"] == pytest.approx(fit["errors_percent"][name.removeprefix("error_")], nan_ok=True)
            elif name in standing["values"] and name not in fit["missing"]:
                assert row["value"] * PARAMETERS[name].scale == pytest.approx(standing["values"][name])
            level = np.nan if standing["filled"] else standing["credible_level"]
            assert row["credible_level"] == pytest.approx(level, nan_ok=True)


def test_rows_left_out_are_those_in_the_fit(small_result: Result) -> None:
    """Their numbers, and with all rows known the densities that the draws have."""
    loo, terms = small_result.record["loo"], small_result.draws["log_likelihood"]
    assert [row["row"] for row in loo["rows"]] == list(small_result.study.observations.used().rows)
    values = np.array([term.fillna(0.0).to_numpy() for term in terms.data_vars.values()])
    own = values.sum(axis=0).reshape(-1, len(loo["rows"]))
    np.testing.assert_allclose(loo["full"], np.log(np.exp(own).mean(axis=0)), atol=0.15)
    assert loo["elpd"] == pytest.approx(sum(row["elpd"] for row in loo["rows"]))
    assert loo["effective_parameters"] == pytest.approx(sum(loo["full"]) - loo["elpd"])


def shown(result: Result) -> Iterator[tuple[str, ...]]:
    """Rows of the table that a terminal shows, without the empty one between parameters and the rest."""
    table = result.overview()[0]
    assert isinstance(table, Table)
    assert table.header == ("parameter", "unit", "mode", "median", "90 % HDI", "verdict")
    return (tuple(map(str, row)) for row in table.rows if row)


def test_a_terminal_shows_each_parameter_with_its_own_figures_and_verdict(small_result: Result) -> None:
    """Mode, median and interval are those of the summary's row, the word that of the verdicts' row."""
    verdicts = identifiability_rows(small_result)
    for cells, (name, row) in zip(shown(small_result), summary_rows(small_result).items(), strict=True):
        step = resolution(*row.hdi)
        assert cells[2:4] == (rounded(row.mode, step), rounded(row.median, step))
        ends_with_search = name == "peak_pull_slip" and row.hdi[1] == pytest.approx(0.8)
        assert cells[4] == (f"{rounded(row.hdi[0], step)} or more" if ends_with_search else interval(*row.hdi))
        word = verdicts[name].word if name in verdicts else ""
        assert cells[5].split(" with ")[0] == word
        if name in verdicts and verdicts[name].coupled_with:
            assert cells[5].endswith(PARAMETERS[verdicts[name].coupled_with].symbol)
