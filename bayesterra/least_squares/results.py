"""Point estimates: fits of least squares, their table, and how dense the posterior is where they stand."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.posterior import INSIDE, REASONS, Posterior
from bayesterra.models import Soil
from bayesterra.parameters import CHANNELS, HELD, MODEL_PARAMETERS, MODULI, PARAMETERS, PRIOR_PARAMETERS
from bayesterra.study.study import Study

if TYPE_CHECKING:
    from bayesterra.report.blocks import Table

FORCES = ("normal_force", "drawbar_pull", "resistance_moment")
"""The channels that IM1, IM2 and IM3 fit."""

METHODS = ("IM1", "IM2", "IM3", "joint")
CONDITIONAL = "conditional"
"""The posterior mode with those parameters held that these methods held."""
SOLVERS = ("converged", "lsqcurvefit")
ESTIMATES = (CONDITIONAL, *METHODS, *(f"{method} lsqcurvefit" for method in METHODS[:-1]))
"""Names that fits go by beside other estimates."""


@dataclass(frozen=True)
class Fit:
    """Soil parameters found by one method, and how it went.

    Attributes
    ----------
    method : ``IM1``, ``IM2``, ``IM3`` or ``joint``.
    soil : the parameters, SI and radians. Those in ``missing`` stand at their start values.
    errors : fit error, Ding et al. 2015, (16), of each channel in percent, NaN where it was not measured or not
        fitted. IM1 and joint are judged by their model, IM2 and IM3 by their equations with F_N and M_DR put in.
    converged : the passes met the criterion and every inner fit ended at a minimum.
    passes : passes of IM1, rounds of noise weights of joint, else 1.
    path : the parameters after each pass.
    held : parameters that were not free.
    at_bound : free parameters within 1e-4 of their range from a bound.
    missing : parameters that could not be identified; ``notes`` say why.
    clipped : at some slip, θm/θ1 (or N) was clipped to the model's range; with joint, it is at its edge.
    notes : in words, one line each.
    seconds : time taken.
    noise : typical standard deviation of each channel behind the weights of joint, SI; else empty.
    solver : ``converged``, or ``lsqcurvefit``: an emulation of the paper's, whose result hangs on its start.
    evaluations : of all inner fits together.
    """

    method: str
    soil: Soil | SimpleNamespace
    errors: Mapping[str, float]
    converged: bool
    passes: int
    path: tuple[Soil | SimpleNamespace, ...]
    held: tuple[str, ...]
    at_bound: tuple[str, ...]
    missing: tuple[str, ...]
    clipped: bool
    notes: tuple[str, ...]
    seconds: float
    noise: Mapping[str, float]
    solver: str = "converged"
    evaluations: int = 0

    @property
    def name(self) -> str:
        """The method, with its solver unless that is the usual one: one of ``ESTIMATES``."""
        return self.method if self.solver == "converged" else f"{self.method} {self.solver}"

    def values(self) -> dict[str, float]:
        """Soil parameters by name, SI and radians."""
        return {name: float(getattr(self.soil, name)) for name in MODEL_PARAMETERS if hasattr(self.soil, name)}

    def identified(self) -> dict[str, float]:
        """Soil parameters by name without those that the data could not tell."""
        return {name: value for name, value in self.values().items() if name not in self.missing}


def error_figure(measured: FloatArray, predicted: FloatArray) -> float:
    """Largest misfit in percent of the largest reading, Ding et al. 2015, eq. (16).

    Readings that are NaN count for nothing; NaN where there is no reading or every reading is 0.
    """
    read = ~np.isnan(measured)
    if not np.any(measured[read]):
        return float("nan")
    return float(100 * np.max(np.abs(measured - predicted)[read]) / np.max(np.abs(measured[read])))


COLUMNS = ("method", "parameter", "unit", "value", "published", "credible_level")


def report_table(fits: Mapping[str, Fit], study: Study | None = None) -> pd.DataFrame:
    """One row per method and parameter, then ``error_<channel>`` in percent; values in field units.

    A column ``solver`` stands behind ``method`` where another one than the usual was at work. A parameter that
    a method could not identify has the value NaN. ``published`` comes from the study;
    ``credible_level`` is NaN until a posterior fills it.
    """
    published = study.published.values if study and study.published else {}
    rows = [(fit.solver, *row) for fit in fits.values() for row in _rows(fit, published)]
    table = pd.DataFrame(rows, columns=["solver", *COLUMNS])
    solvers = table.pop("solver")
    if any(fit.solver != "converged" for fit in fits.values()):
        table.insert(1, "solver", solvers)
    return table


def _rows(fit: Fit, published: Mapping[str, float]) -> Iterator[tuple[str, str, str, float, float, float]]:
    for name, value in fit.values().items():
        if name in fit.held and value == HELD.get(name):
            continue  # as it is by default: nothing to tell
        unit, scale = PARAMETERS[name].unit, PARAMETERS[name].scale
        shown = np.nan if name in fit.missing else value / scale
        yield fit.method, name, unit, shown, published.get(name, np.nan) / scale, np.nan
    for channel, error in fit.errors.items():
        yield fit.method, f"error_{channel}", "%", error, np.nan, np.nan


def point_rows(
    method: str, values: Mapping[str, float], study: Study
) -> Iterator[tuple[str, str, str, float, float, float]]:
    """Rows of :func:`report_table` for parameters (SI) that another method found."""
    published = study.published.values if study.published else {}
    for name, value in values.items():
        scale = PARAMETERS[name].scale
        yield method, name, PARAMETERS[name].unit, value / scale, published.get(name, np.nan) / scale, np.nan


def print_fits(fits: Mapping[str, Fit], study: Study) -> None:
    """Print the fits side by side, with published values where there are any, and what to know of each."""
    from bayesterra.report.blocks import Text
    from bayesterra.report.terminal import show

    sentences = [f"Warning: {warning}" for warning in study.warnings]
    sentences += [f"{name}: {_sentence(fit)}" for name, fit in fits.items()]
    key = Text("= held   | at a bound   – not identified   errors: largest misfit / largest reading, (16)")
    solved = ({name: fit for name, fit in fits.items() if fit.solver == solver} for solver in SOLVERS)
    show((*(_side_by_side(some, study) for some in solved if some), key), *sentences)


def _side_by_side(fits: Mapping[str, Fit], study: Study) -> "Table":
    """Fits by one solver, with published or true values where there are any."""
    from bayesterra.report.blocks import Table

    reference = study.published or study.truth
    known = ("truth" if reference is study.truth else "published",) if reference else ()
    lines = []
    for name, unit in report_table(fits).drop_duplicates("parameter")[["parameter", "unit"]].itertuples(index=False):
        value = reference.values.get(name) if reference else None
        stated = ["" if value is None else f"{value / PARAMETERS[name].scale:.4g}"] if reference else []
        channel = CHANNELS.get(name.removeprefix("error_"))
        symbol = f"error of {channel.symbol}" if channel else PARAMETERS[name].symbol
        lines.append((symbol, unit, *(_cell(fit, name) for fit in fits.values()), *stated))
    header = ("parameter", "unit", *(fit.method for fit in fits.values()), *known)
    emulated = any(fit.solver != "converged" for fit in fits.values())
    title = "Least squares as by lsqcurvefit, an emulation" if emulated else "Least squares"
    title = f"{title}: {study.title}" if study.title else title
    return Table(title, "ll" + "r" * (len(header) - 2), header, tuple(lines))


def _cell(fit: Fit, name: str) -> str:
    value = {row[1]: row[3] for row in _rows(fit, {})}.get(name, np.nan)
    if np.isnan(value):
        return "–"
    mark = "= " if name in fit.held else "| " if name in fit.at_bound else ""
    return f"{mark}{value:.4g}"


def _sentence(fit: Fit) -> str:
    clauses = ["converged" if fit.converged else "did not converge"]
    if fit.passes > 1:
        clauses.append(f"{fit.passes} {'rounds of weights' if fit.method == 'joint' else 'passes'}")
    if fit.solver != "converged":
        clauses.append(f"{fit.evaluations} evaluations")
    return "; ".join([*clauses, f"{fit.seconds:.2f} s", *fit.notes])


def of_fit(fitted: Fit) -> dict[str, Any]:
    """End of a least-squares fit in words."""
    return {
        "converged": fitted.converged,
        "passes": fitted.passes,
        "errors_percent": dict(fitted.errors),
        **{name: list(getattr(fitted, name)) for name in ("held", "at_bound", "missing", "notes")},
    }


@dataclass(frozen=True)
class PointEstimate:
    """Place of a point estimate in the posterior.

    Attributes
    ----------
    method : name of the estimate.
    values : soil parameters, SI and radians, by name.
    log_density : log posterior density there, −inf outside the support.
    credible_level : share of the draws with a higher density (1 outside the support). Near 0 the estimate is
        a typical good fit; above 0.99 practically no draw is as improbable.
    reason : why the density is zero there, "" where it is not.
    at_bound : free parameters that sit on the edge of their prior's range.
    filled : free soil parameters that the estimate does not give; they stand at the posterior median, so its
        density says little about the estimate.
    """

    method: str
    values: Mapping[str, float]
    log_density: float
    credible_level: float
    reason: str
    at_bound: tuple[str, ...]
    filled: tuple[str, ...] = ()

    @property
    def word(self) -> str:
        """The verdict in words."""
        if self.filled:
            return f"not judged: it gives no {', '.join(self.filled)}"
        if self.reason:
            return f"outside the prior: {self.reason}" if self.reason != REASONS[-1] else self.reason
        return f"{100 * self.credible_level:.1f} % of the draws are denser"


def locate(
    posterior: Posterior, draws: FloatArray, draw_densities: FloatArray, points: Mapping[str, Mapping[str, float]]
) -> dict[str, PointEstimate]:
    """Place point estimates in the posterior.

    Parameters
    ----------
    posterior : the density.
    draws : posterior draws (n, d).
    draw_densities : log density of each draw (n,).
    points : soil parameters of each estimate by method; a free parameter that an estimate does not give
        stands at its posterior median, as estimated noise always does; where K_s is given, but not k_c and
        k_φ, the latter makes up for it. Values of parameters that the study fixes are not used.
    """
    median = dict(zip(posterior.names, np.median(draws, axis=0), strict=True))
    return {method: _standing(posterior, method, values, median, draw_densities) for method, values in points.items()}


def _standing(
    posterior: Posterior,
    method: str,
    values: Mapping[str, float],
    median: Mapping[str, float],
    draw_densities: FloatArray,
) -> PointEstimate:
    names, completed = posterior.names, {**median, **values}
    if "Ks" in values and "kphi" in names and "kphi" not in values:
        kc = {**posterior.prior.fixed, **completed}["kc"]
        completed["kphi"] = values["Ks"] - kc / posterior.prior.width
    x = np.array([[completed[name] for name in names]])
    reason = int(posterior.reasons(x)[0])
    density = float(posterior.log_density(x)[0])
    soil = {name: completed[name] for name in PRIOR_PARAMETERS if name in values}
    return PointEstimate(
        method, soil, density, credible_level=float(np.mean(draw_densities > density)),
        reason="" if reason == INSIDE else REASONS[reason],
        at_bound=tuple(n for n in soil if n in names and _at_edge(posterior, n, soil[n])),
        filled=tuple(n for n in MODEL_PARAMETERS if n in names and n not in values),
    )  # fmt: skip


def _at_edge(posterior: Posterior, name: str, value: float) -> bool:
    """True where a value lies within a thousandth of the prior's range (98 % range if infinite) of an end."""
    law = posterior.prior.laws[name]
    low, high = (-np.inf, np.inf) if posterior.prior.stretched and name in MODULI else law.range
    width = high - low if np.isfinite(high - low) else float(np.ptp(law.quantile(np.array([0.01, 0.99]))))
    return bool(min(abs(value - low), abs(value - high)) < 1e-3 * width)


def of_point_estimate(standing: PointEstimate) -> dict[str, Any]:
    """Record of a point estimate's place in the posterior."""
    return {
        "credible_level": standing.credible_level,
        "log_density": standing.log_density if np.isfinite(standing.log_density) else None,
        "word": standing.word,
        "at_bound": list(standing.at_bound),
        "filled": list(standing.filled),
        "values": dict(standing.values),
    }
