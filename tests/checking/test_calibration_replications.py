"""Replications: what is simulated, what is counted, and that nothing depends on who ran it when."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence, default_rng

from bayesterra.checking.calibration import calibrate, replicated, spaced
from bayesterra.checking.short_runs import Fitted, ShortRuns
from bayesterra.errors import StudyError, SupportError
from bayesterra.runtime.engines import in_process, local_pool
from bayesterra.study.study import Study

from .conftest import MakeStudy, exact


def test_readings_are_made_where_there_are_some(make_small: MakeStudy) -> None:
    """Empty cells stay empty, rows out of the fit and everything given stay as they are."""
    study = make_small("phi")
    _, simulated = replicated(study, default_rng(1))
    old, new = study.observations, simulated.observations
    for name in ("sinkage", "drawbar_pull"):
        np.testing.assert_array_equal(np.isnan(old.values[name]), np.isnan(new.values[name]))
        np.testing.assert_array_equal(old.values[name][~old.use], new.values[name][~old.use])
        known = old.use & ~np.isnan(old.values[name])
        assert (old.values[name][known] != new.values[name][known]).all()
    np.testing.assert_array_equal(old.load, new.load)


def test_in_the_sinkage_drive_the_sinkage_is_given(make_small: MakeStudy) -> None:
    """Forces are drawn, the sinkage column is kept."""
    data = pd.DataFrame({"slip": [0.1, 0.3], "sinkage [mm]": [5.0, 9.0], "normal_force [N]": 80.0})
    study = make_small("phi", data=data, drive="sinkage")
    _, simulated = replicated(study, default_rng(1))
    np.testing.assert_array_equal(simulated.observations.values["sinkage"], study.observations.values["sinkage"])
    assert (simulated.observations.values["normal_force"] != 80.0).all()


def test_latent_loads_come_from_their_flat_prior(make_small: MakeStudy) -> None:
    """Simulated normal forces spread over the load range as uniform loads with noise do."""
    data = pd.DataFrame({"slip": [0.1, 0.3], "sinkage [mm]": 5.0, "normal_force [N]": 80.0})
    study = make_small("phi", data=data, drive="both", load_range=("40 N", "120 N"))
    rng = default_rng(1)
    forces = [replicated(study, rng)[1].observations.values["normal_force"] for _ in range(200)]
    assert abs(np.mean(forces) - 80.0) < 4 * 80 / np.sqrt(12 * 400)
    assert abs(np.std(forces) - np.hypot(80 / np.sqrt(12), 2.0)) < 3.0


@pytest.mark.slow
def test_ranks_do_not_depend_on_the_number_of_workers(make_small: MakeStudy, quick: ShortRuns) -> None:
    """One process and two give the same table but for the time it took."""
    study = make_small("K", noise={"sinkage": 50e-3, "drawbar_pull": 100.0})
    with in_process() as here, local_pool(2) as there:
        tables = [calibrate(study, n=20, seed=7, engine=one, fit=quick).table for one in (here, there)]
    first, second = (table.drop(columns="seconds") for table in tables)
    pd.testing.assert_frame_equal(first, second)


def test_another_seed_gives_other_ranks_and_more_replications_keep_the_first(make_small: MakeStudy) -> None:
    """Every replication has its own stream, from the seed and its number."""
    study = make_small("phi")
    few, more = (calibrate(study, n=n, seed=7, fit=exact).table for n in (20, 30))
    pd.testing.assert_series_equal(few["phi"], more["phi"].head(20))
    assert not np.isclose(calibrate(study, n=20, seed=8, fit=exact).table["phi"], few["phi"]).any()


def troubled(study: Study, seed: SeedSequence) -> Fitted:
    """One replication in four fails, one in four does not converge."""
    kind = int(seed.spawn_key[0]) % 4
    if kind == 0:
        raise FloatingPointError("log density is NaN")
    fitted = exact(study, seed)
    return Fitted(fitted.draws, 50.0, 1.1, converged=kind > 1)


def test_what_did_not_converge_is_counted_and_nothing_is_established(make_small: MakeStudy) -> None:
    """Failed and unconverged replications stay in the table, and too many of them forbid a verdict."""
    found = calibrate(make_small("phi"), n=40, fit=troubled)
    assert found.table["status"].value_counts().to_dict() == {
        "converged": 20, "failed": 10, "not converged": 10,
    }  # fmt: skip
    assert (found.unsettled, found.ranked, len(found.ranks("phi"))) == (20, 30, 30)
    assert found.table.loc[3, "note"] == "FloatingPointError: log density is NaN"
    assert (found.verdict, found.calibrated) == ("not established", False)


def test_nothing_but_failures_is_no_verdict(make_small: MakeStudy) -> None:
    """A sampler that always fails gives a result that says so."""

    def broken(study: Study, seed: SeedSequence) -> Fitted:
        raise StudyError("no")

    found = calibrate(make_small("phi"), n=20, fit=broken)
    assert (found.verdict, found.tested, found.ranked) == ("not established", (), 0)


def test_draws_are_taken_from_all_stretches() -> None:
    """Each hundredth of the chains gives one draw."""
    chosen = spaced(np.arange(9900.0)[:, None], default_rng(1))[:, 0]
    np.testing.assert_array_equal(chosen // 100, np.arange(99))


def test_mistakes_are_named_before_any_work(make_small: MakeStudy) -> None:
    """Too few replications, nothing free, no support: one line each."""
    with pytest.raises(StudyError, match=r"'n' must be at least 20 replications.*\(got 5\)"):
        calibrate(make_small("phi"), n=5)
    with pytest.raises(StudyError, match="every parameter is fixed: there is nothing to calibrate"):
        calibrate(make_small(), n=20)
    heavy = pd.DataFrame({"slip": [0.1], "load [N]": 1e9, "sinkage [mm]": 5.0})
    with pytest.raises(SupportError, match="no parameter set of the prior fits"):
        calibrate(make_small("phi", data=heavy), n=20)
