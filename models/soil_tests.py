"""Mean stress of plate-sinkage and annular shear tests, with exact derivatives.

Plates: Bekker's p = (k_c/b + k_φ) z^n, b the plate radius. Either modulus may be negative; only k_c/b + k_φ
> 0 under every plate is physical. Shear: Janosi and Hanamoto's τ = (c + σ tan φ) (1 − exp(−j/K)), the law
of Ding et al. 2015, eq. (9).
"""

from typing import Protocol

import numpy as np

from bayesterra.models.checks import BoolArray, FloatArray


class SoilTestModel(Protocol):
    """Law of a kind of test; soil parameters (n, 3) are SI and in the order of ``parameters``.

    ``path`` is the sinkage or the shear displacement (m,) or (n, m), m; ``level`` the plate radius, m, or the
    normal stress, Pa, (m,).
    """

    parameters: tuple[str, str, str]

    def log_stress(self, x: FloatArray, path: FloatArray, level: FloatArray) -> FloatArray:
        """Log of the mean stress (n, m), Pa, of soil parameters inside their physical range."""

    def slopes(self, x: FloatArray, path: FloatArray, level: FloatArray) -> FloatArray:
        """Derivatives (n, m, 3) of the log stress by the soil parameters."""

    def physical(self, x: FloatArray, levels: FloatArray) -> BoolArray:
        """True (n,) where soil parameters are physical under all plates or stresses ``levels`` (t,)."""


class PlateSinkage:
    """Bekker's law of plates, of k_c, k_φ and n."""

    parameters = ("kc", "kphi", "n")

    def log_stress(self, x: FloatArray, path: FloatArray, level: FloatArray) -> FloatArray:
        """See :class:`SoilTestModel`."""
        kc, kphi, n = _columns(x)
        levels, which = np.unique(level, return_inverse=True)
        return np.asarray(np.log(kc / levels + kphi)[:, which] + n * np.log(path))

    def slopes(self, x: FloatArray, path: FloatArray, level: FloatArray) -> FloatArray:
        """See :class:`SoilTestModel`."""
        kc, kphi, _ = _columns(x)
        modulus = kc / level + kphi
        return _stacked(1.0 / (level * modulus), 1.0 / modulus, np.broadcast_to(np.log(path), modulus.shape))

    def physical(self, x: FloatArray, levels: FloatArray) -> BoolArray:
        """See :class:`SoilTestModel`: K_s is linear in 1/b, so two plates tell for all between them."""
        kc, kphi, _ = _columns(x)
        with np.errstate(over="ignore", invalid="ignore"):  # far proposals overflow, and are turned away
            ends = kc / np.array([levels.min(), levels.max()]) + kphi
        return np.asarray((ends > 0).all(axis=1))


class AnnularShear:
    """Janosi and Hanamoto's law of shear, of c, φ and K."""

    parameters = ("c", "phi", "K")

    def log_stress(self, x: FloatArray, path: FloatArray, level: FloatArray) -> FloatArray:
        """See :class:`SoilTestModel`."""
        c, phi, K = _columns(x)
        mobilised = -np.expm1(-path / K)
        return np.asarray(np.log(c + level * np.tan(phi)) + np.log(mobilised))

    def slopes(self, x: FloatArray, path: FloatArray, level: FloatArray) -> FloatArray:
        """See :class:`SoilTestModel`."""
        c, phi, K = _columns(x)
        strength, ratio = c + level * np.tan(phi), path / K
        return _stacked(1.0 / strength, level / np.cos(phi) ** 2 / strength, -ratio / np.expm1(ratio) / K)

    def physical(self, x: FloatArray, levels: FloatArray) -> BoolArray:
        """See :class:`SoilTestModel`."""
        c, phi, K = x.T
        inside = (c >= 0) & (phi >= 0) & (phi < np.pi / 2) & (K > 0)
        return np.asarray(inside & (c + levels.min() * np.tan(np.where(inside, phi, 0.0)) > 0))


SOIL_TESTS: dict[str, SoilTestModel] = {"plate": PlateSinkage(), "shear": AnnularShear()}
"""Laws by the kind of a test."""


def _columns(x: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    return x[:, 0:1], x[:, 1:2], x[:, 2:3]


def _stacked(*columns: FloatArray) -> FloatArray:
    shape = np.broadcast_shapes(*(column.shape for column in columns))
    return np.stack([np.broadcast_to(column, shape) for column in columns], axis=2)
