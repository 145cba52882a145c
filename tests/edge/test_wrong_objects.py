"""Public functions called with what they do not take: one line of the package that names what they need."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

import bayesterra as bt

ROWS = pd.DataFrame({"slip": [0.1], "load [N]": [80.0], "sinkage [mm]": [5.0]})
Call = Callable[[Any], object]

STUDY: dict[str, Call] = {
    "run": bt.run,
    "run_prior": bt.run_prior,
    "posterior": bt.posterior,
    "fit": bt.fit,
    "simulate": bt.simulate,
    "foresee": bt.foresee,
    "calibrate": lambda wrong: bt.calibrate(wrong, n=20),
}
EITHER: dict[str, Call] = {
    "identify": bt.identify,
    "leave_out": bt.leave_out,
    "recommend": bt.recommend,
    "Stream": bt.Stream,
}
RESULT: dict[str, Call] = {
    "predict": lambda wrong: bt.predict(wrong, 0.1),
    "predict_rover": lambda wrong: bt.predict_rover(wrong, "rover.toml"),
}
TABLE: dict[str, Call] = {
    "Study": lambda wrong: bt.Study(wrong, {}, slip_reference="rim"),
    "soil_test": lambda wrong: bt.soil_test(data=wrong, kind="plate"),
}
PATH: dict[str, Call] = {
    "load_study": bt.load_study,
    "load_result": bt.load_result,
    "load_soil_test": bt.load_soil_test,
    "load_stream": bt.load_stream,
    "read_tasks": bt.read_tasks,
}
OTHERS: dict[str, Call] = {
    "compare": bt.compare,
    "dask_cluster": bt.dask_cluster,
    "local_pool": bt.local_pool,
    "Law": bt.Law,
    "Prior": bt.Prior,
    "Noise": bt.Noise,
}
SURE = {"in_process"}
"""Takes nothing."""


def test_every_public_function_is_here() -> None:
    """A new one gets its line."""
    tried = {*STUDY, *EITHER, *RESULT, *TABLE, *PATH, *OTHERS, *SURE}
    assert {name for name in bt.__all__ if name[0].islower()} <= tried


@pytest.mark.parametrize("wrong", [None, 3, [1, 2], object()], ids=lambda wrong: type(wrong).__name__)
@pytest.mark.parametrize("name", {**STUDY, **EITHER, **RESULT, **TABLE, **PATH})
def test_another_object(name: str, wrong: object) -> None:
    """The line says what is needed and what was got."""
    if name == "soil_test" and wrong is None:
        pytest.skip("None is no data")
    with pytest.raises(bt.StudyError, match=f"^bt.{name} needs ") as caught:
        {**STUDY, **EITHER, **RESULT, **TABLE, **PATH}[name](wrong)
    got = "None" if wrong is None else f"an object of type {type(wrong).__name__}"
    assert str(caught.value).endswith(f"(got {got})")


@pytest.mark.parametrize("wrong", ["studies/x", Path("studies/x")])
@pytest.mark.parametrize("name", {**STUDY, **EITHER, **RESULT, **TABLE})
def test_a_path_in_place_of_what_it_holds(name: str, wrong: str | Path) -> None:
    """The line says how to load it."""
    loads = [
        loader
        for loader, calls in (
            ("bt.load_study", {**STUDY, **EITHER}),
            ("bt.load_result", {**EITHER, **RESULT}),
            ("pandas.read_csv", TABLE),
        )
        if name in calls
    ]
    with pytest.raises(bt.StudyError, match=f"^bt.{name} needs ") as caught:
        {**STUDY, **EITHER, **RESULT, **TABLE}[name](wrong)
    how = " or ".join(f"{loader}('studies/x')" for loader in loads)
    assert str(caught.value).endswith(f", not a path: load it first with {how}")


@pytest.mark.parametrize("wrong", [None, 3, [1, 2], object(), "x", Path("x")], ids=lambda w: type(w).__name__)
@pytest.mark.parametrize("name", OTHERS)
def test_what_takes_something_else(name: str, wrong: object) -> None:
    """An error of the package."""
    if name == "local_pool" and (wrong is None or wrong == 3):
        pytest.skip("None means all processors, and 3 is a number of them")
    with pytest.raises(bt.BayesterraError):
        OTHERS[name](wrong)


def test_results_are_compared_by_name() -> None:
    """A list of something else than folders, and a mapping of something else than results."""
    with pytest.raises(bt.StudyError, match=r"bt.compare needs the path of a result folder in its list"):
        bt.compare([object()])  # type: ignore[list-item]
    with pytest.raises(bt.StudyError, match=r"bt.compare needs a finished result, not a path: load it first"):
        bt.compare({"a": "out", "b": "other"})  # type: ignore[dict-item]


def test_a_soil_test_that_is_none() -> None:
    """Neither a file nor a loaded test."""
    with pytest.raises(bt.StudyError, match=r"^bt.soil_test needs a soil test, as bt.load_soil_test"):
        bt.soil_test(3)  # type: ignore[arg-type]


def test_wheels_that_are_none() -> None:
    """Also named in a line."""
    for wrong in (None, "x", [1], 3):
        with pytest.raises(bt.StudyError, match="'wheels' must be a table"):
            bt.Study(ROWS, wrong, slip_reference="rim")  # type: ignore[arg-type]
