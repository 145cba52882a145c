"""A row of a stream in the table of updates: every figure under its own name, in field units."""

import numpy as np

from bayesterra.follow.rows import Forecast, Update, cells, summary_of
from bayesterra.study.observations import Observations


def test_a_row_of_updates_has_each_figure_under_its_name() -> None:
    """Reading, quantiles in order, and the probability of a lower reading; millimetres and degrees."""
    forecast = Forecast(("sinkage",), np.array([0.012]), np.array([[0.010], [0.011], [0.013]]), np.array([0.8]), 0.1)
    quantiles = np.radians([[25.0], [30.0], [34.0]])
    update = Update(7, forecast, -1.5, -20.0, 0.25, ("phi",), quantiles, 90.0, (), 2.5, None, 0.01)
    row = Observations(
        ("A",), np.array([0.2]), np.array([80.0]), {"sinkage": np.array([0.012])}, {}, np.ones(1, dtype=np.bool_), (7,)
    )
    line = cells(update, row)
    figures = {name: float(str(line[name])) for name in line if name.startswith(("sinkage", "phi"))}
    expected = {"sinkage [mm]": 12.0, "sinkage_q05 [mm]": 10.0, "sinkage_q50 [mm]": 11.0, "sinkage_q95 [mm]": 13.0}
    expected |= {"sinkage_pit": 0.8, "phi_q05 [deg]": 25.0, "phi_q50 [deg]": 30.0, "phi_q95 [deg]": 34.0}
    assert figures.keys() == expected.keys()
    np.testing.assert_allclose([figures[name] for name in expected], list(expected.values()))
    assert [line[name] for name in ("row", "log_predictive", "log_evidence", "log_evidence_error")] == [
        7,
        -1.5,
        -20,
        0.25,
    ]
    assert [line[name] for name in ("effective", "log_statistic", "sweeps", "alarm")] == [90.0, 2.5, 0, None]


def test_a_summary_has_its_quantiles_in_order() -> None:
    """5, 50 and 95 % under their names, in field units."""
    row = summary_of(("phi",), np.radians([[25.0], [30.0], [34.0]])).iloc[0]
    np.testing.assert_allclose(row[["q05", "median", "q95"]].astype(float), [25.0, 30.0, 34.0])
