"""Models of one's own against the compiled ones they wrap, and the two examples against independent evaluations."""

import numpy as np
import pytest
from scipy.integrate import quad

from bayesterra.arrays import FloatArray
from bayesterra.models import M1, MODELS, Conditions, ModelParameter, OwnModel, Status, Wheel
from bayesterra.models.examples import BekkerJanosi, WongReece
from tests.support.own_laws import PaperLaw, Plate, TwoForces

WHEEL = Wheel(0.15735, 0.165, 0.010, 30, 0.65)
CONDITIONS = Conditions.of(WHEEL, np.array([0.05, 0.2, 0.4, 0.6]))
LOW = np.array([1e5, 0.3, 0.0, 0.0, 0.01, 0.002, -0.2, -0.5, -0.2])
HIGH = np.array([1e7, 2.0, 2.0, 5e3, 0.85, 0.05, 0.9, 0.5, 0.1])


def box(n: int) -> FloatArray:
    """Soils (n, 9) over the prior box."""
    return np.asarray(LOW + (HIGH - LOW) * np.random.default_rng(2).random((n, 9)))


@pytest.mark.parametrize("name", ["M1", "M2"])
def test_a_law_of_forces_is_a_whole_model(name: str) -> None:
    """Forces, responses, derivatives, and whether there is an answer, as of the compiled model that is wrapped."""
    own, compiled, theta = OwnModel(PaperLaw(name)), MODELS[name](), box(300)
    load = np.array([20.0, 60.0, 80.0, 150.0])
    (mine, said), (theirs, status) = (
        own.response_at(theta, CONDITIONS, load),
        compiled.response_at(theta, CONDITIONS, load, every_row=True),
    )
    assert ((said == Status.OK) == (status == Status.OK)).all()
    assert (said[status == Status.LOAD] == Status.LOAD).all()
    assert (status != Status.OK).any()
    scale = np.nanmax(np.abs(theirs), axis=(0, 1))
    assert np.nanmax(np.abs(mine - theirs) / scale) < 1e-9
    pairs, of_pairs = own.response_of_pairs(theta[:4], CONDITIONS, load)
    diagonal = np.arange(4)
    assert pairs[of_pairs == 0] == pytest.approx(mine[diagonal, diagonal][of_pairs == 0], rel=1e-12)
    depth = np.array([0.004, 0.01, 0.02, 0.03])
    slopes, exact = own.jacobian_at(theta, CONDITIONS, depth), compiled.jacobian_at(theta, CONDITIONS, depth)
    size = np.nanmax(np.abs(exact), axis=(0, 1))
    assert np.nanmax(np.abs(slopes - exact) / np.where(size > 0, size, 1.0)) < 1e-6


def test_derivatives_that_a_law_states_are_taken() -> None:
    """Exact ones in place of differences."""

    class Stating(Plate):
        def slopes(self, soil: object, wheel: object, slip: FloatArray, sinkage: FloatArray) -> FloatArray:
            return np.full((*sinkage.shape, 3, 5), 7.0)

    theta = np.array([[200.0, 0.5, 0.01, 1e6]])
    assert (OwnModel(Stating()).jacobian_at(theta, CONDITIONS, 0.01) == 7.0).all()


def test_outside_its_reach_a_law_has_a_status_and_no_number() -> None:
    """Sinkages outside (0, r), a load that sinks the wheel, a law without an answer."""
    own = OwnModel(Plate())
    theta = np.array([[200.0, 0.5, 0.01, 1e6], [200.0, 0.5, np.nan, 1e6]])
    values, status = own.forces_at(theta, CONDITIONS, np.array([-0.001, 0.0, 0.01, 0.2]))
    assert status[0].tolist() == [Status.SINKAGE, Status.SINKAGE, Status.OK, Status.SINKAGE]
    assert status[1, 2] == Status.NO_ANSWER
    assert (np.isnan(values).any(axis=2) == (status != Status.OK)).all()
    assert (own.response_at(theta[:1], CONDITIONS, 1e9)[1] == Status.LOAD).all()
    assert own.admits(np.array([[0.0, 0.0, 0.01, 0.0], [0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.01, 51.0]])).tolist() == [
        True, False, False,
    ]  # fmt: skip


def test_laws_that_are_none_are_refused_by_name() -> None:
    """What is missing, doubled or of another shape."""
    with pytest.raises(ValueError, match=r"'forces' of TwoForces must return F_N, F_DP and M_DR \(got 2 values\)"):
        OwnModel(TwoForces()).forces_at(np.array([[200.0, 0.5, 0.01, 1e6]]), CONDITIONS, 0.01)
    with pytest.raises(ValueError, match=r"'lower' of 'k' must be below 'upper' \(got 2 and 1\)"):
        ModelParameter("k", lower=2, upper=1)
    with pytest.raises(ValueError, match=r"must be a word of letters and digits \(got 'k 1'\)"):
        ModelParameter("k 1")
    with pytest.raises(ValueError, match=r"'theta' must have shape \(n, 4\) \(got \(1, 3\)\)"):
        OwnModel(Plate()).forces_at(np.zeros((1, 3)), CONDITIONS, 0.01)


def test_wong_and_reece_are_the_integral_model_at_their_angles() -> None:
    """Without lugs, and slip in the exponent, M1 has the same stresses: at the same θ2 the same forces."""
    wheel, depth, kappa = Wheel(0.157, 0.165), 0.012, 0.3
    rows = Conditions.of(wheel, CONDITIONS.slip)
    front, rear = np.arccos(1 - depth / 0.157), -np.arccos(1 - kappa * depth / 0.157)
    own = np.array([[1.5e6, 0.9, 300.0, 0.55, 0.012, 0.45, 0.1, kappa]])
    same = np.array([[1.5e6, 0.9, 0.0, 300.0, 0.55, 0.012, 0.45, 0.1, rear / front]])
    mine, _ = OwnModel(WongReece()).forces_at(own, rows, depth)
    theirs, _ = M1(shear_start="rim", constant_exponent=True).forces_at(same, rows, depth)
    assert mine == pytest.approx(theirs, rel=2e-7)


def test_wong_and_reece_by_adaptive_quadrature() -> None:
    """Their stresses written out once more, one angle at a time."""
    Ks, n, c, phi, K, a0, a1, kappa = 8.0e5, 1.1, 800.0, 0.6, 0.03, 0.4, 0.15, 0.6
    r, b, z, s = 0.092, 0.107, 0.02, 0.35
    front, rear = np.arccos(1 - z / r), -np.arccos(1 - kappa * z / r)
    middle = (a0 + a1 * s) * front

    def stresses(angle: float) -> tuple[float, float]:
        at = angle if angle > middle else front - (angle - rear) / (middle - rear) * (front - middle)
        normal = Ks * r**n * (np.cos(at) - np.cos(front)) ** n
        travel = r * (front - angle - (1 - s) * (np.sin(front) - np.sin(angle)))
        return normal, (c + normal * np.tan(phi)) * (1 - np.exp(-travel / K))

    def force(part: int) -> float:
        def integrand(angle: float) -> float:
            normal, shear = stresses(angle)
            cos, sin = np.cos(angle), np.sin(angle)
            return float(r * b * (normal * cos + shear * sin, shear * cos - normal * sin, r * shear)[part])

        return float(sum(quad(integrand, *ends, epsabs=1e-10)[0] for ends in ((rear, middle), (middle, front))))

    theta = np.array([[Ks, n, c, phi, K, a0, a1, kappa]])
    mine, _ = OwnModel(WongReece()).forces_at(theta, Conditions.of(Wheel(r, b), np.array([s])), z)
    assert mine[0, 0] == pytest.approx([force(0), force(1), force(2)], rel=2e-7)


def test_bekker_and_janosi_by_their_own_formulas() -> None:
    """Sinkage by Bekker's formula under a load; thrust as the integral of Janosi's shear along the contact."""
    Ks, n, c, phi, K = 8.0e5, 0.9, 500.0, 0.55, 0.015
    wheel, slip, load = Wheel(0.2, 0.1), 0.25, 120.0
    (values,), _ = OwnModel(BekkerJanosi()).response_at(
        np.array([[Ks, n, c, phi, K]]), Conditions.of(wheel, np.array([slip])), np.array([load])
    )
    depth = (3 * load / ((3 - n) * 0.1 * Ks * np.sqrt(0.4))) ** (2 / (2 * n + 1))
    length = 0.2 * np.arccos(1 - depth / 0.2)
    thrust, _ = quad(lambda x: (0.1 * c + load / length * np.tan(phi)) * (1 - np.exp(-slip * x / K)), 0, length)
    resistance, _ = quad(lambda z: 0.1 * Ks * z**n, 0, depth)
    assert values[0] == pytest.approx([depth, thrust - resistance, 0.2 * thrust], rel=1e-8)
