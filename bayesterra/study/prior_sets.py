"""Named sets of priors, in the words of a study file: ``prior_sets.toml``."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

from bayesterra.parameters import HELD, LOAD_EFFECT
from bayesterra.runtime.reading import MEGABYTE, read_text
from bayesterra.study.entries import prior_entry
from bayesterra.study.priors import Entry

NO_SOURCE = "no independent source"
"""Beginning of the source of a law for which nothing but its limits speaks."""
_OF_LOADS = "load_effect"


@cache
def stated_sets() -> Mapping[str, Mapping[str, Any]]:
    """Tables of all sets by name, as they are written."""
    return tomllib.loads(read_text(Path(__file__).with_name("prior_sets.toml"), MEGABYTE))


@cache
def prior_set(name: str, *, load_effect: bool = False) -> Mapping[str, Entry]:
    """Priors of the soil parameters in a set, or of the coefficients of the load effect; SI."""
    stated = dict(stated_sets()[name])
    of_loads = stated.pop(_OF_LOADS)
    stated = dict.fromkeys(LOAD_EFFECT, of_loads) if load_effect else {**stated, **HELD}
    return {key: prior_entry(key, value, bare=False) for key, value in stated.items()}
