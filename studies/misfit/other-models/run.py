"""Two models beside those of Ding et al. 2015 on measured wheels, and what soils for Chrono lose.

``python studies/misfit/other-models/run.py`` makes the tables beside it, in about 20 minutes of processor time; a name
of a study makes its part alone. Studies that are in ``fits.csv`` are not run again: delete the tables to begin anew.

Readings are those of studies/hit-wh32 (digitised) and studies/cmu-grouser (measured). On the CMU wheel the loads are
taken as they were read, since unknown loads are dear in models that are not compiled.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pandas as pd

import bayesterra as bt
from bayesterra.analysis.export import projection
from bayesterra.parameters import CHANNELS

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from readme import filled, markdown, minus  # noqa: E402
from scripts import loaded  # noqa: E402
from stored import append, done  # noqa: E402

PAPER = ("M1", "M2", "M3")
MODELS = (*PAPER, "wong-reece", "bekker-janosi")
STUDIES: dict[str, dict[str, str]] = {
    "hit-wh32": {},
    "cmu-grouser": {
        'drive = "both" ': 'drive = "load" ',
        'load_range = ["10 N", "40 N"]\n': "",
        'normal_force = "1.2 N"\n': "",
        "[published]": "[sampling]\nmax_steps = 4000\n\n[published]",
    },
}
"""Changes of the study file, by study."""
LEFT_OUT = {("cmu-grouser", "wong-reece")}
"""What is dear: 13 rows under a model that is not compiled; stopped after eight minutes without an end."""
OPTIONS = {"hit-wh32": {"[model_options]\ntransition_slips = [0.1, 0.5]\n": ""}}
"""What the models that are not the paper's leave out."""
LEVELS = HERE.parent / "leave-slip-out" / "run.py"
"""The script that knows the shipped studies under other models."""
PROJECTED = "M1"
"""The model whose soils are written for Chrono."""


def fitted(name: str, model: str, study: bt.Study) -> tuple[bt.Result, dict[str, object]]:
    """A run and its row of fits.csv."""
    result = bt.run(study, seed=1)
    verdicts = {verdict.name.lower(): verdict.word for verdict in result.verdicts}
    loo = result.record["loo"]
    return result, {
        **{"study": name, "data": study.kind, "model": model},
        **verdicts,
        **{"elpd_loo": loo["elpd"], "elpd_loo_se": loo["se"]},
    }


def made(name: str) -> None:
    """The rows of one study in every table."""
    script = loaded(LEVELS)
    results, rows = {}, []
    for model in (one for one in MODELS if (name, one) not in LEFT_OUT):
        changes = STUDIES[name] if model in PAPER else {**STUDIES[name], **OPTIONS.get(name, {})}
        results[model], row = fitted(name, model, script.study(name, model, changes))
        rows.append(row)
        print(row, flush=True)
    comparison = bt.compare(results)
    evidences = comparison.evidences[["result", "log_evidence", "error", "difference", "difference_error"]]
    table = pd.DataFrame(rows).merge(evidences.rename(columns={"result": "model"}), on="model")
    parts = {"fits": table, "predictions": comparison.predictions, "projection": projection(results[PROJECTED])}
    for called, part in parts.items():
        if called != "fits":
            part.insert(0, "study", name)
        append(HERE / f"{called}.csv", part)


def readme_tables() -> dict[str, str]:
    """The tables of the README, from the stored ones."""
    fits, soils = pd.read_csv(HERE / "fits.csv"), pd.read_csv(HERE / "projection.csv")
    head = ("study", "data", "model", "sampling", "fit", "prediction", "log evidence", "elpd of left-out readings")
    rows = [
        (
            *row[["study", "data", "model", "sampling", "fit", "prediction"]],
            minus(f" {row['log_evidence']:.2f} ± {row['error']:.2f}").strip(),
            minus(f" {row['elpd_loo']:.1f} ± {row['elpd_loo_se']:.1f}").strip(),
        )
        for _, row in fits.iterrows()
    ]
    head_of_soils = ("study", "projected at slip", "driven at slip", "quantity", "M1", "SCM", "SCM less M1, 90 %")
    rows_of_soils = [
        (
            row["study"],
            *(f"{row[name]:.3g}" for name in ("projected_at", "slip")),
            f"{CHANNELS[row['quantity']].description} ({row['unit']})",
            *(minus(f" {row[name]:.3g}").strip() for name in ("model", "scm")),
            minus(f" {row['error_05']:.3g} to {row['error_95']:.3g}").strip(),
        )
        for _, row in soils.iterrows()
    ]
    return {"fits": markdown(head, rows, "llllllrr"), "projection": markdown(head_of_soils, rows_of_soils, "lrrlrrr")}


if __name__ == "__main__":
    for each in sys.argv[1:] or STUDIES:
        if (each,) not in done(HERE / "fits.csv", "study"):
            made(each)
    text = (HERE / "README.md").read_text(encoding="utf-8")
    (HERE / "README.md").write_text(filled(text, readme_tables()), encoding="utf-8")
