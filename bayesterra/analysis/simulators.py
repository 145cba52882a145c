"""Soils for simulators: an ensemble of parameter files for Chrono's SCM terrain, and the error of that projection.

SCM (Krenn and Hirzinger 2009, deformable soil under a mesh) presses by (k_c/b + k_φ) zⁿ at every node and shears by
Janosi and Hanamoto. Its exponent knows no slip, so that of a wheel is taken at a stated slip. A rigid wheel on it is
the integral model whose stress is greatest at the bottom and nothing behind: θm = θ2 = 0, without lugs.
"""

import json
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.errors import ResultError
from bayesterra.likelihood.forward import Forward, reference_load, soil_at
from bayesterra.models import M1, Conditions, Wheel
from bayesterra.models.forces import DRAWBAR_PULL, SINKAGE
from bayesterra.parameters import CHANNELS, SoilColumns
from bayesterra.prediction.prediction import spread
from bayesterra.study.drive import Drive
from bayesterra.study.result import Result

SOILS = 100
"""Draws that become files, for every slip."""
STIFFEST, DAMPING = 4e8, 3e4
"""Elastic stiffness (Pa/m), which must exceed k_φ, and damping (Pa s/m), as in Chrono's own examples."""
_OUTCOMES = {"sinkage": SINKAGE, "drawbar_pull": DRAWBAR_PULL}
_BOTTOM = 1e-9  # θm/θ1 of a stress that is greatest at the bottom


def chrono_scm(result: Result, slips: Sequence[float] = ()) -> dict[str, str]:
    """Files for Chrono's SCM terrain by name, one a draw.

    Each holds an object ``Soil parameters`` as Chrono's terrain node for co-simulation reads it, its eight numbers
    in the order of ``SCMTerrain::SetSoilParameters``: SI, friction in degrees.

    Parameters
    ----------
    result : of ``run``, of one soil or of groups, whose every group has files.
    slips : at which the exponent is taken; by default the least, the middle and the greatest of those in the fit.

    Raises
    ------
    ResultError : the posterior lacks what SCM needs, or a slip lies outside [0, 1).
    """
    _check(slips)
    files: dict[str, str] = {}
    for place, (group, one) in enumerate(result.by_group().items(), 1):
        draws, places = spread(one, SOILS)
        soils = _soils(one, draws)
        for slip in slips or _levels(one):
            name = "-".join(["scm", *[f"group-{place}"] * bool(group), *[f"slip-{slip:g}"] * bool(one.study.wheels)])
            for number, (row, of) in enumerate(zip(_rows(soils, slip), places, strict=True), 1):
                origin = {"title": one.study.title, "kind": one.study.kind, "group": group, "slip": slip}
                origin |= dict(zip(("chain", "draw"), map(int, of), strict=True))
                files[f"{name}-{number:03d}.json"] = json.dumps(
                    {"Soil parameters": row, "bayesterra": origin}, indent=1
                )
    return files


def _check(slips: Sequence[float]) -> None:
    if wrong := next((slip for slip in slips if not 0 <= slip < 1), None):
        raise ResultError(f"'slip' must lie in [0, 1) (got {wrong:g})")


def _levels(result: Result) -> tuple[float, ...]:
    """Least, middle and greatest slip of the readings in the fit; 0 without a wheel."""
    slip = result.study.observations.used().slip
    return tuple(dict.fromkeys(float(each) for each in np.quantile(slip, [0, 0.5, 1]))) if len(slip) else (0.0,)


def _soils(result: Result, draws: FloatArray) -> dict[str, FloatArray]:
    """What SCM needs of draws (n, d) by name, each (n,)."""
    prior = result.study.prior

    def column(*names: str) -> FloatArray:
        for name in names:
            if name in prior.entries:
                return prior.column(name, draws)
        raise ResultError(
            f"chrono-scm needs {' or '.join(names)}, which this posterior lacks: add a soil test that tells it"
        )

    moduli = {"kc": column("kc"), "kphi": column("kphi")} if "kphi" in prior.entries else {}
    soils = moduli or {"kc": np.zeros(len(draws)), "kphi": column("Ks", "kphi")}
    soils |= {"n": column("n0", "n"), **{name: column(name) for name in ("c", "phi", "K")}}
    return {**soils, "n1": prior.column("n1", draws) if "n1" in prior.entries else np.zeros(len(draws))}


def _rows(soils: Mapping[str, FloatArray], slip: float) -> Iterator[dict[str, float]]:
    """Each draw in Chrono's words."""
    for i in range(len(soils["n"])):
        value = {name: float(column[i]) for name, column in soils.items()}
        yield {
            "Bekker Kphi": value["kphi"],
            "Bekker Kc": value["kc"],
            "Bekker n exponent": value["n"] + value["n1"] * slip,
            "Mohr cohesive limit": value["c"],
            "Mohr friction limit": float(np.degrees(value["phi"])),
            "Janosi shear coefficient": value["K"],
            "Elastic stiffness": max(STIFFEST, 20 * value["kphi"]),
            "Damping": DAMPING,
        }


def projection(result: Result, slips: Sequence[float] = ()) -> pd.DataFrame:
    """Error of the projection in sinkage and pull of the study's first wheel under its reference load.

    Parameters
    ----------
    slips : at which the exponent is taken, ``projected_at``; every such soil is driven at all of them.

    Returns
    -------
    Field units: medians of the model of the study and of the wheel on SCM, and of their difference 90 % of the
    draws; ``answered`` is the share of draws for which both have an answer. Empty without a wheel.

    Raises
    ------
    ResultError : as of :func:`chrono_scm`.
    """
    _check(slips)
    rows = [row for group, one in result.by_group().items() if one.study.wheels for row in _errors(group, one, slips)]
    return pd.DataFrame(rows)


def _errors(group: str, result: Result, slips: Sequence[float]) -> Iterator[dict[str, object]]:
    study, slips = result.study, slips or _levels(result)
    draws, _ = spread(result, SOILS * 10)
    wheel, driven = next(iter(study.wheels.values())), np.asarray(slips, dtype=np.float64)
    load = np.full(len(driven), reference_load(study))
    forward = Forward(study.model, Drive.LOAD, Conditions.of(wheel, driven), load)
    own = forward(study.prior.soil_values(draws), every_row=True)
    for projected in slips:
        values = on_scm(result, draws, projected, Conditions.of(Wheel(wheel.radius, wheel.width), driven), load)
        for name, place in _OUTCOMES.items():
            pairs = np.stack([own[name], values[:, :, place]]) / CHANNELS[name].scale
            for i, slip in enumerate(driven):
                model, scm = pairs[:, np.isfinite(pairs[:, :, i]).all(axis=0), i]
                ends = np.quantile(scm - model, [0.05, 0.5, 0.95]) if len(model) else np.full(3, np.nan)
                medians = (np.median(model), np.median(scm)) if len(model) else (np.nan, np.nan)
                yield {
                    **({"group": group} if group else {}), "projected_at": projected, "slip": slip, "quantity": name,
                    "unit": CHANNELS[name].unit, **dict(zip(("model", "scm"), medians, strict=True)),
                    **dict(zip(("error_05", "error_50", "error_95"), ends, strict=True)),
                    "answered": len(model) / len(draws),
                }  # fmt: skip


def errors_said(table: pd.DataFrame) -> Iterator[str]:
    """The error of every projection at its own slip in a sentence, and the worst at another slip."""
    if table.empty:
        return
    keys = ["group", "projected_at"] if "group" in table else ["projected_at"]
    for key, part in table.groupby(keys):
        *group, slip = key
        own, others = part[part["slip"] == slip], part[part["slip"] != slip]
        texts = []
        for row in own.to_dict("records"):
            named = CHANNELS[str(row["quantity"])]
            off = others[others["quantity"] == row["quantity"]]["error_50"]
            far = f", up to {off.iloc[off.abs().argmax()]:+.3g} at other slips" if len(off) else ""
            texts.append(
                f"{named.description} {row['error_50']:+.3g} {named.unit} (90 %: {row['error_05']:+.3g} to"
                f" {row['error_95']:+.3g}) of {row['model']:.3g}{far}"
            )
        where = "".join(f"{name}: " for name in group)
        yield f"{where}SCM soils projected at slip {slip:.3g} are off the model by: {'; '.join(texts)}."


def on_scm(result: Result, draws: FloatArray, slip: float, rows: Conditions, load: FloatArray) -> FloatArray:
    """Sinkage, pull and moment (n, m, 3) of a rigid wheel on SCM soils of draws, projected at a slip."""
    soil = soil_at(result.study.prior.soil_values(draws), float(rows.width[0]))
    own = _soils(result, draws)
    zero = np.zeros(len(draws))
    columns = (soil[:, SoilColumns.Ks], own["n"] + own["n1"] * slip, zero, own["c"], own["phi"], own["K"])
    theta = np.column_stack([*columns, zero + _BOTTOM, zero, zero])
    return M1(shear_start="rim", constant_exponent=True).response_at(theta, rows, load, every_row=True)[0]
