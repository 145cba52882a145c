"""Variants of M2 fitted by IM2, sinkage-driven as in the paper, on readings made from Table 10 and HIT's."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from paper_data import OUTCOMES, SOILS, field_values, hit_readings, readings, study

import bayesterra as bt
from bayesterra.least_squares.results import Fit
from bayesterra.parameters import soil_array

HERE = Path(__file__).parent
HIT = "HIT"
VARIANTS: Mapping[str, Mapping[str, Any]] = {
    "as in (5) and (13)": {},
    "constant n": {"constant_exponent": True},
    "R_j = r": {"shear_start": "rim"},
    "R_j = R": {"shear_start": "tip"},
}
"""Model options by variant; the first is the paper's model."""
REFERENCE, CONSTANT, RIM, TIP = VARIANTS
WIDE = {"Ks": 1.0, "K": 0.5e-3}
"""Lower bounds (SI) that Tables 11 to 13 need; Table 17 has 0.1 MPa/m^N and 2 mm."""
LOWEST = -0.999
"""Lower bound of n where Section 7.2 extends its limits; the stress (4) has a finite sum above −1 only."""
WHEELS = (*SOILS, HIT)
LOAD_DRIVEN = ("Wh11", HIT)
"""Readings that are fitted load-driven: the wheel of Fig. 16, and HIT."""
SEEDS = 10
SHARE = 0.25
"""Noise, in parts of the standard deviations of studies/hit-wh32."""


def study_of(
    wheel: str, variant: str, *, data: pd.DataFrame | None = None, model: str = "M2", **tables: Any
) -> bt.Study:
    """Study of a variant on noise-free readings of a wheel, on ``data``, or on the readings of HIT."""
    options = VARIANTS[variant]
    if wheel == HIT:
        return study("Wh32", hit_readings(), kind="digitised", model=model, options=options, **tables)
    return study(wheel, readings(wheel) if data is None else data, model=model, options=options, **tables)


def noisy(wheel: str, seed: int) -> pd.DataFrame:
    """Readings made from Table 10 with a share of the full noise."""
    clean = readings(wheel)
    return clean + SHARE * (readings(wheel, seed) - clean)


def im2(given: bt.Study, hold: Mapping[str, float] | None = None, **lower: float) -> Fit:
    """IM2 with the wider bounds."""
    return bt.fit(given, ("IM2",), lower={**WIDE, **lower}, hold=hold)["IM2"]


def table_11(wheels: tuple[str, ...] = WHEELS, seeds: int = SEEDS) -> pd.DataFrame:
    """Constant exponent: printed, ours with n free and with n ≥ 0, and the range over noise seeds."""
    known = pd.read_csv(HERE / "printed-table-11.csv").set_index("wheel")
    rows = []
    for wheel in wheels:
        free, bounded = (im2(study_of(wheel, CONSTANT), n0=low) for low in (LOWEST, 0.0))
        slip = im2(study_of(wheel, REFERENCE))
        runs = range(1, seeds + 1) if wheel != HIT else ()
        spread = [im2(study_of(wheel, CONSTANT, data=noisy(wheel, s)), n0=LOWEST).soil for s in runs]
        ranges = np.array([[soil.Ks / 1e3, soil.n0] for soil in spread], dtype=float).reshape(-1, 2)
        low, high = (f(ranges, axis=0) if len(ranges) else [np.nan] * 2 for f in (np.min, np.max))
        at = known.loc["Wh32" if wheel == HIT else wheel]
        rows.append(
            {
                "data": wheel, "printed_Ks": at["Ks_kPa"], "printed_n": at["n"],
                "Ks": field_values(free.soil)["Ks"], "n": free.soil.n0, "error": free.errors["normal_force"],
                "Ks_low": low[0], "Ks_high": high[0], "n_low": low[1], "n_high": high[1],
                "Ks_bounded": field_values(bounded.soil)["Ks"], "n_bounded": bounded.soil.n0,
                "error_bounded": bounded.errors["normal_force"],
                "error_with_slip": slip.errors["normal_force"],
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def tables_12_13(wheels: tuple[str, ...] = WHEELS, seeds: int = SEEDS) -> pd.DataFrame:
    """R_j = r and R_j = R: printed, ours, the range over noise seeds, the printed values on our readings."""
    known = pd.read_csv(HERE / "printed-tables-12-13.csv").set_index(["shear_start_radius", "wheel"])
    rows = []
    for (variant, radius), wheel in ((pair, w) for pair in ((RIM, "r"), (TIP, "R")) for w in wheels):
        at = known.loc[(radius, "Wh32" if wheel == HIT else wheel)]
        fit = im2(study_of(wheel, variant))
        runs = range(1, seeds + 1) if wheel != HIT else ()
        spread = pd.DataFrame([_shearing(im2(study_of(wheel, variant, data=noisy(wheel, s)))) for s in runs])
        held = {"c": 1e3 * at["c_kPa"], "phi": float(np.radians(at["phi_deg"])), "K": 1e-3 * at["K_mm"]}
        judged = im2(study_of(wheel, variant), hold=held).errors["resistance_moment"]
        printed = {"c": at["c_kPa"], "phi": at["phi_deg"], "K": at["K_mm"], "error": at["err_MDR_percent"]}
        normal = im2(study_of(wheel, REFERENCE)).errors["resistance_moment"]
        for name, value in _shearing(fit).items():
            seen = spread[name] if len(spread) else pd.Series([np.nan])
            rows.append(
                {
                    "table": 12 if variant == RIM else 13, "data": wheel, "quantity": name,
                    "printed": printed[name], "ours": value, "low": seen.min(), "high": seen.max(),
                    "error_of_printed": judged, "error_of_reference": normal,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def by_the_papers_solver(wheels: tuple[str, ...] = WHEELS, seeds: int = SEEDS) -> pd.DataFrame:
    """Tables 11 to 13 once more by the paper's solver, emulated: printed, ours, the range over noise seeds.

    Bounds are those of Table 17 (K ≥ 2 mm), but those of K_s and n for Table 11.
    """
    rows = []
    for (number, variant), wheel in product({11: CONSTANT, 12: RIM, 13: TIP}.items(), wheels):
        lower = {"Ks": WIDE["Ks"], "n0": LOWEST} if number == 11 else {}
        runs = range(1, seeds + 1) if wheel != HIT else ()
        studies = [study_of(wheel, variant), *(study_of(wheel, variant, data=noisy(wheel, s)) for s in runs)]
        found = [bt.fit(each, ("IM2",), lower=lower, solvers=("lsqcurvefit",))["IM2"] for each in studies]
        seen = pd.DataFrame([_constant(fit) if number == 11 else _shearing(fit) for fit in found])
        known = _printed(number, "Wh32" if wheel == HIT else wheel)
        for name in seen.columns:
            noise = seen[name].iloc[1:]
            at = {"table": number, "data": wheel, "quantity": name, "printed": known.get(name, np.nan)}
            rows.append({**at, "ours": seen[name].iloc[0], "low": noise.min(), "high": noise.max()})
    return pd.DataFrame(rows)


def _printed(number: int, wheel: str) -> dict[str, float]:
    """What Table 11, 12 or 13 prints for a wheel, field units."""
    if number == 11:
        at = pd.read_csv(HERE / "printed-table-11.csv").set_index("wheel").loc[wheel]
        return {"Ks": float(at["Ks_kPa"]), "n0": float(at["n"])}
    table = pd.read_csv(HERE / "printed-tables-12-13.csv").set_index(["shear_start_radius", "wheel"])
    at = table.loc[("r" if number == 12 else "R", wheel)]
    names = {"c": "c_kPa", "phi": "phi_deg", "K": "K_mm", "error": "err_MDR_percent"}
    return {name: float(at[column]) for name, column in names.items()}


def _constant(fit: Fit) -> dict[str, float]:
    values = field_values(fit.soil)
    return {"Ks": values["Ks"], "n0": values["n0"], "error": fit.errors["normal_force"]}


def _shearing(fit: Fit) -> dict[str, float]:
    values = field_values(fit.soil)
    return {**{name: values[name] for name in ("c", "phi", "K")}, "error": fit.errors["resistance_moment"]}


def load_fits(wheels: tuple[str, ...] = LOAD_DRIVEN, models: tuple[str, ...] = ("M1", "M2")) -> pd.DataFrame:
    """Every variant fitted load-driven to all outcomes at once (joint), n ≥ 0: errors (16) and χ²."""
    rows = []
    for wheel in wheels:
        for variant in VARIANTS:
            for model in models:
                given = study_of(wheel, variant, model=model, priors=PRIORS)
                fit = bt.fit(given, ("joint",))["joint"]
                errors = {f"error_{name}": fit.errors[name] for name in OUTCOMES}
                rows.append({"data": wheel, "variant": variant, "model": model, **errors, "chi2": _chi2(given, fit)})
    return pd.DataFrame(rows)


PRIORS: Mapping[str, Any] = {
    "Ks": {"dist": "loguniform", "lower": "1 kPa", "upper": "10 MPa"},
    "K": {"dist": "uniform", "lower": "0.5 mm", "upper": "50 mm"},
}
"""Laws wide enough for every variant and the same for all, so that evidences compare; else as the box."""


def _chi2(given: bt.Study, fit: Fit) -> float:
    """Sum of squared residuals in standard deviations, load-driven."""
    likelihood = bt.posterior(given).likelihood
    predicted = likelihood.predicted(likelihood.forward(soil_array(vars(fit.soil))))
    scales = likelihood.scales(predicted, np.empty((1, 0)))
    return float(np.nansum(((predicted - likelihood.measured) / scales) ** 2))
