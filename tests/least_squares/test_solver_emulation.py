"""The emulated solver of the paper: plain problems, what it owes to its start, and the paper's K_s."""

from collections.abc import Callable, Mapping

import numpy as np
import pandas as pd
import pytest

from bayesterra.errors import StudyError
from bayesterra.least_squares.fit import fit, fit_from_starts
from bayesterra.least_squares.results import report_table
from bayesterra.least_squares.solver import Quadratic, Search
from bayesterra.models import M1, Soil
from bayesterra.study.study import Study

Printed = Mapping[str, Mapping[str, Soil]]
SLIPS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.6)
"""Slips of the paper's tests."""


@pytest.fixture(scope="module")
def make(
    make_paper_study: Callable[..., Study], make_table: Callable[..., pd.DataFrame], printed: Printed
) -> Callable[..., Study]:
    """Wh31 on noise-free readings of Table 10 with the paper's s_j1 = 0.1, with some ``[least_squares]``."""
    soil, model = printed["IM1"]["Wh31"], M1(transition_slips=(0.1, 0.5))
    data = make_table("M1", "Wh31", soil, SLIPS)
    wheel = make_paper_study("M1", "Wh31", soil).wheels["Wh31"]
    depth = model.sinkage(soil, wheel, np.array(SLIPS), 80.0)
    forces = model.forces(soil, wheel, np.array(SLIPS), depth)
    data["sinkage [m]"], data["drawbar_pull [N]"] = depth, forces.drawbar_pull
    data["resistance_moment [N m]"] = forces.resistance_moment
    options = {"transition_slips": [0.1, 0.5]}
    return lambda **given: make_paper_study("M1", "Wh31", soil, data=data, model_options=options, least_squares=given)


@pytest.fixture(scope="module")
def free(make: Callable[..., Study]) -> Study:
    """K_s free, as Section 5.2 has it."""
    return make()


def test_a_step_in_a_plane_keeps_to_the_radius() -> None:
    """Inside the radius the step is Newton's; a smaller radius is met exactly, and no other step there is lower."""
    model = Quadratic(np.array([1.0, -2.0, 0.5]), np.diag([2.0, 1.0, 4.0]))
    whole = np.eye(3)
    newton = model.least(whole, 10.0)
    assert newton == pytest.approx([-0.5, 2.0, -0.125])
    short = model.least(whole, 0.5)
    assert np.linalg.norm(short) == pytest.approx(0.5)
    others = np.random.default_rng(0).standard_normal((2000, 3))
    others *= 0.5 / np.linalg.norm(others, axis=1, keepdims=True)
    assert model(short) <= min(model(other) for other in others) + 1e-12
    plane = model.plane()
    assert plane.T @ plane == pytest.approx(np.eye(2))
    assert plane @ (plane.T @ model.gradient) == pytest.approx(model.gradient)


def test_a_minimum_inside_and_one_on_a_bound_are_found() -> None:
    """Well-conditioned problems end where they should, whatever the solver; evaluations are counted."""

    def rosenbrock(x: np.ndarray) -> np.ndarray:
        return np.array([10 * (x[1] - x[0] ** 2), 1 - x[0]])

    inside = Search(rosenbrock, np.array([-3.0, -3.0]), np.array([3.0, 3.0]))
    x, value, ended = inside.run(np.array([-1.2, 1.0]), 600)
    assert ended
    assert x == pytest.approx([1.0, 1.0], abs=0.02)
    assert value < 1e-4
    assert inside.evaluations % 3 == 0
    bound = Search(lambda x: x - np.array([2.0, 1.0]), np.zeros(2), np.array([1.0, 5.0]))
    x, _, ended = bound.run(np.array([0.3, 4.0]), 600)
    assert ended
    assert x == pytest.approx([1.0, 1.0], abs=1e-3)
    assert x[0] < 1.0


def test_the_end_of_the_evaluations_is_told() -> None:
    """A search that is stopped says so."""
    search = Search(lambda x: np.array([x[0] - 2.0, 1e-3 * (x[1] - 1.0)]), np.zeros(2), np.array([9.0, 9.0]))
    assert not search.run(np.array([0.3, 4.0]), 5)[2]


def test_the_paper_s_stiffness_comes_back(free: Study) -> None:
    """K_s of Tables 10 and 14, 2499.0 and 2498.7 kPa/m^N, where a converged fit ends elsewhere; c is not the truth."""
    found = fit(free, ("IM1", "IM3"), solvers=("converged", "lsqcurvefit"))
    assert list(found) == ["IM1", "IM1 lsqcurvefit", "IM3", "IM3 lsqcurvefit"]
    assert found["IM1 lsqcurvefit"].soil.Ks == pytest.approx(2499.0e3, abs=150)
    assert found["IM3 lsqcurvefit"].soil.Ks == pytest.approx(2498.7e3, abs=150)
    assert abs(found["IM1"].values()["Ks"] - 2.5e6) > 1e5
    assert 150 < found["IM1 lsqcurvefit"].values()["c"] < 240  # its start is 200, the truth 97 Pa
    first = found["IM1 lsqcurvefit"]
    assert (first.method, first.solver, first.passes > 5, first.evaluations > 500) == ("IM1", "lsqcurvefit", True, True)
    table = report_table(found, free)
    assert list(table.columns)[:3] == ["method", "solver", "parameter"]
    assert set(table["solver"]) == {"converged", "lsqcurvefit"}
    assert "solver" not in report_table({"IM1": found["IM1"]}, free)


@pytest.mark.slow
def test_the_start_is_returned(make: Callable[..., Study]) -> None:
    """From each start the emulation ends near it, the converged solver at one place."""
    starts = fit_from_starts(make(hold={"Ks": 2.499e6})).round(6)
    assert set(starts["parameter"]) == {"c"}
    assert starts["own"].tolist() == [False, True, False, False]
    own = starts[starts["own"]].iloc[0]
    assert own["start"] == 0.2
    assert starts["start"].tolist() == [0.05, 0.2, 1.0, 3.0]
    assert np.ptp(starts["converged"]) < 0.02
    assert starts["lsqcurvefit"].iloc[-1] > 5 * starts["lsqcurvefit"].iloc[0]


def test_solvers_are_named(free: Study) -> None:
    """An unknown solver is refused with the known ones; one alone gives fits by their method."""
    with pytest.raises(StudyError, match=r"^'solvers' must be among converged, lsqcurvefit \(got newton\)$"):
        fit(free, ("IM2",), solvers=("newton",))
    alone = fit(free, ("IM2",), solvers=("lsqcurvefit",))
    assert {name: (found.name, found.solver) for name, found in alone.items()} == {
        "IM2": ("IM2 lsqcurvefit", "lsqcurvefit")
    }
