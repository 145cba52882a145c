"""How the time of `bayesterra run studies/hit-wh32` divides: the functions of its stages are clocked."""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pandas as pd
from measures import HERE

STAGES = {
    "prior draws": ("bayesterra.analysis.inference", "draw_cut_prior"),
    "adaptation and production": ("bayesterra.analysis.inference", "sample"),
    "least-squares fits": ("bayesterra.analysis.inference", "fit_all"),
    "mode": ("bayesterra.analysis.inference", "find_mode"),
    "predictions of the rows": ("bayesterra.analysis.inference", "predict_rows"),
    "prediction curves": ("bayesterra.analysis.inference", "predict_curves"),
    "validation: predictive checks": ("bayesterra.checking.predictive_checks", "predictive_checks"),
    "validation: prior checks": ("bayesterra.checking.predictive_checks", "prior_checks"),
    "validation: leave one out": ("bayesterra.checking.validation", "cross_validate"),
    "summary": ("bayesterra.analysis.inference", "summary_table"),
    "files, report and figures": ("bayesterra.study.result:AnalysisResult", "write"),
}


def clocked(call: Callable[..., Any], spent: list[float]) -> Callable[..., Any]:
    """The same function; adds wall and processor seconds of every call to ``spent``."""

    def timed(*args: Any, **kwargs: Any) -> Any:
        wall, cpu = time.perf_counter(), time.process_time()
        try:
            return call(*args, **kwargs)
        finally:
            spent[0] += time.perf_counter() - wall
            spent[1] += time.process_time() - cpu

    return timed


def divide(study: Path) -> pd.DataFrame:
    """One row per stage of a run of ``study``: wall and processor seconds."""
    started, cpu = time.perf_counter(), time.process_time()
    from bayesterra.__main__ import main
    from bayesterra.analysis import run as analysis_run

    assert analysis_run
    spent = {"imports": [time.perf_counter() - started, time.process_time() - cpu]}
    for stage, (module, name) in STAGES.items():
        home = resolve_name(module)
        spent[stage] = [0.0, 0.0]
        setattr(home, name, clocked(getattr(home, name), spent[stage]))
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        sys.argv = ["bayesterra", "run", str(study), "--out", f"{folder}/out", "--quiet"]
        with contextlib.suppress(SystemExit):
            main()
    total = [time.perf_counter() - started, time.process_time() - cpu]
    rest = [total[i] - sum(times[i] for times in spent.values()) for i in range(2)]
    table = pd.DataFrame({**spent, "all else": rest, "total": total}, index=["wall_seconds", "cpu_seconds"]).T
    return table.round(2).rename_axis("stage").reset_index()


def main(study: str = str(HERE.parents[1] / "hit-wh32")) -> None:
    """Clock one run (of code that is compiled already) and store divide.csv."""
    table = divide(Path(study))
    table.to_csv(HERE / "divide.csv", index=False)
    print(table.to_string(index=False))
