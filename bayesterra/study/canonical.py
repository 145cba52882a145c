"""Canonical form of a study: written out in full as TOML, and all that a run depends on by name."""

import json
import platform
import re
import sys
from collections.abc import Iterator, Mapping
from dataclasses import asdict, fields
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from bayesterra import models
from bayesterra.models import M2L, OwnModel, Wheel
from bayesterra.parameters import CHANNELS, PARAMETERS, PRIOR_PARAMETERS, in_order, of_soil_tests
from bayesterra.runtime.folders import write_text
from bayesterra.runtime.tables import csv_text
from bayesterra.stats.laws import Law
from bayesterra.study.entries import law_entry
from bayesterra.study.groups import Pooling
from bayesterra.study.model_errors import Discrepancy, Ripple, Size
from bayesterra.study.noise import Noise
from bayesterra.study.observations import Observations
from bayesterra.study.priors import Entry, Tie
from bayesterra.study.schema import Reference
from bayesterra.study.units import text

if TYPE_CHECKING:
    from bayesterra.study.study import Study

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


def simulated_toml(study: "Study", *, truth: Mapping[str, float], source: str) -> str:
    """The study file of simulated measurements that stand in ``measurements.csv`` beside it.

    ``truth`` are SI values of the parameters that they were made with, ``source`` says how. Slip and sinkage
    references are those of the converted rows of the study that was simulated.
    """
    title = f"{study.title}, simulated" if study.title else "simulated"
    truth_table = {"truth": _reference(Reference(source=source, values=dict(truth)))}
    return _file({"title": title, "soil": study.soil}, ("simulated", source), tables(study), truth_table)


def write_study(study: "Study", folder: Path) -> None:
    """Write a study as ``study.toml`` and ``measurements.csv``, such that reading them gives it back."""
    references = {name: _reference(reference) for name, reference in study.references.items()}
    text = _file({"title": study.title, **study.described}, (study.kind, study.source), tables(study), references)
    write_text(folder / "study.toml", text)
    if study.wheels:
        write_text(folder / "measurements.csv", csv_text(_rows(study.observations)))
    write_readings(study, folder)


def write_readings(study: "Study", folder: Path) -> None:
    """Write the readings of the soil tests of a study, each series into its file."""
    for test in study.soil_tests.values():
        write_text(folder / test.file, csv_text(test.table))


def tables(study: "Study") -> dict[str, Any]:
    """Keys and tables of a study file in full, as plain values with units, without texts and references.

    The one plain form of a study: written as TOML, hashed as its fingerprint, compared when a run goes on.
    """
    loads = study.load_range and [text(load, "N") for load in study.load_range]
    mean_load = {"mean_load": text(study.model.mean_load, "N")} if isinstance(study.model, M2L) else {}
    entries, errors = study.prior.entries, study.errors
    priors: dict[str, object] = {"reference_sinkage": text(study.prior.reference, "m")} if study.prior.stretched else {}
    named = [name for name in PRIOR_PARAMETERS if name in entries]
    priors |= {name: _prior(name, entries[name]) for name in (*named, *filter(of_soil_tests, in_order(entries)))}
    content: dict[str, Any] = {
        "model": study.model.options if isinstance(study.model, OwnModel) else study.model.name,
        "drive": str(study.drive),
        "load_range": loads,
        "wheels": {name: _wheel(wheel) for name, wheel in study.wheels.items()},
        "model_options": {} if isinstance(study.model, OwnModel) else {**study.model.options, **mean_load},
        "noise": {name: _noise(noise) for name, noise in study.noise.items()},
        "discrepancy": {name: _discrepancy(curve) for name, curve in errors.discrepancy.items()},
        "ripple": {name: _ripple(ripple) for name, ripple in errors.ripple.items()},
        "slip": errors.slip and {"sd": _size(errors.slip.size, "")},
        "priors": priors,
        "priors.correlation": dict(study.prior.correlation),
        "priors.mixture": {key: asdict(mixture) for key, mixture in study.prior.mixtures.items()},
        "pooling": study.pooling and _pooling(study.pooling),
        "soil_tests": {name: test.canonical() for name, test in study.soil_tests.items()},
        "least_squares": _least_squares(study),
        "sampling": asdict(study.sampling),
    }
    idle = () if study.wheels else ("model", "drive", "model_options")
    return {name: value for name, value in content.items() if value and name not in idle}


FORM = 2
"""Number of that form: fingerprints of studies in another one do not compare."""


OF_THE_TABLE = ("notes", "labels", "limits", "headings", "form")
"""What of the rows does not count for their fingerprint, or apart."""


def fingerprint(study: "Study") -> dict[str, str]:
    """SHA-256 of what the results depend on: ``study`` (all but text and sampling options), ``data``."""
    content = {name: value for name, value in _sourceless(tables(study)).items() if name != "sampling"}
    named = (field.name for field in fields(Observations) if field.name not in OF_THE_TABLE)
    rows = {name: getattr(study.observations, name) for name in named}
    if study.observations.limits:
        rows["limits"] = study.observations.limits
    rows |= {name: list(column) for name, column in study.observations.labels.items()}
    if study.soil_tests:
        rows["soil_tests"] = {name: vars(test.readings) for name, test in study.soil_tests.items()}
    return {"study": _digest(content), "data": _digest(rows)}


def _digest(content: Any) -> str:
    text = json.dumps(content, sort_keys=True, default=lambda x: x.tolist() if isinstance(x, np.ndarray) else dict(x))
    return sha256(text.encode()).hexdigest()


def _sourceless(content: Any) -> Any:
    """Plain values without the texts on where laws are from."""
    if isinstance(content, Mapping):
        return {key: _sourceless(value) for key, value in content.items() if key != "source"}
    return content


def _rows(rows: Observations) -> pd.DataFrame:
    """All that is known of every row, in SI units, slip on the shearing radius, sinkage from the rim."""
    forces = rows.values.get("normal_force", np.empty(0))
    stood_in = "load" not in rows.given_sd and np.array_equal(forces, rows.load, equal_nan=True)  # by the forces
    measured = rows.values if stood_in else {"load": rows.load, **rows.values}
    columns: dict[str, object] = {"wheel": rows.wheel, **rows.labels, "slip": rows.slip}
    for name, values in measured.items():
        if not np.isnan(values).all():
            columns[f"{name} [{CHANNELS[name].dimension}]"] = rows.cells(name)
        sd = rows.given_sd.get(name, np.array(np.nan))
        if not np.isnan(sd).all():
            columns[f"{name}_sd [{CHANNELS[name].dimension}]"] = sd
    return pd.DataFrame({**columns, "use": rows.use.astype(int)})


def _file(
    head: Mapping[str, object], origin: tuple[str, str], content: Mapping[str, Any], references: Mapping[str, Any]
) -> str:
    """Text of a study file; ``origin``: kind and source of the measurements."""
    data = {"file": "measurements.csv", "slip_reference": "shearing", "sinkage_reference": "rim"}
    data |= dict(zip(("kind", "source"), origin, strict=True))
    keys = {name: value for name, value in content.items() if not isinstance(value, Mapping)}
    split = {
        name: {f"{name}.{_key(key)}": value for key, value in content.get(name, {}).items()}
        for name in ("wheels", "priors.mixture", "soil_tests")
    }
    apart = {*keys, *split, "sampling"}
    named = {name: value for name, value in content.items() if name not in apart} | split["priors.mixture"]
    wheels = {"data": data, **split["wheels"]} if split["wheels"] else {}
    sections = {**wheels, **split["soil_tests"], **named, **references, "sampling": content["sampling"]}
    lines = [*assignments({**head, **keys})]
    for name, section in sections.items():
        lines += ["", f"[{name}]", *assignments(section)] if section else []
    return "\n".join(lines) + "\n"


def _reference(reference: Reference) -> dict[str, object]:
    return {"source": reference.source, **{name: _value(name, v) for name, v in reference.values.items()}}


def _pooling(pooling: Pooling) -> dict[str, object]:
    hierarchical = {
        name: {
            part: law_entry(law, PARAMETERS[name].dimension)
            for part, law in (("mean", population.mean), ("spread", population.spread))
            if law is not None
        }
        for name, population in pooling.hierarchical.items()
    }
    named = {name: lists for name, lists in pooling.record().items() if name != "hierarchical"}
    return {**named, **({"hierarchical": hierarchical} if hierarchical else {})}


def _least_squares(study: "Study") -> dict[str, object]:
    options: dict[str, object] = {}
    for name, option in asdict(study.least_squares).items():
        values = {key: _value(key, v) for key, v in option.items()} if isinstance(option, dict) else option
        if values != {} and (name, values) != ("solvers", ("converged",)):  # as it is by default
            options[name] = values
    return options


def _wheel(wheel: Wheel) -> dict[str, object]:
    lengths = {name: text(getattr(wheel, name), "m") for name in ("radius", "width", "lug_height")}
    coefficient = wheel.shearing_radius_coefficient
    rest = {} if coefficient is None else {"shearing_radius_coefficient": coefficient}
    return {**lengths, "lug_count": wheel.lug_count, **rest}


def _noise(noise: Noise) -> object:
    dimension = CHANNELS[noise.channel].dimension
    rounding = {"resolution": text(noise.resolution, dimension)} if noise.resolution else {}
    tails = {**noise.tails.keys, **rounding}
    if noise.law is not None:
        return {"estimate": law_entry(noise.law, dimension), **tails}
    if noise.fraction is not None:
        return {"fraction": noise.fraction, "floor": text(noise.floor, dimension), **tails}
    sd = text(noise.sd or 0.0, dimension)
    return {"sd": sd, **tails} if tails else sd


def _discrepancy(curve: Discrepancy) -> dict[str, object]:
    size = _size(curve.size, CHANNELS[curve.channel].dimension)
    return {"sd": size, "length": curve.length, "kernel": curve.kernel}


def _ripple(ripple: Ripple) -> dict[str, object]:
    size, repeats = _size(ripple.size, CHANNELS[ripple.channel].dimension), np.isfinite(ripple.period)
    return {"sd": size, "memory": ripple.memory, **({"period": ripple.period} if repeats else {})}


def _size(size: Size, dimension: str) -> object:
    if size.law is not None:
        return {"estimate": law_entry(size.law, dimension)}
    return text(size.sd or 0.0, dimension) if dimension else size.sd


def _prior(name: str, entry: Entry) -> object:
    if isinstance(entry, Tie):
        return entry.to
    return law_entry(entry, PARAMETERS[name].dimension) if isinstance(entry, Law) else _value(name, entry)


def _value(name: str, value: float) -> object:
    return text(value, PARAMETERS[name].dimension)


def assignments(content: Mapping[str, object]) -> Iterator[str]:
    """Lines of keys and values."""
    for key, value in content.items():
        yield f"{_key(key)} = {_toml(value)}"


def _key(name: str) -> str:
    return name if _BARE_KEY.fullmatch(name) else json.dumps(name, ensure_ascii=False)


def _toml(value: object) -> str:
    """TOML text of a value; its strings, numbers, booleans and lists are written as in JSON."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(k)} = {_toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_toml, value))}]"
    return json.dumps(value, ensure_ascii=False)


LIBRARIES = ("numpy", "scipy", "numba", "emcee", "arviz-stats")
"""Libraries whose arithmetic the draws, or the moment when sampling stops, depend on."""


def identity(study: "Study", seed: int) -> dict[str, Any]:
    """Everything that must be the same for a run to go on, by name.

    Names hold ``{}`` where their value stands in a sentence; without it the value follows.
    """
    return {
        "seed": seed,
        **dict(_settings(_sourceless(tables(study)))),
        "{} rows of measurements": len(study.observations),
        **dict(_readings(study.observations)),
        **{f"readings of soil test {name}": _digest(vars(test.readings)) for name, test in study.soil_tests.items()},
        "bayesterra": version("bayesterra"),
        "build of bayesterra": source_digest(),
        **({"code of the model": code_digest(study.model.law)} if isinstance(study.model, OwnModel) else {}),
        **{
            f"code of the noise of {each.channel}": code_digest(each.residuals.law)
            for each in study.noise.values()
            if each.residuals is not None
        },
        "Python": platform.python_version(),
        **{name: version(name) for name in LIBRARIES},
    }


@cache
def source_digest() -> str:
    """SHA-256 of the package's source and data files, names and content."""
    digest = sha256()
    root, of_models = Path(__file__).parents[1], Path(models.__file__).parent
    files = {f"models/{path.relative_to(of_models).as_posix()}": path for path in of_models.rglob("*.py")}
    files |= {path.relative_to(root).as_posix(): path for path in root.rglob("*") if path.suffix in (".py", ".toml")}
    for name in sorted(files):
        digest.update(f"{name} {sha256(files[name].read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


def code_digest(law: object) -> str:
    """SHA-256 of the file that a law of one's own is from; empty where it is from none."""
    module = sys.modules.get(type(law).__module__)
    file = getattr(module, "__file__", None)
    return sha256(Path(file).read_bytes()).hexdigest() if file else ""


_PHRASES = {
    "sampling": "{}",
    "noise": "noise of {}",
    "priors": "prior of {}",
    "priors.correlation": "prior correlation of {}",
    "priors.mixture": "prior mixture of {}",
}
"""What settings of a table are called; those of others by ``[table] key``."""


def _settings(content: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    for table, values in content.items():
        if table in ("wheels", "soil_tests"):
            what = "wheel" if table == "wheels" else "soil test"
            for name, each in values.items():
                yield from ((f"{key} {{}} of {what} {name}", value) for key, value in each.items())
        elif isinstance(values, Mapping):
            phrase = _PHRASES.get(table, f"[{table}] {{}} {{{{}}}}")
            yield from ((phrase.format(key), value) for key, value in values.items())
        else:
            yield table, values


def _readings(rows: Observations) -> Iterator[tuple[str, Any]]:
    """Every cell of the converted table, row by row."""
    columns = {"slip": rows.slip, "load": rows.load, **rows.values}
    for i, row in enumerate(rows.rows):
        yield f"wheel {{}} in row {row}", rows.wheel[i]
        yield f"use {{}} in row {row}", int(rows.use[i])
        for name, values in columns.items():
            yield f"{name} {{}} in row {row}", _cell(name, values[i])
        for name, values in rows.given_sd.items():
            yield f"{name}_sd {{}} in row {row}", _cell(name, values[i])
        for name, ends in rows.limits.items():
            for word, end in zip(("lower", "upper"), ends[i], strict=True):
                yield (f"{word} limit of {name} {{}} in row {row}", _cell(name, end) if np.isfinite(end) else None)


def _cell(channel: str, value: float) -> str | float | None:
    return None if np.isnan(value) else text(float(value), CHANNELS[channel].dimension)
