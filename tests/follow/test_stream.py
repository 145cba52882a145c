"""Rows in, updates out: what they say, what is refused, and that a stream can be put down and taken up."""

from __future__ import annotations

import json
from copy import deepcopy
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import bayesterra as bt
from bayesterra.follow.rows import Rows, cells
from bayesterra.follow.stream import State
from bayesterra.likelihood.posterior import likelihood_of
from bayesterra.parameters import PARAMETERS
from bayesterra.runtime.checkpoints import digest, pack
from bayesterra.stats.mixture import weighted_quantiles
from bayesterra.study.observations import Observations
from bayesterra.study.result import Result

GIVEN: dict[str, Any] = {"slip": 0.2, "load": 80.0, "sinkage": 0.010, "drawbar_pull": 21.0, "resistance_moment": 5.4}


def test_an_update_says_what_was_expected_and_what_is_known(streamed: bt.Stream) -> None:
    """Predictions are made before the row is used; PIT is the probability of a lower reading."""
    stream = deepcopy(streamed)
    before = stream.cloud
    update = stream.add(slip=0.2, load="80 N", sinkage="10 mm", drawbar_pull=21.0)
    assert update.row == len(streamed) + 1 == len(stream)
    table = update.predictive.set_index("channel")
    assert table.loc["sinkage", "observed"] == pytest.approx(10.0)
    assert np.isnan(update.pit["resistance_moment"])
    one = likelihood_of(stream.study, stream.rows.between(len(stream) - 1, len(stream)))
    modelled = one.predicted(one.forward(stream.study.prior.soil_values(before.x)))[:, 0]
    drawn = modelled + 0.5 * np.random.default_rng(1).standard_normal((len(modelled), 1))
    expected = before.weights @ (drawn[:, 1] < 21.0)
    assert update.pit["drawbar_pull"] == pytest.approx(expected, abs=0.12)
    low, high = weighted_quantiles(drawn[:, 1:2], before.weights, (0.05, 0.95))[:, 0]
    assert [table[key]["drawbar_pull"] for key in ("q05", "q95")] == pytest.approx([low, high], abs=0.4)
    assert update.summary.equals(stream.summary)
    scale = np.array([PARAMETERS[name].scale for name in stream.names])
    quantiles = weighted_quantiles(stream.cloud.x, stream.cloud.weights, (0.05, 0.5, 0.95)) / scale
    np.testing.assert_allclose(update.summary[["q05", "median", "q95"]].to_numpy().T, quantiles)
    assert list(update.summary.columns) == ["parameter", "unit", "median", "q05", "q95"]
    assert update.summary.set_index("parameter").loc["phi", "unit"] == "deg"


def test_the_predictive_densities_add_up_to_the_likelihood_of_all_rows(streamed: bt.Stream) -> None:
    """Particles carry the log likelihood of all rows, whatever was resampled and moved on the way."""
    density = bt.Posterior(streamed.study.prior, likelihood_of(streamed.study, streamed.rows.first()))
    _, likelihood = density.log_prior_and_likelihood(streamed.cloud.x)
    assert np.allclose(streamed.cloud.log_likelihood, likelihood, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"slip": 1.2}, r"'slip' must lie in \[0, 1\) \(got 1.2, row 25\)"),
        ({"load": -80.0}, r"'load' must be above 0 \(got -80 N, row 25\)"),
        ({"load": None}, r"row 25: the drive 'load' needs a column 'load \[N\]' or 'normal_force \[N\]'"),
        ({"sinkage": "3 N"}, r"'sinkage': the unit 'N' is not a unit of length"),
        ({"sinkag": 0.01}, r"unknown column 'sinkag' \(did you mean 'sinkage'\?\)"),
        ({"use": 0}, r"'use' must be 1 in a row that is added \(got 0, row 25\)"),
    ],
)
def test_a_row_that_cannot_be_used_is_refused_in_one_line(
    streamed: bt.Stream, wrong: dict[str, Any], message: str
) -> None:
    """The message names row, column, rule and value; the stream stays as it was."""
    with pytest.raises(bt.StudyError, match=message):
        streamed.add(**{**GIVEN, **wrong})
    assert len(streamed) == 24


def test_a_row_without_an_answer_leaves_the_stream_as_it_was(streamed: bt.Stream) -> None:
    """No soil carries a hundred tonnes."""
    stream = deepcopy(streamed)
    with pytest.raises(bt.SupportError, match="row 25: the model has no answer in this row for any soil"):
        stream.add(slip=0.2, load=1e6, sinkage=0.01)
    assert len(stream) == 24
    again, first = stream.add(**GIVEN), deepcopy(streamed).add(**GIVEN)
    assert np.array_equal(again.quantiles, first.quantiles)


def test_rows_of_tables_are_the_same_rows(plan: bt.Study) -> None:
    """Keywords in SI, text with units, a row of a table: one and the same."""
    units = {"slip": 0.2, "load [N]": 80.0, "sinkage [mm]": 10.0, "drawbar_pull [N]": 21.0}
    table = pd.DataFrame({**{k: [v] for k, v in units.items()}, "resistance_moment [N m]": [5.4]})
    found = []
    for how in (GIVEN, {**GIVEN, "sinkage": "10 mm"}, table, table.iloc[0]):
        stream = bt.Stream(plan, particles=100)
        update = stream.add(**how) if isinstance(how, dict) else stream.add(how)
        found.append(update.quantiles)
    assert all(np.allclose(found[0], one, rtol=1e-9) for one in found[1:])
    with pytest.raises(bt.StudyError, match=r"one row is added at a time \(got 2 rows\)"):
        bt.Stream(plan).add(pd.concat([table, table]))


def test_settings_that_make_no_sense_are_refused(plan: bt.Study) -> None:
    """Too few particles, a rate that is none."""
    with pytest.raises(bt.StudyError, match=r"'particles' must be at least 100 \(got 10\)"):
        bt.Stream(plan, particles=10)
    with pytest.raises(bt.StudyError, match=r"'false_alarms' must lie between 0 and 1 \(got 2\)"):
        bt.Stream(plan, false_alarms=2.0)


def test_a_saved_stream_goes_on_bit_for_bit(streamed: bt.Stream, rows: list[Observations], tmp_path: Path) -> None:
    """Particles, evidence and the watch are those of a stream that was never put down."""
    half = bt.Stream(streamed.study, seed=3, particles=200)
    for row in rows[:12]:
        half.learn(row)
    half.save(tmp_path / "half")
    taken_up = bt.load_stream(tmp_path / "half")
    for row in rows[12:]:
        taken_up.learn(row)
    assert np.array_equal(taken_up.cloud.x, streamed.cloud.x)
    assert taken_up.log_evidence == streamed.log_evidence
    assert np.array_equal(taken_up.watch.candidates.log_factors, streamed.watch.candidates.log_factors)
    with pytest.raises(bt.ResultError, match="exists already"):
        half.save(tmp_path / "half")


def test_a_damaged_stream_is_refused(streamed: bt.Stream, tmp_path: Path) -> None:
    """Another table, a broken segment, a folder of another kind."""
    streamed.save(tmp_path / "stream")
    table = tmp_path / "stream" / "measurements.csv"
    kept = table.read_text()
    table.write_text(kept.rsplit("\n", 2)[0] + "\n")
    with pytest.raises(bt.ResultError, match=r"measurements.csv' is damaged or was changed"):
        bt.load_stream(tmp_path / "stream")
    (tmp_path / "stream" / "SHA256SUMS").unlink()
    with pytest.raises(bt.ResultError, match="its particles belong to another study or other rows"):
        bt.load_stream(tmp_path / "stream")
    table.write_text(kept)
    segment = tmp_path / "stream" / "state" / "state.segment"
    segment.write_bytes(segment.read_bytes()[:-7])
    with pytest.raises(bt.ResultError, match="the particles cannot be read"):
        bt.load_stream(tmp_path / "stream")
    with pytest.raises(bt.ResultError, match=r"is not the folder of a stream: it has no stream\.json"):
        bt.load_stream(tmp_path)
    with pytest.raises(bt.ResultError, match="the stream has no row yet"):
        bt.Stream(streamed.study).save(tmp_path / "empty")
    assert not (tmp_path / "empty").exists()


def test_memory_beyond_the_rows_does_not_grow(streamed: bt.Stream, rows: list[Observations]) -> None:
    """What a stream holds besides its rows has a fixed size; the rows take at most twice their own."""

    def size(stream: bt.Stream) -> int:
        watch = stream.watch
        state = State(stream.cloud, stream._before, watch.candidates.take(np.arange(8)), 0, 0.0, 0.0, None)
        return sum(array.nbytes for array in pack(state).values())

    short = bt.Stream(streamed.study, seed=3, particles=200)
    for row in rows[:12]:
        short.learn(row)
    assert size(short) == size(streamed)
    store = Rows.of(streamed.study)
    for _ in range(1000):
        store.append(rows[0])
    assert len(store) == 1000
    assert store._cells.nbytes <= 2 * 1000 * 8 * store._cells.shape[1]


def test_a_result_is_gone_on_from(small_result: Result) -> None:
    """Its draws are the posterior of its rows, which stay in; its evidence is added to."""
    stream = bt.Stream(small_result, particles=200)
    rows = len(small_result.study.observations.used())
    assert len(stream) == rows
    assert stream.log_evidence == small_result.record["evidence"]["log_z"]
    held = {tuple(x) for x in small_result.values()}
    assert all(tuple(x) in held for x in stream.cloud.x)
    update = stream.add(slip=0.3, load=80.0, sinkage=0.0135, drawbar_pull=22.0)
    assert update.row == rows + 1
    assert update.log_evidence == pytest.approx(stream.log_evidence)
    density = bt.Posterior(stream.study.prior, likelihood_of(stream.study, stream.rows.first()))
    _, likelihood = density.log_prior_and_likelihood(stream.cloud.x)
    assert np.allclose(stream.cloud.log_likelihood, likelihood, rtol=0, atol=1e-7)


def test_beginning_anew_uses_the_rows_since_the_change_only(streamed: bt.Stream) -> None:
    """Row numbers go on; what is learned is what a fresh stream learns from these rows."""
    anew = streamed.restarted(15)
    assert (len(anew), anew.offset) == (10, 14)
    assert anew.add(**GIVEN).row == 25
    with pytest.raises(bt.StudyError, match=r"'since' must be one of the rows 1 to 24 \(got 40\)"):
        streamed.restarted(40)


def test_a_stream_of_an_earlier_plain_form_is_read(streamed: bt.Stream, tmp_path: Path) -> None:
    """Its fingerprint of the study cannot be compared; its rows are."""
    streamed.save(tmp_path / "stream")
    begun = tmp_path / "stream" / "state" / "begun.json"
    content = json.loads(begun.read_text())
    identity = {"study": "of another form", "rows": content["identity"]["rows"]}
    begun.write_text(json.dumps({"run": digest(identity), "identity": identity}))
    segment = tmp_path / "stream" / "state" / "state.segment"
    body = segment.read_bytes().partition(b"\n")[2].replace(content["run"].encode(), digest(identity).encode())
    segment.write_bytes(sha256(body).hexdigest().encode() + b"\n" + body)
    (tmp_path / "stream" / "SHA256SUMS").unlink()
    assert np.array_equal(bt.load_stream(tmp_path / "stream").cloud.x, streamed.cloud.x)
    others = {**identity, "rows": "others"}
    begun.write_text(json.dumps({"run": digest(identity), "identity": others}))
    with pytest.raises(bt.ResultError, match=r"begun\.json' is damaged: this is not what was written"):
        bt.load_stream(tmp_path / "stream")
    begun.write_text(json.dumps({"run": digest(others), "identity": others}))
    with pytest.raises(bt.ResultError, match="its particles belong to another study or other rows"):
        bt.load_stream(tmp_path / "stream")


def test_a_line_of_the_table_says_what_the_update_says(streamed: bt.Stream) -> None:
    """Conditions, forecasts, evidence and bands of a row stand in its own line, each under its name."""
    stream = deepcopy(streamed)
    update = stream.add(**GIVEN)
    line = cells(update, stream.rows.between(len(stream) - 1, len(stream)))
    assert (line["row"], line["slip"], line["load [N]"]) == (25, 0.2, 80.0)
    for reading in update.forecast.table.to_dict("records"):
        channel, unit = reading["channel"], reading["unit"]
        assert line[f"{channel} [{unit}]"] == reading["observed"]
        for key in ("q05", "q50", "q95"):
            assert line[f"{channel}_{key} [{unit}]"] == reading[key]
        assert line[f"{channel}_pit"] == update.pit[channel]
    for row in stream.summary.to_dict("records"):
        unit = "" if row["unit"] == "-" else f" [{row['unit']}]"
        bands = [line[f"{row['parameter']}_{key}{unit}"] for key in ("q05", "q50", "q95")]
        assert bands == pytest.approx([row["q05"], row["median"], row["q95"]], rel=1e-12)
    assert line["log_evidence"] == stream.log_evidence
    assert line["effective"] == pytest.approx(1.0 / np.sum(stream.cloud.weights**2))
