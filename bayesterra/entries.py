"""Single entries of a study: parameter values, prior laws and noise, as tables of text or as objects."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from scipy import stats

from bayesterra.errors import StudyError
from bayesterra.messages import did_you_mean, suggestion
from bayesterra.noise import Noise
from bayesterra.parameters import CHANNELS, OUTCOMES, PARAMETERS, PRIOR_PARAMETERS
from bayesterra.priors import RANGED, Entry, Law, Tie
from bayesterra.units import quantity

_LIMITS = ("lower", "upper")
_SHIFTS = ("loc", "scale")
_NOISE_FORMS = '"1 mm", { fraction = 0.03, floor = "0.1 mm" } or { estimate = { dist = ... } }'
_NAME = re.compile(r"[A-Za-z_]\w*")


def table(value: object, name: str) -> dict[str, Any]:
    """A copy of a table, or a StudyError naming it."""
    if not isinstance(value, Mapping):
        raise StudyError(f"'{name}' must be a table (got {value!r})")
    return {str(key): entry for key, entry in value.items()}


def parameter_value(name: str, value: object, known: Iterable[str], *, bare: bool) -> float:
    """SI value of the parameter ``name``, which must be one of ``known``."""
    known = list(known)
    if name not in known:
        raise StudyError(f"unknown parameter '{name}'{did_you_mean(name, known)}")
    return quantity(value, PARAMETERS[name].dimension, name, bare=bare)


def prior_entry(name: str, value: object, *, bare: bool) -> Entry:
    """The prior of one parameter: a law, the number at which it is fixed, or what it is tied to.

    Parameters
    ----------
    name : one of ``PRIOR_PARAMETERS``.
    value : a table with ``dist``, a quantity, the name of another parameter, or a :class:`Law` as it is.
    bare : take numbers as SI values.
    """
    if name not in PRIOR_PARAMETERS:
        raise StudyError(f"unknown parameter '{name}'{did_you_mean(name, ('set', *PRIOR_PARAMETERS))}")
    if isinstance(value, Law | Tie):
        return value
    if isinstance(value, Mapping):
        return law(name, table(value, name), PARAMETERS[name].dimension, bare=bare)
    if isinstance(value, str) and _NAME.fullmatch(value.strip()):
        return _tie(name, value.strip())
    return quantity(value, PARAMETERS[name].dimension, name, bare=bare)


def _tie(name: str, to: str) -> Tie:
    if to not in PRIOR_PARAMETERS:
        hint = did_you_mean(to, PRIOR_PARAMETERS)
        raise StudyError(f"'{name}' is tied to an unknown parameter '{to}'{hint}")
    return Tie(to)


def law(name: str, entry: dict[str, Any], dimension: str, *, bare: bool) -> Law:
    """A probability law from its table: ``dist``, the law's own arguments, ``lower`` and ``upper``.

    ``loc``, ``scale``, ``lower`` and ``upper`` have the dimension of the parameter, shape arguments none; a
    ``source`` is text.
    """
    dist = entry.pop("dist", None)
    if dist is None:
        raise StudyError(f"'{name}' needs a 'dist', the name of a scipy.stats law (got {entry!r})")
    source = entry.pop("source", "")
    if not isinstance(source, str):
        raise StudyError(f"'{name}.source' must be text (got {source!r})")
    shapes = _shape_arguments(name, dist)
    _check_arguments(name, dist, entry, shapes)
    values = {
        key: quantity(item, "" if key in shapes else dimension, f"{name}.{key}", bare=bare)
        for key, item in entry.items()
    }
    limits = {key: values.pop(key) for key in _LIMITS if key in values}
    try:
        return Law(dist, values, **limits, source=source)
    except StudyError as error:
        raise StudyError(f"'{name}': {error}") from error


def _shape_arguments(name: str, dist: object) -> list[str]:
    """Names of a law's own arguments beside location and scale."""
    known = getattr(stats, dist, None) if isinstance(dist, str) else None
    if not isinstance(known, stats.rv_continuous):
        laws = (n for n in dir(stats) if isinstance(getattr(stats, n), stats.rv_continuous))
        hint = suggestion(str(dist), laws)
        raise StudyError(f"'{name}': 'dist' must be a continuous scipy.stats law, got {dist!r}{hint}")
    return [] if dist in RANGED else [part.strip() for part in (known.shapes or "").split(",") if part]


def _check_arguments(name: str, dist: str, entry: Mapping[str, Any], shapes: list[str]) -> None:
    known = (*shapes, *_SHIFTS, *_LIMITS, "source")
    for key in entry:
        if key not in known:
            raise StudyError(f"'{name}': unknown argument '{key}' of {dist}{did_you_mean(key, known)}")
    for key in shapes:
        if key not in entry:
            raise StudyError(f"'{name}': {dist} needs its argument '{key}'")


def noise_entry(channel: str, value: object, *, bare: bool) -> Noise:
    """The noise of one channel: a value, a fraction with a floor, an estimate, or a :class:`Noise`.

    A table may add ``dof``, the degrees of freedom of a Student-t law; a value is then written ``sd``.
    """
    if channel not in CHANNELS:
        raise StudyError(f"unknown channel '{channel}'{did_you_mean(channel, CHANNELS)}")
    if isinstance(value, Noise):
        return value
    if isinstance(value, Law):
        return Noise(channel, law=value)
    entry = table(value, channel) if isinstance(value, Mapping) else {"sd": value}
    dof = quantity(entry.pop("dof"), "", f"{channel}.dof") if "dof" in entry else np.inf
    size = _noise_size(channel, entry, bare=bare)
    return Noise(channel, dof=dof, **size)


def _noise_size(channel: str, entry: Mapping[str, Any], *, bare: bool) -> dict[str, Any]:
    """What says how large the noise is, as arguments of :class:`Noise`."""
    dimension = CHANNELS[channel].dimension
    if set(entry) == {"sd"}:
        return {"sd": quantity(entry["sd"], dimension, channel, bare=bare)}
    if set(entry) == {"fraction", "floor"}:
        fraction = quantity(entry["fraction"], "", f"{channel}.fraction")
        return {"fraction": fraction, "floor": _floor(entry["floor"], channel, bare=bare)}
    if set(entry) == {"estimate"}:
        return {"law": _estimate(channel, entry["estimate"], bare=bare)}
    raise StudyError(f"'{channel}' must be {_NOISE_FORMS} (got {', '.join(entry) or 'nothing'})")


def _floor(value: object, channel: str, *, bare: bool) -> float:
    return quantity(value, CHANNELS[channel].dimension, f"{channel}.floor", bare=bare)


def _estimate(channel: str, value: object, *, bare: bool) -> Law:
    """Law of an unknown standard deviation; ``lower`` is a tenth of the scale unless given."""
    if isinstance(value, Law):
        return value
    if channel not in OUTCOMES:
        raise StudyError(f"noise of '{channel}' cannot be estimated, as it is never an outcome")
    entry, dimension = table(value, f"{channel}.estimate"), CHANNELS[channel].dimension
    if "lower" not in entry:
        if "scale" not in entry:
            raise StudyError(f"'{channel}.estimate' needs a 'lower' above 0 or a 'scale'")
        scale = quantity(entry["scale"], dimension, f"{channel}.estimate.scale", bare=bare)
        entry["lower"] = f"{scale / 10!r} {dimension}"
    return law(f"{channel}.estimate", entry, dimension, bare=bare)
