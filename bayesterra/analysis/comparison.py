"""Comparison of results side by side: two models, two priors, two tables."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from itertools import chain
from pathlib import Path

import numpy as np
import pandas as pd

from bayesterra.analysis.result import is_pooled, read_pooled, read_result
from bayesterra.checking.loo import CrossValidation, Difference, difference
from bayesterra.errors import ResultError, StudyError, check_kind, checked_path
from bayesterra.likelihood.forward import reference_load
from bayesterra.parameters import DERIVED, PARAMETERS
from bayesterra.prediction.prediction import Prediction, predict
from bayesterra.runtime.folders import check_free
from bayesterra.study.result import AnalysisResult, Result
from bayesterra.study.study import without_wheels
from bayesterra.study.wheels import GRID, chosen_wheel

MOST = 6
BARE = 1.0
"""Difference of log evidence that is not worth more than a bare mention (Kass and Raftery 1995)."""
STRENGTHS = ((3.0, "positive"), (5.0, "strong"), (np.inf, "very strong"))
"""Their words for greater differences, by upper limit."""
MOVED = 1.0
"""Shift of a mean, in standard deviations of the first result, from which a parameter has moved."""


@dataclass(frozen=True)
class Evidence:
    """Log evidence of one result."""

    value: float  # log of the density of the readings, averaged over the prior that is cut to the physical support
    error: float  # its standard error, from the importance weights and the count behind the cut
    outcomes: str  # fingerprint of the readings it is the density of; only equal ones compare
    reliable: bool = True  # whether the run found that value and error hold


@dataclass(frozen=True)
class Comparison(AnalysisResult):
    """Several results, and what they say under the same conditions.

    Attributes
    ----------
    results : by name, in the order given; others are compared with the first.
    curves, points : per result the prediction of its wheel under one and the same load, on a grid over all
        driven slips, and at the driven slips themselves.
    evidence : per result.
    loo : cross-validation per result, for those that hold it.
    """

    MARK = "comparison.csv"
    RECORD = None
    VIEW = "bayesterra.analysis.comparison_page:comparison"
    PAGE = "comparison.html"
    CALLED = "Page"
    DIGITS = None

    results: Mapping[str, Result]
    curves: Mapping[str, Prediction]
    points: Mapping[str, Prediction]
    evidence: Mapping[str, Evidence]
    loo: Mapping[str, CrossValidation]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the results."""
        return tuple(self.results)

    @cached_property
    def parameters(self) -> pd.DataFrame:
        """One row per result and free parameter or derived quantity, field units.

        ``shift`` is the mean's distance from that of the first result, and ``width`` the standard deviation,
        in units of the first result's. Derived quantities are those of the common load.
        """
        return pd.DataFrame(list(chain.from_iterable(self._rows(name) for name in self.names)))

    def _rows(self, name: str) -> list[dict[str, object]]:
        first = _moments(self.names[0], self)
        rows: list[dict[str, object]] = []
        for quantity, row in _moments(name, self).items():
            shift = width = np.nan
            if (base := first.get(quantity)) and base["sd"] > 0:
                shift, width = (row["mean"] - base["mean"]) / base["sd"], row["sd"] / base["sd"]
            unit = (PARAMETERS.get(quantity) or DERIVED[quantity]).unit
            head = {"result": name, "quantity": quantity, "unit": unit}
            rows.append({**head, **row, "shift": shift, "width": width})
        return rows

    @property
    def predictions(self) -> pd.DataFrame:
        """Bands of every result at the slips of ``points``."""
        tables = [prediction.table.assign(result=name) for name, prediction in self.points.items()]
        table = pd.concat(tables, ignore_index=True)
        return table[["result", *(column for column in table.columns if column != "result")]]

    @property
    def evidences(self) -> pd.DataFrame:
        """One row per result: log evidence, its error, difference from the first and what that amounts to."""
        first = self.names[0]
        return pd.DataFrame(
            [
                {
                    "result": name,
                    "model": self.results[name].study.model.name,
                    "drive": self.results[name].study.drive,
                    "log_evidence": self.evidence[name].value,
                    "error": self.evidence[name].error,
                    "reliable": self.evidence[name].reliable,
                    "difference": self.difference(first, name)[0],
                    "difference_error": self.difference(first, name)[1],
                    "word": "" if name == first else self.word(first, name),
                    **self._left_out(first, name),
                }
                for name in self.names
            ]
        )

    def _left_out(self, first: str, name: str) -> dict[str, object]:
        """Cross-validation of one result, and its difference from the first."""
        nothing = Difference(np.nan, np.nan)
        loo, change = self.loo.get(name, nothing), self.left_out(first, name) or nothing
        return {
            "elpd": loo.elpd,
            "elpd_se": loo.se,
            "elpd_difference": change.elpd,
            "elpd_difference_se": change.se,
            "elpd_word": "" if name == first else self.left_out_word(first, name),
        }

    def left_out(self, first: str, second: str) -> Difference | None:
        """Elpd of ``second`` less that of ``first``; None where they do not compare."""
        if not self.comparable(first, second) or not {first, second} <= set(self.loo):
            return None
        return difference(self.loo[second], self.loo[first])

    def left_out_word(self, first: str, second: str) -> str:
        """Verdict of leaving rows out between two results."""
        elpd_difference = self.left_out(first, second)
        if elpd_difference is None:
            return "not comparable" if not self.comparable(first, second) else "not known"
        if not elpd_difference.distinguishable:
            return "not distinguishable"
        return f"{second if elpd_difference.elpd > 0 else first} predicts better"

    def comparable(self, first: str, second: str) -> bool:
        """True where both results explain the same readings of the same channels."""
        return self.evidence[first].outcomes == self.evidence[second].outcomes

    def difference(self, first: str, second: str) -> tuple[float, float]:
        """Log evidence of ``second`` less that of ``first`` and its error; NaN where they do not compare."""
        if not self.comparable(first, second):
            return np.nan, np.nan
        reference, other = self.evidence[first], self.evidence[second]
        error = 0.0 if first == second else float(np.hypot(reference.error, other.error))
        return other.value - reference.value, error

    def word(self, first: str, second: str) -> str:
        """Verdict of the evidence between two results."""
        value, error = self.difference(first, second)
        if np.isnan(value):
            return "not comparable" if not self.comparable(first, second) else "not known"
        doubtful = [name for name in (first, second) if not self.evidence[name].reliable]
        if doubtful:
            return f"not known: the evidence of {' and '.join(doubtful)} cannot be relied on"
        if abs(value) < max(BARE, 2 * error):
            return "not distinguishable"
        strength = next(word for limit, word in STRENGTHS if abs(value) < limit)
        return f"{strength} evidence for {second if value > 0 else first}"

    def tables(self) -> dict[str, pd.DataFrame]:
        """Parameters, predictions and evidence."""
        return {"comparison": self.parameters, "predictions": self.predictions, "evidence": self.evidences}


def log_evidence(result: Result) -> Evidence:
    """Log evidence of a result under its cut prior: the share of the stated one in it is divided out."""
    entry = result.record.get("evidence")
    if entry is None:
        return Evidence(np.nan, np.nan, outcomes_of(result))
    error = float(np.hypot(entry["error"], entry["log_share_error"]))
    value = entry["log_z"] - entry["log_share"]
    return Evidence(value, error, outcomes_of(result), bool(entry.get("reliable", True)))


def outcomes_of(result: Result) -> str:
    """SHA-256 of what the likelihood is a density of: readings and limits of the rows in use, and of soil tests."""
    rows, tests = result.study.observations.used(), result.study.soil_tests
    content = {name: rows.values[name].tolist() for name in sorted(result.study.noise)}
    content |= {f"limits of {name}": ends.tolist() for name, ends in sorted(rows.limits.items())}
    for name, of in sorted((name, test.readings) for name, test in tests.items()):
        content[f"{of.kind} tests {name}"] = [each.tolist() for each in (of.test, of.path, of.level, of.stress)]
    return sha256(json.dumps(content).encode()).hexdigest()


_MOMENTS = ("mode", "median", "mean", "sd", "hdi90_lo", "hdi90_hi", "prior_mean", "prior_sd")


def _moments(name: str, comparison: Comparison) -> dict[str, dict[str, float]]:
    """Rows of the parameters from the summary, then of the derived quantities under the common load."""
    summary, derived = comparison.results[name].summary, comparison.curves[name].derived_table
    rows: dict[str, dict[str, float]] = {
        str(row["parameter"]): {key: float(row[key]) for key in _MOMENTS}
        for row in summary.to_dict("records")
        if row["parameter"] in PARAMETERS
    }
    for row in derived.to_dict("records"):
        rows[str(row["quantity"])] = {key: float(row.get(key, np.nan)) for key in _MOMENTS}
    return rows


def compare(
    results: Mapping[str, Result] | Sequence[str | Path],
    *,
    load: float | str | None = None,
    wheel: str | Path | None = None,
) -> Comparison:
    """Set results side by side: parameters, predictions under one load, evidence.

    Parameters
    ----------
    results : two to six by the names they are to go by, or their folders. Others are compared with the first.
        Of a joint posterior each group is one of them.
    load : under which all predict, N or text with a unit; by default the first result's median load.
    wheel : that all drive, by its name in one of the studies or in a file. By default each drives its own:
        the one that the study of the first calls its first, or else its first.

    Raises
    ------
    ResultError : too few or too many results, or a folder that cannot be read.
    StudyError : an unknown wheel, or no load is known to compare them under.
    """
    whole = _named(results).items()
    parts = ((name, group, own) for name, result in whole for group, own in result.by_group().items())
    named = {f"{name}: {group}" if group else name: own for name, group, own in parts}
    if not 2 <= len(named) <= MOST:
        raise ResultError(f"two to {MOST} results can be compared (got {len(named)})")
    first = next(iter(named.values()))
    for result in named.values():
        without_wheels(result.study, "compare")
    common = None
    if wheel is not None:
        knowing = (result for result in named.values() if str(wheel) in result.study.wheels)
        common = chosen_wheel(next(knowing, first).study, str(wheel))
    load = reference_load(first.study) if load is None else load
    driven = np.unique(np.concatenate([result.study.observations.used().slip for result in named.values()]))
    grid = np.linspace(driven[0], driven[-1], GRID)
    curves = {}
    for name, result in named.items():
        own = next(iter(first.study.wheels))
        called, dimensions = common or chosen_wheel(result.study, own if own in result.study.wheels else None)
        curves[name] = predict(result, np.union1d(grid, driven), load=load, wheel=dimensions, name=called)
    return Comparison(
        named,
        {name: curve.at(grid) for name, curve in curves.items()},
        {name: curve.at(driven) for name, curve in curves.items()},
        {name: log_evidence(result) for name, result in named.items()},
        {
            name: CrossValidation.from_record(result.record["loo"])
            for name, result in named.items()
            if result.record.get("loo")
        },
    )


def _named(results: object) -> Mapping[str, Result]:
    """The results to compare by name, read where they are folders."""
    if isinstance(results, Mapping):
        for result in results.values():
            check_kind("bt.compare", result, Result)
        return {str(name): result for name, result in results.items()}
    if not isinstance(results, list | tuple):
        got = repr(results) if isinstance(results, str) else type(results).__name__
        raise StudyError(f"bt.compare needs a list of result folders, or results by name (got {got})")
    what = "a result folder in its list (results themselves go by name: {'a': result})"
    return load_results([checked_path("bt.compare", folder, what) for folder in results])


def load_results(folders: Sequence[Path]) -> dict[str, Result]:
    """Read result folders, by the names of the folders, made different where they are the same."""
    results: dict[str, Result] = {}
    for folder in folders:
        name = folder.resolve().name.removesuffix("-result") or str(folder)
        names = (name, *(f"{name} ({number})" for number in range(2, len(folders) + 2)))
        free = next(each for each in names if each not in results)
        results[free] = read_pooled(folder) if is_pooled(folder) else read_result(folder)
    return results


def compare_folders(
    folders: Sequence[Path], out: Path, *, load: str | None = None, wheel: str | None = None, overwrite: bool = False
) -> Comparison:
    """Compare result folders and write the page and its tables to ``out``; options as :func:`compare`."""
    check_free(out, overwrite=overwrite, mark=Comparison.MARK)
    comparison = compare(folders, load=load, wheel=wheel)
    comparison.save(out, overwrite=overwrite)
    return comparison
