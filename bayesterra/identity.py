"""All that a run depends on, by names that a message can use: study, data, seed, settings, code."""

from __future__ import annotations

import platform
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from functools import cache
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from bayesterra import models
from bayesterra.data import Observations
from bayesterra.model_errors import described as errors_described
from bayesterra.parameters import CHANNELS
from bayesterra.sharing import described
from bayesterra.study import Study
from bayesterra.units import text

LIBRARIES = ("numpy", "scipy", "numba", "emcee", "arviz-stats")
"""Libraries whose arithmetic the draws, or the moment when sampling stops, depend on."""


def identity(study: Study, seed: int) -> dict[str, Any]:
    """Name everything that must be the same for a run to go on; see :class:`bayesterra.checkpoints.Identity`.

    Names hold ``{}`` where their value stands in a sentence; without it the value follows.
    """
    return {
        "seed": seed,
        "model": study.model.name,
        **_options("model_options", asdict(study.model)),
        "drive": study.drive,
        "load_range": study.load_range,
        **asdict(study.sampling),
        **dict(_wheels(study)),
        **{f"noise of {name}": _without_source(noise) for name, noise in study.noise.items()},
        **{f"prior of {name}": _without_source(entry) for name, entry in study.prior.entries.items()},
        **{f"prior correlation of {pair}": value for pair, value in study.prior.correlation.items()},
        **({"discrepancy, ripple and slip errors": errors_described(study.errors)} if study.errors else {}),
        **({"pooling": described(study.pooling)} if study.pooling is not None else {}),
        **_options("least_squares", asdict(study.least_squares)),
        "{} rows of measurements": len(study.observations),
        **dict(_readings(study.observations)),
        "bayesterra": version("bayesterra"),
        "build of bayesterra": source_digest(),
        "Python": platform.python_version(),
        **{name: version(name) for name in LIBRARIES},
    }


@cache
def source_digest() -> str:
    """SHA-256 of the package's source files, names and content."""
    digest = sha256()
    root, of_models = Path(__file__).parent, Path(models.__file__).parent
    files = {f"models/{path.relative_to(of_models).as_posix()}": path for path in of_models.rglob("*.py")}
    files |= {path.relative_to(root).as_posix(): path for path in root.rglob("*.py")}
    for name in sorted(files):
        digest.update(f"{name} {sha256(files[name].read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


def _options(table: str, options: Mapping[str, Any]) -> dict[str, Any]:
    return {f"[{table}] {key} {{}}": value for key, value in options.items()}


def _wheels(study: Study) -> Iterator[tuple[str, Any]]:
    for name, wheel in study.wheels.items():
        for key, value in asdict(wheel).items():
            length = key in ("radius", "width", "lug_height")
            yield f"{key} {{}} of wheel {name}", text(value, "m") if length else value


def _without_source(content: Any) -> Any:
    """A law, a noise or a fixed value without the text that it may carry."""
    if not hasattr(content, "__dataclass_fields__"):
        return content
    items = {key: value for key, value in vars(content).items() if key in content.__dataclass_fields__}
    return {key: _without_source(value) for key, value in items.items() if key != "source"}


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


def _cell(channel: str, value: float) -> str | float | None:
    return None if np.isnan(value) else text(float(value), CHANNELS[channel].dimension)
