"""The [pooling] table: which parameters groups share, which each has alone, which come from one law."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, check_keys, known
from bayesterra.parameters import PARAMETERS, whole_and_part
from bayesterra.stats.laws import Law
from bayesterra.study.entries import law, table

SPREAD_SHARE = 0.5
"""Scale of the default prior of a spread, half-normal, as a share of the parameter's prior sd."""
GROUPINGS = ("wheel", "site", "run")
"""Columns of a table of measurements that may say which group a row belongs to."""
_KEYS = ("by", "shared", "separate", "hierarchical")


@dataclass(frozen=True)
class Population:
    """Priors of a hierarchical parameter's population; None for the default.

    Attributes
    ----------
    mean : law of the population mean; by default the parameter's own prior.
    spread : law of the population's standard deviation, above 0; by default half-normal, its scale half of
        the standard deviation of the parameter's own prior.
    """

    mean: Law | None = None
    spread: Law | None = None

    def laws(self, own: Law) -> tuple[Law, Law]:
        """Laws of mean and spread, the defaults from the parameter's own prior."""
        return self.mean or own, self.spread or Law("halfnorm", {"scale": SPREAD_SHARE * law_sd(own)})


def law_sd(own: Law) -> float:
    """Standard deviation of a law, from its quantiles."""
    values: FloatArray = own.quantile((np.arange(4000) + 0.5) / 4000)
    return float(values.std())


@dataclass(frozen=True)
class Pooling:
    """Parameters that groups of rows share, and those that each group has for itself.

    Parameters that no list names are shared, noise too.

    Attributes
    ----------
    by : the column that says which group a row belongs to.
    shared : parameters with one value for all groups.
    separate : parameters with a value for each group, each under the parameter's own prior.
    hierarchical : parameters with a value for each group, drawn from a normal law of unknown mean and spread
        that is cut to the range of the parameter's own prior.
    """

    by: str = "wheel"
    shared: tuple[str, ...] = ()
    separate: tuple[str, ...] = ()
    hierarchical: Mapping[str, Population] = field(default_factory=dict)

    @property
    def left_out(self) -> str:
        """Sentence on refits without some rows: how a group is predicted of which none is left."""
        sources = [name for name, of in (("population", self.hierarchical), ("prior", self.separate)) if of]
        whole = f"a {self.by} that is left out whole is predicted from the {' and the '.join(sources)}"
        return f"Refits are of the joint posterior; {whole}."

    def record(self) -> dict[str, object]:
        """Roles of the parameters, for ``run.json``."""
        lists = {name: list(getattr(self, name)) for name in ("shared", "separate", "hierarchical")}
        return {"by": self.by, **lists}

    def own_names(self, groups: Iterable[str]) -> list[str]:
        """Names of what is not one value for all: ``K.mean``, ``K.spread``, ``K[Wh11]``."""
        values = [f"{name}[{group}]" for group in groups for name in (*self.separate, *self.hierarchical)]
        return [f"{name}.{part}" for name in self.hierarchical for part in ("mean", "spread")] + values

    def checked(self, laws: Mapping[str, Law]) -> "Pooling":
        """The same with every free parameter in one list and every population's priors known.

        StudyError where one has no law of its own, or nothing is common to the groups, or everything.
        """
        for name in (*self.shared, *self.separate, *self.hierarchical):
            if name not in laws:
                held = "is fixed or tied" if name in PARAMETERS else "is not known"
                raise StudyError(f"[pooling] '{name}' {held}: name free parameters ({', '.join(laws)})")
        own = (*self.separate, *self.hierarchical)
        shared = tuple(name for name in laws if name not in own)
        if not own:
            raise StudyError("[pooling] needs a 'separate' or 'hierarchical' parameter: else leave it out")
        if not shared and not self.hierarchical:
            raise StudyError("[pooling] needs a 'shared' or 'hierarchical' parameter: else run groups alone")
        separate = tuple(name for name in laws if name in self.separate)
        named = [name for name in laws if name in self.hierarchical]
        populations = {name: Population(*self.hierarchical[name].laws(laws[name])) for name in named}
        return Pooling(self.by, shared, separate, populations)


def values_of_group(values: Mapping[str, float], group: str | None) -> dict[str, float]:
    """Values by plain name that a group has: its own, ``K[Wh11]``, before those of all."""
    split = {name: whole_and_part(name) for name in values}
    common = {name: value for name, value in values.items() if not split[name][1]}
    return common | {split[n][0]: value for n, value in values.items() if split[n][1] == f"[{group}]"}


def pooling_table(value: object, *, bare: bool) -> Pooling | None:
    """The [pooling] table; None without one, StudyError for unknown names or a parameter in two lists."""
    if value is None or isinstance(value, Pooling):
        return value
    content = table(value, "pooling")
    check_keys(content, _KEYS)
    by = content.get("by", "wheel")
    if by not in GROUPINGS:
        raise StudyError(f"'by' must be one of the columns {', '.join(GROUPINGS)} (got {by!r})")
    shared, separate = (_names(content.get(key, ()), key) for key in ("shared", "separate"))
    hierarchical = table(content.get("hierarchical", {}), "hierarchical")
    populations = {
        known("parameter", name, PARAMETERS): _population(name, entry, bare=bare)
        for name, entry in hierarchical.items()
    }
    named = [*shared, *separate, *populations]
    for name in named:
        if named.count(name) > 1:
            raise StudyError(f"'{name}' must stand in one list only")
    return Pooling(str(by), shared, separate, populations)


def _names(value: object, key: str) -> tuple[str, ...]:
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise StudyError(f"'{key}' must be a list of parameters (got {value!r})")
    return tuple(known("parameter", str(name), PARAMETERS) for name in value)


def _population(name: str, value: object, *, bare: bool) -> Population:
    content = table(value, f"hierarchical.{name}")
    laws: dict[str, Law] = {}
    for key, entry in content.items():
        if key not in ("mean", "spread"):
            raise StudyError(f"'hierarchical.{name}' takes 'mean' and 'spread' (got '{key}')")
        where, unit = f"{name}.{key}", PARAMETERS[name].dimension
        laws[key] = entry if isinstance(entry, Law) else law(where, table(entry, where), unit, bare=bare)
    if "spread" in laws and laws["spread"].range[0] < 0:
        low = laws["spread"].range[0] / PARAMETERS[name].scale
        raise StudyError(f"'{name}.spread' must be a law of numbers from 0 on (got one from {low:g} on)")
    return Population(laws.get("mean"), laws.get("spread"))
