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
LOADED: dict[str, Call] = STUDY | EITHER | RESULT
SURE = {"in_process"}
"""Takes nothing."""


def test_every_public_function_is_here() -> None:
    """A new one gets its line."""
    tried = {*LOADED, *TABLE, *PATH, *OTHERS, *SURE}
    assert {name for name in bt.__all__ if name[0].islower()} <= tried


@pytest.mark.parametrize("wrong", [None, 3, [1, 2], object()], ids=lambda wrong: type(wrong).__name__)
@pytest.mark.parametrize("name", LOADED | TABLE | PATH)
def test_another_object(name: str, wrong: object) -> None:
    """The line says what is needed and what was got."""
    if name == "soil_test" and wrong is None:
        pytest.skip("None is no data")
    with pytest.raises(bt.StudyError, match=f"^bt.{name} needs ") as caught:
        (LOADED | TABLE | PATH)[name](wrong)
    got = "None" if wrong is None else f"an object of type {type(wrong).__name__}"
    assert str(caught.value).endswith(f"(got {got})")


@pytest.mark.parametrize("wrong", ["studies/x", Path("studies/x")])
@pytest.mark.parametrize("name", LOADED | TABLE)
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
        (LOADED | TABLE)[name](wrong)
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
    with pytest.raises(bt.StudyError, match=r"^bt.soil_test needs a study, as bt.load_study"):
        bt.soil_test(3)  # type: ignore[arg-type]


def test_wheels_that_are_none() -> None:
    """Also named in a line."""
    for wrong in (None, "x", [1], 3):
        with pytest.raises(bt.StudyError, match="'wheels' must be a table"):
            bt.Study(ROWS, wrong, slip_reference="rim")  # type: ignore[arg-type]


WHEEL = bt.Wheel(0.157, 0.165)
FIXED = {"set": "paper-box", "Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 268.0, "K": 0.01, "c1": 0.3, "c2": 0.0}


def study(**columns: Any) -> bt.Study:
    """Two rows in which columns were replaced; only φ is free."""
    rows = pd.DataFrame({"slip": [0.1, 0.2], "load [N]": [80.0, 80.0], "sinkage [mm]": [5.0, 7.0]})
    return bt.Study(
        rows.assign(**{name.replace("_", " ", 1): column for name, column in columns.items()}),
        {"W": WHEEL},
        slip_reference="shearing",
        model="M2",
        noise={"sinkage": 1e-3},
        priors=FIXED,
    )


@pytest.mark.parametrize(
    ("column", "cells"),
    [
        ("load_[N]", [80.0, True]),
        ("load_[N]", [True, True]),
        ("sinkage_[mm]", [5.0, True]),
        ("sinkage_[mm]", pd.array([False, True])),
        ("slip", [0.1, False]),
    ],
)
def test_truth_values_are_no_readings(column: str, cells: Any) -> None:
    """True in a table is a mistake, not 1 mm; only the column ``use`` is for them."""
    cells = pd.Series(cells, dtype=object)
    name = column.split("_")[0]
    with pytest.raises(bt.StudyError, match=rf"'{name}' must be a number or empty \(got (True|False), row \d"):
        study(**{column: cells})
    used = study(use=[True, False])
    assert used.observations.use.tolist() == [True, False]


NUMBERS: dict[str, Call] = {
    "Law.lower": lambda wrong: bt.Law("uniform", lower=wrong, upper=2.0),
    "Law.loc": lambda wrong: bt.Law("norm", {"loc": wrong, "scale": 1.0}),
    "Noise.sd": lambda wrong: bt.Noise("sinkage", sd=wrong),
    "Noise.dof": lambda wrong: bt.Noise("sinkage", sd=1.0, dof=wrong),
    "Prior": lambda wrong: bt.Prior({**bt.posterior(study()).prior.entries, "c": wrong}),
    "Wheel": lambda wrong: bt.Wheel(wrong, 0.1),
    "Soil": lambda wrong: bt.Soil(2.5e6, 0.8, 1.0, wrong, 0.5, 0.01, 0.3, 0.0),
    "fit.hold": lambda wrong: bt.fit(study(), hold={"c": wrong}),
    "calibrate.n": lambda wrong: bt.calibrate(study(), n=wrong),
}


@pytest.mark.parametrize("wrong", [True, "x"])
@pytest.mark.parametrize("name", NUMBERS)
def test_truth_values_and_texts_are_no_numbers(name: str, wrong: object) -> None:
    """Neither in laws nor in noise, soils, wheels and options."""
    with pytest.raises(ValueError, match=rf"must be a number.*\(got {wrong!r}\)"):
        NUMBERS[name](wrong)


@pytest.mark.parametrize("wrong", ["x", None, -1, 1.5, True])
def test_seeds_are_whole_numbers(wrong: object) -> None:
    """One line for every other object, wherever a seed is taken."""
    calls: list[Call] = [
        lambda seed: bt.run(study(), seed=seed),
        lambda seed: bt.run_prior(study(), seed=seed),
        lambda seed: bt.simulate(study(), seed=seed),
        lambda seed: bt.identify(study(), seed=seed),
        lambda seed: bt.foresee(study(), seed=seed),
        lambda seed: bt.leave_out(study(), seed=seed),
        lambda seed: bt.calibrate(study(), n=20, seed=seed),
        lambda seed: bt.recommend(study(), seed=seed),
        lambda seed: bt.Stream(study(), seed=seed),
    ]
    for call in calls:
        with pytest.raises(bt.StudyError, match=r"^'seed' must be a whole number from 0 \(got "):
            call(wrong)
