"""Models of one's own in studies: laws of forces from Python, or loaded by name where code is allowed."""

import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import asdict, dataclass, is_dataclass
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import numpy as np

from bayesterra.errors import StudyError, did_you_mean
from bayesterra.models import Conditions, ModelParameter, OwnModel, Wheel
from bayesterra.parameters import PARAMETERS, Parameter, register
from bayesterra.study.units import si_of

ENTRY_POINTS = "bayesterra.models"
"""Group of entry points by whose names installed models are known."""
OURS = {
    "wong-reece": "bayesterra.models.examples:WongReece",
    "bekker-janosi": "bayesterra.models.examples:BekkerJanosi",
}
"""Models that come with the package: these classes and nothing else need no leave."""
_ALLOWED: ContextVar[bool] = ContextVar("code_allowed", default=False)


@contextmanager
def allowing_code(allowed: bool = True) -> Iterator[None]:
    """Study files read inside may name code, which is then run; what was allowed before stays allowed."""
    token = _ALLOWED.set(allowed or _ALLOWED.get())
    try:
        yield
    finally:
        _ALLOWED.reset(token)


@dataclass(frozen=True)
class StudyModel(OwnModel):
    """A model of one's own whose parameters the package knows, in every process that gets it."""

    def __reduce__(self) -> "tuple[Callable[..., StudyModel], tuple[Any, ...]]":
        """Make it anew, parameters and all, from its law."""
        return own_model, (self.law, self.stated)


def own_model(law: Any, stated: Mapping[str, object] | None = None) -> StudyModel:
    """A law of forces as the model of a study; its parameters become known by their names.

    Parameters
    ----------
    law : as :class:`bayesterra.models.own.ForceLaw`.
    stated : how a study file states it; None: by its class, and by its fields where it is a dataclass.

    Raises
    ------
    StudyError : it is no law, or its parameters have no units or the names of other quantities.
    """
    name = type(law).__name__
    if not callable(getattr(law, "forces", None)) or not isinstance(getattr(law, "parameters", None), list | tuple):
        raise StudyError(f"the model {name} needs 'parameters', a tuple of names, and a method 'forces'")
    scales = {}
    for each in law.parameters:
        if isinstance(each, ModelParameter):
            parameter = _parameter(each)
            scales[each.name] = parameter.scale
            try:
                register(parameter)
            except ValueError as error:
                raise StudyError(str(error)) from error
        elif each not in PARAMETERS:
            hint = did_you_mean(str(each), PARAMETERS)
            raise StudyError(f"the model {name} has an unknown parameter {each!r}{hint}: describe it by ModelParameter")
    try:
        model = StudyModel(law, stating(law) if stated is None else dict(stated), scales)
    except ValueError as error:
        raise StudyError(f"the model {name}: {error}") from error
    _try(model)
    return model


def _try(model: OwnModel) -> None:
    """Call a law once with sets against rows and once in pairs, so that its faults are told before any work."""
    theta, rows = np.array([[model.scale(name) for name in model.parameters]] * 3), np.array([0.1, 0.2, 0.3])
    conditions = Conditions.of(Wheel(radius=0.15, width=0.15), rows)
    try:
        model.forces_at(theta[:2], conditions, 0.01)
        model.response_of_pairs(theta, conditions, np.full(3, 50.0))
    except Exception as error:  # whatever the code of others raises
        raise StudyError(f"the model {model.name} fails ({type(error).__name__}: {error})") from error


def _parameter(each: ModelParameter) -> Parameter:
    scale, dimension = si_of(each.unit, each.name)
    symbol = each.symbol or each.name
    latex = rf"\mathrm{{{symbol}}}" if symbol.isascii() else symbol
    return Parameter(
        each.name, symbol, latex, each.unit or "-", scale, dimension, each.description or f"parameter {each.name}"
    )


def installed_models() -> dict[str, str]:
    """Places of installed models, ``module:Class``, by their names: ours, and those of entry points."""
    return {point.name: point.value for point in entry_points(group=ENTRY_POINTS)} | OURS


def loaded_model(stated: Mapping[str, object], *, bare: bool = False) -> StudyModel:
    """The model that a table ``[model]`` names by ``use``; its other keys make it.

    StudyError where code is not allowed, cannot be loaded, or makes no model.
    """
    return own_model(loaded(stated, "[model]", bare=bare), stated)


def loaded(stated: Mapping[str, object], where: str, *, bare: bool) -> Any:
    """What the class that a table names by ``use`` makes of its other keys.

    Raises
    ------
    StudyError : code is not allowed, or cannot be loaded.
    """
    keywords = {str(key): value for key, value in stated.items()}
    use = keywords.pop("use", None)
    if not isinstance(use, str) or not use.strip():
        raise StudyError(f"needs 'use', \"module:Class\" or the name of an installed model (got {use!r})")
    installed = installed_models()
    target = installed.get(use, use)
    module, colon, path = target.partition(":")
    if not colon or not path:
        raise StudyError(
            f"'use' must be \"module:Class\" or an installed model (got '{use}'){did_you_mean(use, installed)}"
        )
    if not (bare or _ALLOWED.get() or target in OURS.values()):
        raise StudyError(
            f"use = \"{use}\" runs the code of the module '{module}': allow it by --allow-code,"
            " in Python by allow_code=True, if you trust it"
        )
    try:
        if (here := str(Path.cwd())) not in sys.path:  # a module is installed or in the working directory
            sys.path.append(here)
        made: Any = import_module(module)
        for part in path.split("."):
            made = getattr(made, part)
        return made(**keywords)
    except Exception as error:  # whatever the code of others raises
        said = f"{type(error).__name__}: {error}"
        raise StudyError(f'{where} use = "{use}" cannot be loaded ({said:.300})') from error


def stating(made: Any) -> dict[str, object]:
    """How a study file states an object of one's own: by its class, and by its fields where it is a dataclass."""
    fields = asdict(made) if is_dataclass(made) and not isinstance(made, type) else {}
    return {"use": f"{type(made).__module__}:{type(made).__qualname__}", **fields}
