"""Single entries of a study: parameter values, prior laws and noise, as tables of text or as objects.

Named sets of priors stand in ``prior_sets.toml``, in the words of a study file.
"""

import re
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from bayesterra import parameters
from bayesterra.errors import StudyError, check_keys, checked_text, did_you_mean, errors_after, known, suggestion
from bayesterra.runtime.reading import MEGABYTE, read_text
from bayesterra.stats.dependence import MixtureCopula
from bayesterra.stats.laws import RANGED, SLOW, Law
from bayesterra.stats.quantile_law import TABULATED, QuantileLaw
from bayesterra.stats.tails import OwnTails
from bayesterra.study.noise import Noise
from bayesterra.study.own import loaded, stating
from bayesterra.study.priors import Entry, Source, Tie
from bayesterra.study.units import quantity, text

_LIMITS = ("lower", "upper")
_SHIFTS = ("loc", "scale")
_ROWS = ("scores", "values")
_MIXTURE = ("weights", "means", "covariances")
_TAKEN = ("result", "take", "widen")
_NOISE_FORMS = '"1 mm", { fraction = 0.03, floor = "0.1 mm" } or { estimate = { dist = ... } }'
_NAME = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z][\w-]*)?")


def table(value: object, name: str) -> dict[str, Any]:
    """A copy of a table, or a StudyError naming it."""
    if not isinstance(value, Mapping):
        raise StudyError(f"'{name}' must be a table (got {value!r})")
    return {str(key): entry for key, entry in value.items()}


def parameter_value(name: str, value: object, names: Iterable[str], *, bare: bool) -> float:
    """SI value of the parameter ``name``, which must be one of ``names``."""
    known("parameter", name, names)
    return quantity(value, parameters.PARAMETERS[name].dimension, name, bare=bare)


def prior_entry(name: str, value: object, *, bare: bool) -> Entry:
    """The prior of one parameter: a law, the number at which it is fixed, or what it is tied to.

    Parameters
    ----------
    name : one of ``PRIOR_PARAMETERS``, or of soil tests: ``n``, ``K.ring``.
    value : a table with ``dist``, a quantity, the name of another parameter, or a :class:`Law` as it is; from Python
        also a frozen law of ``scipy.stats``.
    bare : take numbers as SI values.
    """
    if name not in parameters.PRIOR_PARAMETERS and not parameters.of_soil_tests(name):
        keys = ("set", "from", "correlation", "mixture", REFERENCE, *parameters.PRIOR_PARAMETERS)
        raise StudyError(f"unknown parameter '{name}'{did_you_mean(name, keys)}")
    if isinstance(value, Law | Tie):
        return value
    if isinstance(getattr(value, "dist", None), stats.rv_continuous):
        return frozen_law(name, value)
    if isinstance(value, Mapping):
        return law(name, table(value, name), parameters.PARAMETERS[name].dimension, bare=bare)
    if isinstance(value, str) and _NAME.fullmatch(value.strip()):
        to = value.strip()
        if to not in parameters.PRIOR_PARAMETERS and not parameters.of_soil_tests(to):
            hint = did_you_mean(to, parameters.PRIOR_PARAMETERS)
            raise StudyError(f"'{name}' is tied to an unknown parameter '{to}'{hint}")
        return Tie(to)
    return quantity(value, parameters.PARAMETERS[name].dimension, name, bare=bare)


def law(name: str, entry: dict[str, Any], dimension: str, *, bare: bool) -> Law:
    """A probability law from its table: ``dist``, the law's own arguments, ``lower`` and ``upper``.

    ``loc``, ``scale``, ``lower`` and ``upper`` have the dimension of the parameter, shape arguments none; a
    ``source`` is text.
    """
    dist = entry.pop("dist", None)
    if dist == TABULATED:
        return _tabulated(name, entry, dimension, bare=bare)
    if dist is None:
        raise StudyError(f"'{name}' needs a 'dist', the name of a scipy.stats law (got {entry!r})")
    source = _source(name, entry)
    shapes = _shape_arguments(name, dist)
    _check_arguments(name, dist, entry, (*shapes, *_SHIFTS, *_LIMITS))
    for key in shapes:
        if key not in entry:
            raise StudyError(f"'{name}': {dist} needs its argument '{key}'")
    values = {
        key: quantity(item, "" if key in shapes else dimension, f"{name}.{key}", bare=bare)
        for key, item in entry.items()
    }
    limits = {key: values.pop(key) for key in _LIMITS if key in values}
    with errors_after(f"'{name}': "):
        return Law(dist, values, **limits, source=source)


def frozen_law(name: str, value: Any) -> Law:
    """A frozen law of ``scipy.stats``, SI, as a law by its name and arguments."""
    family = value.dist
    with errors_after(f"'{name}': "):
        if family.name in RANGED:
            low, high = map(float, value.support())
            return Law(family.name, lower=low, upper=high)
        return Law(family.name, _arguments(value))


def _arguments(value: Any) -> dict[str, float]:
    """Arguments of a frozen law of ``scipy.stats`` by name."""
    order = [*(part.strip() for part in (value.dist.shapes or "").split(",") if part), *_SHIFTS]
    stated = {**dict(zip(order, value.args, strict=False)), **value.kwds}
    return {key: float(number) for key, number in stated.items()}


def law_entry(law: Law, dimension: str) -> dict[str, object]:
    """A law as a table: location, scale and limits have the parameter's unit, shape arguments have none."""
    numbers: dict[str, float] = {**law.shape, "lower": law.lower, "upper": law.upper}
    rows: dict[str, object] = {}
    if isinstance(law, QuantileLaw):
        rows = {"scores": law.scores, "values": [text(value, dimension) for value in law.values]}
    dimensional = ("loc", "scale", "lower", "upper")
    values = {
        key: text(value, dimension if key in dimensional else "")
        for key, value in numbers.items()
        if np.isfinite(value)
    }
    return {"dist": law.dist, **rows, **values, **({"source": law.source} if law.source else {})}


def _tabulated(name: str, entry: dict[str, Any], dimension: str, *, bare: bool) -> QuantileLaw:
    """A law by the values at its normal scores."""
    source = _source(name, entry)
    _check_arguments(name, TABULATED, entry, (*_ROWS, *_LIMITS))
    columns: dict[str, tuple[float, ...]] = {}
    for key, unit in zip(_ROWS, ("", dimension), strict=True):
        column = entry.get(key)
        if not isinstance(column, list | tuple):
            raise StudyError(f"'{name}': {TABULATED} needs a list '{key}' (got {column!r})")
        columns[key] = tuple(quantity(item, unit, f"{name}.{key}", bare=bare) for item in column)
    limits: dict[str, Any] = {
        key: quantity(entry[key], dimension, f"{name}.{key}", bare=bare) for key in _LIMITS if key in entry
    }
    with errors_after(f"'{name}': "):
        return QuantileLaw(source=source, scores=columns["scores"], values=columns["values"], **limits)


def _source(name: str, entry: dict[str, Any]) -> str:
    """Take the text out of an entry that says where it comes from."""
    source = entry.pop("source", "")
    if not isinstance(source, str):
        raise StudyError(f"'{name}.source' must be text (got {source!r})")
    return checked_text(source, f"{name}.source")


SCATTER = {"plate": ("scatter", "memory", "seating", parameters.OFFSET), "shear": ("scatter", "memory")}
"""Parameters of how tests differ from the mean curve, by kind of test."""


def scatter(value: object, *, bare: bool) -> dict[str, Law | float | bool]:
    """How soil tests differ: a law or a fixed value by parameter, and whether readings are ``independent``."""
    content, stated = table(value, "noise"), dict[str, Law | float | bool]()
    for name, item in content.items():
        known("parameter", name, ("independent", *SCATTER["plate"]))
        if name == "independent":
            if not isinstance(item, bool):
                raise StudyError(f"'independent' must be true or false (got {item!r})")
            stated[name] = item
        elif isinstance(item, Law):
            stated[name] = item
        elif isinstance(item, Mapping):
            stated[name] = law(name, table(item, name), parameters.PARAMETERS[name].dimension, bare=bare)
        else:
            stated[name] = quantity(item, parameters.PARAMETERS[name].dimension, name, bare=bare)
    return stated


def pair(*names: str) -> str:
    """Name a pair of parameters, in the package's order: ``"c, phi"``."""
    return ", ".join(parameters.in_order(names))


def correlations(value: object) -> dict[str, float]:
    """Correlations of normal scores by pair from a table such as ``{"c, phi" = -0.8}``."""
    by_pair: dict[str, float] = {}
    for key, item in table(value, "correlation").items():
        names = [part.strip() for part in key.split(",")]
        for name in names:
            known(
                "parameter", name, (*parameters.PARAMETERS, *filter(parameters.of_soil_tests, names)), "correlation: "
            )
        if len(names) != 2 or names[0] == names[1]:
            raise StudyError(f"correlation: a key must name two parameters, e.g. \"c, phi\" (got '{key}')")
        number = quantity(item, "", f"correlation of '{key}'", bare=True)
        if not -1.0 < number < 1.0:
            raise StudyError(f"correlation of '{key}' must lie between -1 and 1 (got {number:g})")
        if pair(*names) in by_pair:
            raise StudyError(f"correlation of '{pair(*names)}' is given twice")
        by_pair[pair(*names)] = number
    return by_pair


def mixtures(value: object) -> dict[str, MixtureCopula]:
    """Mixture copulas by parameters from a table such as ``{"c, phi" = { weights = [...], ... }}``."""
    by_names: dict[str, MixtureCopula] = {}
    for key, item in table(value, "mixture").items():
        names, what = [part.strip() for part in key.split(",")], f"mixture of '{key}'"
        for name in names:
            known("parameter", name, (*parameters.PARAMETERS, *filter(parameters.of_soil_tests, names)), f"{what}: ")
        if len(names) < 2 or len(set(names)) < len(names):
            raise StudyError(f'{what}: a key must name two parameters or more, each once, e.g. "c, phi"')
        if isinstance(item, MixtureCopula):
            by_names[", ".join(names)] = item
            continue
        entry = table(item, what)
        if set(entry) != set(_MIXTURE):
            raise StudyError(f"{what} needs {', '.join(_MIXTURE)} (got {', '.join(entry) or 'nothing'})")
        with errors_after(f"{what}: "):
            by_names[", ".join(names)] = MixtureCopula(*(_numbers(entry[name], name) for name in _MIXTURE))
    return by_names


def _numbers(value: object, name: str) -> Any:
    """Numbers in lists of lists as tuples of tuples."""
    if isinstance(value, list | tuple):
        return tuple(_numbers(item, name) for item in value)
    return quantity(value, "", name, bare=True)


def sources(value: object) -> tuple[Source, ...]:
    """Sources of priors in earlier results, from a list of tables or of :class:`Source`."""
    items = [value] if isinstance(value, Mapping | Source) else value
    if not isinstance(items, list | tuple):
        raise StudyError(f"'from' must be tables [[priors.from]] with a 'result' (got {value!r})")
    return tuple(item if isinstance(item, Source) else _taken(item) for item in items)


def _taken(value: object) -> Source:
    entry = table(value, "from")
    check_keys(entry, _TAKEN, "'from': ")
    if "result" not in entry:
        raise StudyError("'from' needs a 'result', the folder of a finished result")
    widen = quantity(entry.get("widen", 1.0), "", "widen")
    if not widen >= 1.0:
        raise StudyError(f"'widen' must be at least 1 (got {widen:g})")
    take = entry.get("take")
    if take is None:
        return Source(entry["result"], None, widen)
    if not isinstance(take, Mapping) or not all(isinstance(there, str) for there in take.values()):
        raise StudyError(f"'take' must be a table such as {{ n0 = \"n\" }}: here = there (got {take!r})")
    return Source(entry["result"], table(take, "take"), widen)


def _shape_arguments(name: str, dist: object) -> list[str]:
    """Names of a law's own arguments beside location and scale."""
    family = getattr(stats, dist, None) if isinstance(dist, str) else None
    if not isinstance(family, stats.rv_continuous):
        laws = (n for n in dir(stats) if isinstance(getattr(stats, n), stats.rv_continuous))
        hint = suggestion(str(dist), laws)
        raise StudyError(f"'{name}': 'dist' must be a continuous scipy.stats law, got {dist!r}{hint}")
    return [] if dist in RANGED else [part.strip() for part in (family.shapes or "").split(",") if part]


def _check_arguments(name: str, dist: str, entry: Mapping[str, Any], arguments: tuple[str, ...]) -> None:
    for key in entry:
        if key not in arguments:
            hint = did_you_mean(key, (*arguments, "source"))
            raise StudyError(f"'{name}': unknown argument '{key}' of {dist}{hint}")


def noise_entry(channel: str, value: object, *, bare: bool) -> Noise:
    """The noise of one channel: a value, a fraction with a floor, an estimate, or a :class:`Noise`.

    A table may add ``dof``, the degrees of freedom of a Student-t law, or ``residuals``, another law of them, and
    ``resolution``, the step to which readings are rounded; a value is then written ``sd``.
    """
    known("channel", channel, parameters.CHANNELS)
    if isinstance(value, Noise):
        return value
    if isinstance(value, Law):
        return Noise(channel, law=value)
    entry = table(value, channel) if isinstance(value, Mapping) else {"sd": value}
    dof = quantity(entry.pop("dof"), "", f"{channel}.dof") if "dof" in entry else np.inf
    own = residual_law(f"{channel}.residuals", entry.pop("residuals"), bare=bare) if "residuals" in entry else None
    resolution, dimension = 0.0, parameters.CHANNELS[channel].dimension
    if "resolution" in entry:
        resolution = quantity(entry.pop("resolution"), dimension, f"{channel}.resolution", bare=bare)
    size = _noise_size(channel, entry, bare=bare)
    return Noise(channel, dof=dof, resolution=resolution, residuals=own, **size)


def residual_law(name: str, value: object, *, bare: bool) -> OwnTails:
    """A law of standardised residuals.

    Parameters
    ----------
    value : name of a law of ``scipy.stats``; a table with ``dist`` and the law's own arguments, or with ``use``, a
        class of one's own; from Python also a frozen law, or an object with ``logpdf``, ``logcdf`` and ``ppf``.
    """
    stated: dict[str, object]
    made: Any = value
    if isinstance(value, str | Mapping):
        stated = table({"dist": value} if isinstance(value, str) else value, name)
        if "use" in stated:
            made = loaded(stated, f"'{name}'", bare=bare)
        else:
            dist = stated.get("dist")
            shapes = _shape_arguments(name, dist)
            _check_arguments(name, str(dist), stated, ("dist", *shapes))
            numbers = {key: quantity(item, "", f"{name}.{key}") for key, item in stated.items() if key != "dist"}
            if missing := [key for key in shapes if key not in numbers]:
                raise StudyError(f"'{name}': {dist} needs its argument '{missing[0]}'")
            made, stated = getattr(stats, str(dist))(**numbers), {"dist": dist, **numbers}
    elif isinstance(getattr(value, "dist", None), stats.rv_continuous):
        stated = {"dist": made.dist.name, **_arguments(made)}
    else:
        stated = stating(value)
    if stated.get("dist") in SLOW:
        raise StudyError(f"'{name}': the law {stated['dist']} is too slow: scipy needs milliseconds for every quantile")
    if not all(callable(getattr(made, function, None)) for function in ("logpdf", "logcdf", "ppf")):
        raise StudyError(
            f"'{name}' needs 'logpdf', 'logcdf' and 'ppf', as laws of scipy.stats have them (got {made!r})"
        )
    try:
        return OwnTails(made, tuple((key, tuple(v) if isinstance(v, list) else v) for key, v in stated.items()))
    except Exception as error:  # whatever the code of others raises
        raise StudyError(f"'{name}': the law {error}") from error


def _noise_size(channel: str, entry: Mapping[str, Any], *, bare: bool) -> dict[str, Any]:
    """Size of the noise, as arguments of :class:`Noise`."""
    dimension = parameters.CHANNELS[channel].dimension
    if set(entry) == {"sd"}:
        return {"sd": quantity(entry["sd"], dimension, channel, bare=bare)}
    if set(entry) == {"fraction", "floor"}:
        fraction = quantity(entry["fraction"], "", f"{channel}.fraction")
        floor = quantity(entry["floor"], dimension, f"{channel}.floor", bare=bare)
        return {"fraction": fraction, "floor": floor}
    if set(entry) == {"estimate"}:
        return {"law": _estimate(channel, entry["estimate"], bare=bare)}
    raise StudyError(f"'{channel}' must be {_NOISE_FORMS} (got {', '.join(entry) or 'nothing'})")


def _estimate(channel: str, value: object, *, bare: bool) -> Law:
    """Law of an unknown standard deviation; ``lower`` is a tenth of the scale unless given."""
    if isinstance(value, Law):
        return value
    if channel not in parameters.OUTCOMES:
        raise StudyError(f"noise of '{channel}' cannot be estimated, as it is never an outcome")
    entry, dimension = table(value, f"{channel}.estimate"), parameters.CHANNELS[channel].dimension
    if "lower" not in entry:
        if "scale" not in entry:
            raise StudyError(f"'{channel}.estimate' needs a 'lower' above 0 or a 'scale'")
        scale = quantity(entry["scale"], dimension, f"{channel}.estimate.scale", bare=bare)
        entry["lower"] = f"{scale / 10!r} {dimension}"
    return law(f"{channel}.estimate", entry, dimension, bare=bare)


def noise(value: object, *, bare: bool) -> dict[str, Noise]:
    """The [noise] table: noise of every channel."""
    return {channel: noise_entry(channel, item, bare=bare) for channel, item in table(value, "noise").items()}


REFERENCE = "reference_sinkage"
"""Key of [priors]: laws of k_c and k_φ are those of k_c zⁿ and k_φ zⁿ at this sinkage."""


@dataclass(frozen=True)
class StatedPriors:
    """The [priors] table as it was read.

    Attributes
    ----------
    entries : laws, fixed values and ties by parameter.
    chosen : name of the prior ``set`` for the other parameters; None where none is named.
    sources : what is taken ``from`` earlier results.
    correlation : of normal scores, by pair.
    mixtures : mixture copulas by parameters.
    reference : sinkage (m) at which the laws of k_c and k_φ are those of k_c zⁿ and k_φ zⁿ; 1 m: of k_c and k_φ.
    """

    entries: Mapping[str, Entry] = field(default_factory=dict)
    chosen: str | None = None
    sources: tuple[Source, ...] = ()
    correlation: Mapping[str, float] = field(default_factory=dict)
    mixtures: Mapping[str, MixtureCopula] = field(default_factory=dict)
    reference: float = 1.0

    def beside(self, study: Path) -> "StatedPriors":
        """The same, with folders of results understood from that of a study file."""
        return replace(self, sources=tuple(source.beside(study) for source in self.sources))


def priors(value: object, *, bare: bool) -> StatedPriors:
    """The [priors] table, or what was made of it."""
    if isinstance(value, StatedPriors):
        return value
    content = table(value, "priors")
    earlier, tied, mixed = content.pop("from", ()), content.pop("correlation", {}), content.pop("mixture", {})
    reference = quantity(content.pop(REFERENCE, "1 m"), "m", REFERENCE, bare=bare)
    if reference <= 0:
        raise StudyError(f"'{REFERENCE}' must be above 0 (got {reference:g} m)")
    chosen = content.pop("set", None)
    if chosen is not None and str(chosen) not in stated_sets():
        raise StudyError(f"unknown prior set {chosen!r}{did_you_mean(str(chosen), stated_sets())}")
    stated = {key: prior_entry(key, item, bare=bare) for key, item in content.items()}
    name = None if chosen is None else str(chosen)
    return StatedPriors(stated, name, sources(earlier), correlations(tied), mixtures(mixed), reference)


_OF_LOADS = "load_effect"


@cache
def stated_sets() -> Mapping[str, Mapping[str, Any]]:
    """Tables of all named sets of priors, as they are written."""
    return tomllib.loads(read_text(Path(__file__).with_name("prior_sets.toml"), MEGABYTE))


@cache
def prior_set(name: str, *, load_effect: bool = False) -> Mapping[str, Entry]:
    """Priors of the soil parameters in a set, or of the coefficients of the load effect; SI."""
    stated = dict(stated_sets()[name])
    of_loads = stated.pop(_OF_LOADS)
    held, stated = ({}, dict.fromkeys(parameters.LOAD_EFFECT, of_loads)) if load_effect else (parameters.HELD, stated)
    return {**{key: prior_entry(key, value, bare=False) for key, value in stated.items()}, **held}
