"""Start values, bounds, held parameters and usable rows of the least-squares methods."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np

from bayesterra.arrays import FloatArray, frozen
from bayesterra.errors import StudyError, check_number
from bayesterra.least_squares.solver import of_the_paper
from bayesterra.likelihood.forward import Forward
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.posterior import Posterior, posterior
from bayesterra.models import Conditions, LoadEffectSoil, Soil
from bayesterra.parameters import HELD, LOAD_EFFECT, MODEL_PARAMETERS, MODULI, OFFSET, PARAMETERS, SOIL_PARAMETERS
from bayesterra.stats.laws import Law
from bayesterra.study.entries import prior_set
from bayesterra.study.observations import Observations
from bayesterra.study.priors import Entry
from bayesterra.study.study import Study

START: Mapping[str, float] = {
    "Ks": 2.5e6, "n0": 0.5, "n1": 0.5, "c": 200.0, "phi": float(np.radians(30.0)), "K": 0.01,
    "c1": 0.5, "c2": 0.0, **HELD,
}  # fmt: skip
"""Start values of IM1, Ding et al. 2015, Table 17; its bounds are the prior set ``paper-box``."""

GROUPS: Mapping[str, tuple[str, ...]] = {
    group: tuple(name for name in SOIL_PARAMETERS if PARAMETERS[name].group == group and name not in HELD)
    for group in ("P_I", "P_II", "P_III")
}
"""Parameters that the methods identify together; those held by default are identified by joint alone."""


@dataclass(frozen=True)
class Settings:
    """Start and bounds of a fit, SI."""

    names: tuple[str, ...]  # the k parameters of the model
    start: FloatArray  # (k,), as both bounds
    lower: FloatArray
    upper: FloatArray
    held: tuple[str, ...]  # names of the parameters that stay at ``start``
    delta: float = 0.002  # IM1 stops when c1 and c2 change by less from pass to pass
    solver: str = "converged"  # of the inner fits of IM1, IM2 and IM3: ``converged`` or ``lsqcurvefit``

    def soil(self, theta: FloatArray) -> Soil | SimpleNamespace:
        """The soil of parameters (k,); a namespace of them where the model is one's own."""
        paper = LoadEffectSoil if set(LOAD_EFFECT) <= set(self.names) else Soil
        kind = paper if of_the_paper(self.names) else SimpleNamespace
        return kind(**dict(zip(self.names, theta.tolist(), strict=True)))

    def free(self, names: tuple[str, ...]) -> list[int]:
        """Columns of those of ``names`` that are not held."""
        return [self.names.index(name) for name in names if name not in self.held]

    def at_bound(self, theta: FloatArray, columns: list[int]) -> tuple[str, ...]:
        """Names among ``columns`` whose value is within 1e-4 of the range from a bound."""
        width = np.subtract(self.upper, self.lower, where=np.isfinite(self.lower), out=np.full_like(theta, np.inf))
        margin = 1e-4 * np.where(np.isfinite(width), width, 0.0)
        at = (theta < self.lower + margin) | (theta > self.upper - margin)
        return tuple(self.names[i] for i in columns if at[i])


@dataclass(frozen=True)
class Overrides:
    """Wishes of the caller of ``fit`` in place of the study's ``[least_squares]``; None: as there.

    ``solver`` is the one of this fit.
    """

    hold: Mapping[str, float] | None = None
    start: Mapping[str, float] | None = None
    lower: Mapping[str, float] | None = None
    upper: Mapping[str, float] | None = None
    delta: float | None = None
    solver: str = "converged"

    def __post_init__(self) -> None:
        for table in (self.hold, self.start, self.lower, self.upper):
            for name, value in (table or {}).items():
                if name not in MODEL_PARAMETERS:
                    known = ", ".join(MODEL_PARAMETERS)
                    raise StudyError(f"least squares knows no parameter {name!r} (one of {known})")
                check_number(name, value)
                if not np.isfinite(value):
                    raise StudyError(f"least squares: {name!r} must be finite (got {value:g})")

    def over(self, study: Study) -> "Overrides":
        """These, completed from the study."""
        stated = study.least_squares
        delta = stated.delta if self.delta is None else self.delta
        if not delta > 0:
            raise StudyError(f"'delta' must be above 0 (got {delta:g})")
        tables = (self.hold, self.start, self.lower, self.upper, stated.hold, stated.start)
        for name in (name for table in tables for name in table or {} if name not in study.model.parameters):
            raise StudyError(f"least squares: the model {study.model.name} knows no parameter {name!r}")
        return Overrides(
            {**_held_by_study(study), **(stated.hold if self.hold is None else self.hold)},
            stated.start if self.start is None else self.start,
            stated.lower if self.lower is None else self.lower,
            stated.upper if self.upper is None else self.upper,
            delta,
            self.solver,
        )


def _held_by_study(study: Study) -> dict[str, float]:
    """Parameters that the priors fix, and n1 = 0 where the model's exponent is constant."""
    fixed = {name: value for name, value in study.prior.fixed.items() if name in MODEL_PARAMETERS}
    if all(name in study.prior.fixed for name in MODULI) and len({w.width for w in study.wheels.values()}) == 1:
        fixed["Ks"] = study.prior.fixed["kc"] / study.prior.width + study.prior.fixed["kphi"]
    return {**fixed, **study.model.holds}


def iteration_settings(study: Study, overrides: Overrides) -> Settings:
    """Settings of IM1, IM2 and IM3: those of Table 17 where neither study nor caller say otherwise.

    StudyError for an empty range, or a start value outside its bounds.
    """
    asked = overrides.over(study)
    hold = {**HELD, **(asked.hold or {})}
    box = {n: e.range if isinstance(e, Law) else (HELD[n], HELD[n]) for n, e in prior_set("paper-box").items()}
    low = {name: (asked.lower or {}).get(name, box[name][0]) for name in SOIL_PARAMETERS}
    high = {name: (asked.upper or {}).get(name, box[name][1]) for name in SOIL_PARAMETERS}
    start = {name: float(np.clip(START[name], low[name], high[name])) for name in SOIL_PARAMETERS}
    start |= {**(asked.start or {}), **hold}
    for name in SOIL_PARAMETERS:
        if name not in hold:
            _check_range(name, low[name], start[name], high[name])
    first, lower, upper = (_ordered(table, SOIL_PARAMETERS) for table in (start, low, high))
    return Settings(SOIL_PARAMETERS, first, lower, upper, _in_order(hold), asked.delta or 0.0, asked.solver)


def joint_settings(study: Study, overrides: Overrides) -> Settings:
    """Settings of joint: every parameter that has a prior law is free within the law's range.

    The start is the prior's median, except where study or caller give one inside the range.
    """
    asked, names = overrides.over(study), study.model.parameters
    hold = dict(asked.hold or {})
    tied = [name for name in names if name in study.prior.ties and name not in hold]
    if tied:
        raise StudyError(f"joint knows no tied parameters (got '{tied[0]}')")
    laws = {name: study.prior.laws[name] for name in names if name in study.prior.laws}
    start = {name: law.median for name, law in laws.items()}
    low, high = ({name: law.range[end] for name, law in laws.items()} for end in (0, 1))
    if study.prior.uses_moduli and "Ks" not in hold:
        low["Ks"], start["Ks"], high["Ks"] = _stiffness(study)
    inside = {n: v for n, v in (asked.start or {}).items() if low.get(n, np.inf) <= v <= high.get(n, -np.inf)}
    start |= inside
    low, high = hold | low, hold | high
    first, lower, upper = (_ordered(table, names) for table in (start | hold, low, high))
    return Settings(names, first, lower, upper, _in_order(hold))


def _stiffness(study: Study) -> tuple[float, float, float]:
    """Lowest, middle and highest K_s that the priors of k_c and k_φ allow, for wheels of one width."""
    if len({wheel.width for wheel in study.wheels.values()}) > 1:
        raise StudyError("joint knows one K_s only, so with 'kc' and 'kphi' all wheels must have one width")
    kc, kphi = (_ends(study.prior.entries[study.prior.root(name)]) for name in MODULI)
    low, middle, high = (a / study.prior.width + b for a, b in zip(kc, kphi, strict=True))
    if study.prior.stretched:
        low, middle, high = np.array([low, middle, high]) * study.prior.stretches
    low = max(low, 1e-6 * (high if np.isfinite(high) else abs(middle)))  # laws without ends have no ranges
    return low, max(middle, low), high


def _ends(entry: Entry) -> tuple[float, float, float]:
    if isinstance(entry, Law):
        return entry.range[0], entry.median, entry.range[1]
    value = float(entry) if isinstance(entry, int | float) else float("nan")
    return value, value, value


def _ordered(table: Mapping[str, float], names: tuple[str, ...]) -> FloatArray:
    return frozen([table[name] for name in names])


def _check_range(name: str, low: float, start: float, high: float) -> None:
    where = f"least squares of {name!r}"
    if not low < high:
        raise StudyError(f"{where}: 'lower' must be below 'upper' (got {low:g} and {high:g})")
    if not low <= start <= high:
        raise StudyError(f"{where}: 'start' must lie in [{low:g}, {high:g}] (got {start:g})")


def _in_order(names: Mapping[str, float]) -> tuple[str, ...]:
    return tuple(name for name in MODEL_PARAMETERS if name in names)


@dataclass(frozen=True)
class Readings:
    """Sinkage-driven readings, SI."""

    conditions: Conditions  # slip and wheel of each row
    sinkage: FloatArray  # (m,) above 0 and below the radius
    forces: Mapping[str, FloatArray]  # by channel: normal force, pull and moment (m,), NaN where not measured
    left_out: int = 0  # number of used rows without such a sinkage


def readings(study: Study) -> Readings:
    """Rows in the fit that have a sinkage inside (0, r).

    The normal force is the measured one, or the load where none was measured. Readings of the sinkage are
    freed of their zero error, as far as it is known.
    """
    used = without_offset(study.observations.used(), study)
    none = np.full(len(used), np.nan)
    sinkage = used.values.get("sinkage", none)
    radius = np.array([study.wheels[name].radius for name in used.wheel])
    keep = np.flatnonzero((sinkage > 0) & (sinkage < radius))
    normal = used.values.get("normal_force", none)
    forces = {
        "normal_force": np.where(np.isnan(normal), used.load, normal)[keep],
        "drawbar_pull": used.values.get("drawbar_pull", none)[keep],
        "resistance_moment": used.values.get("resistance_moment", none)[keep],
    }
    wheels = [study.wheels[used.wheel[i]] for i in keep]
    conditions = Conditions.of(wheels, used.slip[keep])
    return Readings(conditions, sinkage[keep], forces, len(used) - len(keep))


def known_offset(study: Study) -> float:
    """Zero error (m) of the sinkage readings: fixed, or the median of its prior."""
    law = study.prior.laws.get(OFFSET)
    return study.prior.fixed.get(OFFSET, 0.0) if law is None else law.median


def without_offset(rows: Observations, study: Study) -> Observations:
    """The rows with the known zero error taken off the sinkage."""
    offset = known_offset(study)
    if not offset or "sinkage" not in rows.values:
        return rows
    return replace(rows, values={**rows.values, "sinkage": rows.values["sinkage"] - offset})


def weighted_target(study: Study) -> Posterior:
    """The posterior whose weighted residuals joint minimises: that of the study without latent quantities.

    With the drive ``both`` the measured normal force stands for the load, so rows without one are left out.

    Raises
    ------
    StudyError : no row has a measured normal force.
    """
    density = posterior(study)
    whole = density.likelihood
    rows, noise = without_offset(whole.observations, study), whole.noise
    if study.drive.latent_load:
        noise = [entry for entry in noise if entry.channel != "normal_force"]
        force = rows.values.get("normal_force", np.full(len(rows), np.nan))
        rows = replace(rows, load=force).take(force > 0)
    if not len(rows) or not noise:
        raise StudyError("joint: no row has both a measured normal force and an outcome")
    forward = Forward.of(study.model, study.drive.with_load, rows, dict(study.wheels))
    return replace(density, likelihood=Likelihood(forward, rows, tuple(noise)))
