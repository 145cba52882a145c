"""A run with latent loads from readings to report."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import bayesterra as bt
from bayesterra.checking.predictive import predict_at_read_loads
from bayesterra.checking.predictive_checks import prior_checks
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.models import M2, Soil, Wheel
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study

pytestmark = pytest.mark.usefixtures("little_adaptation")

WHEEL = Wheel(0.058, 0.06, 0.005, 24, 0.5)
TRUTH = {"Ks": 1.2e6, "n0": 0.9, "n1": 0.4, "c": 500.0, "phi": 0.5, "K": 0.01, "c1": 0.4, "c2": 0.1}


def table(rng: np.random.Generator) -> pd.DataFrame:
    """Readings with noise at loads about 24 N; one row has no force, one no sinkage."""
    slip, load = np.linspace(0.05, 0.7, 12), 24.0 + rng.standard_normal(12)
    sinkage = M2().sinkage(Soil(**TRUTH), WHEEL, slip, load)
    forces = M2().forces(Soil(**TRUTH), WHEEL, slip, sinkage)
    readings = pd.DataFrame(
        {
            "slip": slip,
            "normal_force [N]": load + 1.2 * rng.standard_normal(12),
            "sinkage [mm]": 1e3 * sinkage + 1.5 + 0.5 * rng.standard_normal(12),
            "drawbar_pull [N]": forces.drawbar_pull + 0.3 * rng.standard_normal(12),
        }
    )
    readings.loc[2, "normal_force [N]"], readings.loc[5, "sinkage [mm]"] = np.nan, np.nan
    return readings


FREE = {"phi": {"dist": "uniform", "lower": "0 deg", "upper": "50 deg"}}
NOISE = {"normal_force": 1.2, "sinkage": 5e-4, "drawbar_pull": 0.3}


def test_the_prior_check_does_not_judge_the_range_of_loads() -> None:
    """Ranges ten times apart in width give the same answer, and none of them is about the normal force."""
    found = []
    for load_range in (None, ["20 N", "28 N"], ["1 N", "80 N"]):
        study = Study(
            table(np.random.default_rng(1)), {"A": WHEEL}, slip_reference="shearing", model="M2",
            drive="both", noise=NOISE, priors={**TRUTH, **FREE}, load_range=load_range,
        )  # fmt: skip
        target = posterior(study)
        x = draw_cut_prior(target, 2000, np.random.default_rng(1)).x
        found.append(prior_checks(study, predict_at_read_loads(study, target, x, np.random.default_rng(2))))
    for checks in found:
        assert {check.channel for check in checks.checks} == {"sinkage", "drawbar_pull"}
    for first, *others in zip(*(checks.checks for checks in found), strict=True):
        for other in others:
            assert abs(other.p - first.p) < 0.05, (first, other)
            assert abs(other.high - first.high) < 0.1 * (first.high - first.low), (first, other)


@pytest.mark.slow
def test_a_run_with_latent_loads(tmp_path: Path) -> None:
    """It converges, covers φ and the offset, keeps one likelihood per row, predicts forces and reports."""
    offset = {"sinkage_offset": {"dist": "norm", "scale": "2 mm"}}
    study = Study(
        table(np.random.default_rng(1)),
        {"A": WHEEL},
        slip_reference="shearing",
        model="M2",
        drive="both",
        noise=NOISE,
        priors={**TRUTH, **FREE, **offset},
        sampling=SamplingOptions(target_ess=400, walkers=32),
        least_squares={"methods": ("joint",)},
    )
    found = bt.run(study, seed=1)
    assert found.converged
    summary = found.summary.set_index("parameter")
    for name, truth in (("phi", np.degrees(0.5)), ("sinkage_offset", 1.5)):
        row = summary.loc[name]
        assert abs(row["mean"] - truth) < 4 * row["sd"]
    levels = found.draws["log_likelihood"]["readings"]
    assert levels.sizes["row"] == 12
    assert np.isfinite(levels).all()
    total = levels.sum("row") + sum(found.draws["log_prior"].sel(draw=levels["draw"]).data_vars.values())
    np.testing.assert_allclose(total, found.draws["sample_stats"]["lp"].sel(draw=levels["draw"]), rtol=1e-9)
    assert set(found.predictive["channel"]) == {"normal_force", "sinkage", "drawbar_pull"}
    found.save(tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "the load of a row is unknown" in page
    assert bt.load_result(tmp_path / "out").study.load_range == study.load_range
    judged = {check["channel"] for check in found.record["prior_checks"]["checks"]}
    assert judged == {"sinkage", "drawbar_pull"}
    assert "the range of loads is one to integrate over and no belief" in found.page().html()
