"""What each drive takes as given, and what that does to the posterior of one measured wheel.

Run it with ``python studies/recovery/drives/run.py``; it takes some minutes and rewrites ``drives.csv``.
"""

from __future__ import annotations

from pathlib import Path

import pandas as pd

import bayesterra as bt

HERE = Path(__file__).parent
DRIVES = ("load", "both", "sinkage")
LOAD_SD = 2.0
"""N, standard deviation of the normal force about the load of the test; an estimate."""
COLUMNS = ["parameter", "unit", "median", "sd", "hdi90_lo", "hdi90_hi", "prior_mean", "prior_sd", "r_hat"]


def study(drive: str) -> bt.Study:
    """The readings of ``studies/hit-wh32``, the load of the test taken as a reading of the normal force."""
    shipped = bt.load_study(HERE.parents[1] / "hit-wh32")
    rows = shipped.observations
    table = pd.DataFrame(
        {
            "slip": rows.slip,
            "normal_force [N]": rows.load,
            "sinkage [m]": rows.values["sinkage"],
            "drawbar_pull [N]": rows.values["drawbar_pull"],
            "resistance_moment [N m]": rows.values["resistance_moment"],
            "use": rows.use.astype(int),
        }
    )
    return bt.Study(
        table,
        dict(shipped.wheels),
        title=f"HIT wheel Wh32, drive '{drive}'",
        kind="digitised",
        source=shipped.source,
        slip_reference="shearing",
        drive=drive,
        noise={"normal_force": LOAD_SD, "sinkage": 1e-3, "drawbar_pull": 1.5, "resistance_moment": 0.3},
        priors={"set": "paper-box"},
        model_options={"transition_slips": [0.1, 0.5]},
    )


def summary(drive: str, seed: int = 1) -> pd.DataFrame:
    """Posterior of every parameter and derived quantity with one drive."""
    result = bt.run(study(drive), seed=seed)
    found = result.summary[COLUMNS].assign(converged=result.converged, ess=result.summary["ess_bulk"])
    found.insert(0, "drive", drive)
    return found


def main() -> None:
    """Write the table of all drives."""
    table = pd.concat([summary(drive) for drive in DRIVES])
    table.to_csv(HERE / "drives.csv", index=False, float_format="%.5g")
    wide = table.assign(text=table["median"].map("{:.3g}".format) + " ± " + table["sd"].map("{:.2g}".format))
    print(wide.pivot(index=["parameter", "unit"], columns="drive", values="text")[list(DRIVES)].to_string())


if __name__ == "__main__":
    main()
