"""Priors: a law, a fixed value or a tie for each parameter by name."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.random import Generator
from scipy.special import ndtri

from bayesterra import parameters
from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, check_number
from bayesterra.stats.dependence import SINGULAR, Dependence, GaussianCopula, JoinedDependence, MixtureCopula
from bayesterra.stats.laws import Law


@dataclass(frozen=True)
class Tie:
    """The prior of a parameter that always has the value of another one."""

    to: str

    def __str__(self) -> str:
        return f"tied to {self.to}"


@dataclass(frozen=True)
class Source:
    """An earlier result that a study takes a prior from: its posterior becomes the prior of some parameters.

    Attributes
    ----------
    result : the result's folder, or the result itself.
    take : parameter there by parameter here; None for all of the same name.
    widen : factor, at least 1, by which normal scores spread.
    """

    result: Any
    take: Mapping[str, str] | None = None
    widen: float = 1.0

    def beside(self, study: Path) -> "Source":
        """The same, with a relative folder understood from that of a study file."""
        if not isinstance(self.result, str | Path):
            return self
        return Source(study.parent / self.result, self.take, self.widen)


Entry = Law | float | Tie
"""Prior of one parameter: free, fixed, or tied."""

TAIL = 1e-4
"""Probability beyond either end of the range of a law that has no end there."""


@dataclass(frozen=True)
class Prior:
    """Laws of the free parameters, before the physical cut, and the fixed and tied values.

    The laws are independent but for the dependence of their normal scores, by which every parameter keeps its
    own law: ``correlation``, where these are jointly normal (a Gaussian copula), and ``mixtures``.

    Parameters
    ----------
    entries : a law (free), a number (fixed) or a tie for every soil parameter and every estimated noise, by
        name; ``kc`` and ``kphi`` may stand for ``Ks``, and ``sinkage_offset`` is 0 where it is left out. All
        four coefficients of the load effect, or none.
    width : width (m) of the wheel for which soil arrays hold K_s = k_c/b + k_φ, where these are used.
    correlation : correlations of normal scores by pair, ``"c, phi"``, in the package's order; 0 elsewhere.
    mixtures : mixture copulas by parameters, ``"n0, c, phi"``, of which none correlates with others.
    reference, exponent : sinkage z (m) and exponent n with which the laws of the moduli are those of k_c z^n and
        k_φ z^n, the parts of the pressure there: a modulus in Pa/m^n means nothing without its n, and a law that
        is flat in it prefers large n. At 1 m the laws are those of k_c and k_φ.
    reads : soil parameters that must have an entry, as the model of the wheels reads them; without wheels none.

    Raises
    ------
    StudyError : a soil parameter is missing or doubled, a name is not known, a tie leads nowhere, or the
        correlations contradict each other.
    """

    entries: Mapping[str, Entry]
    width: float = np.nan
    correlation: Mapping[str, float] = field(default_factory=dict)
    mixtures: Mapping[str, MixtureCopula] = field(default_factory=dict)
    reference: float = 1.0
    exponent: str = "n"
    reads: tuple[str, ...] = parameters.SOIL_PARAMETERS

    def __post_init__(self) -> None:
        if not isinstance(self.entries, Mapping):
            raise StudyError(f"a prior needs laws or values by parameter (got {self.entries!r:.60})")
        unknown = [name for name in self.entries if parameters.whole_and_part(name)[0] not in parameters.PARAMETERS]
        missing = [name for name in self._needed if name not in self.entries]
        if unknown or missing:
            raise StudyError(f"priors: unknown {unknown or 'none'}, missing {missing or 'none'}")
        for name, entry in self.entries.items():
            if not isinstance(entry, Law | Tie):
                check_number(name, entry)
        if self.uses_moduli and "Ks" in self.entries:
            raise StudyError("'kc' and 'kphi' stand in place of 'Ks': give either")
        for name in self.ties:
            self.root(name)
        for name in (*parameters.MODULI, self.exponent) if self.stretched else ():
            self._check_scores(f"'reference_sinkage' with '{name}'", [name])
        for pair in self.correlation:
            self._check_scores(f"correlation of '{pair}'", pair.split(", "))
        joined = [name for pair in self.correlation for name in pair.split(", ")]
        for key, mixture in self.mixtures.items():
            names = key.split(", ")
            self._check_scores(f"mixture of '{key}'", names)
            if len(names) != len(mixture.means[0]):
                raise StudyError(
                    f"mixture of '{key}': means and covariances must be of {len(names)} parameters"
                    f" (got {len(mixture.means[0])})"
                )
            twice = [name for name in names if name in joined]
            if twice:
                raise StudyError(
                    f"mixture of '{key}': '{twice[0]}' must not stand in another mixture or in correlations"
                )
            joined += names
        if self.correlation and np.linalg.eigvalsh(self.score_correlation)[0] <= SINGULAR:
            pairs = "; ".join(f"'{pair}' {value:g}" for pair, value in self.correlation.items())
            raise StudyError(f"correlations must be such that all can hold at once (got {pairs})")

    def _check_scores(self, what: str, names: list[str]) -> None:
        for name in names:
            if name not in self.laws:
                raise StudyError(f"{what}: '{name}' must have a law of its own")
            if self.laws[name].crowded:
                share = f"{max(self.laws[name].crowds):.2g}"
                raise StudyError(
                    f"{what}: '{name}' must not have {share} of its probability nearer"
                    " to an end than numbers can tell: cut its law by 'lower' and 'upper'"
                )

    @property
    def _needed(self) -> tuple[str, ...]:
        stiffness = parameters.MODULI if self.uses_moduli else ("Ks",)
        soil = tuple(each for name in self.reads for each in (stiffness if name == "Ks" else (name,)))
        load_effect = any(name in self.entries for name in parameters.LOAD_EFFECT)
        return (*soil, *parameters.LOAD_EFFECT) if load_effect else soil

    @property
    def uses_moduli(self) -> bool:
        """True where K_s follows from k_c and k_φ, and so from the width of each wheel."""
        return any(name in self.entries for name in parameters.MODULI)

    @cached_property
    def laws(self) -> dict[str, Law]:
        """Laws of the free parameters in the package's order."""
        entries = ((name, self.entries[name]) for name in parameters.in_order(self.entries))
        return {name: entry for name, entry in entries if isinstance(entry, Law)}

    @cached_property
    def sources(self) -> dict[tuple[str, ...], str]:
        """Sources of laws, by the free parameters of which one is said."""
        said = {name: law.source for name, law in self.laws.items() if law.source}
        return {tuple(name for name in said if said[name] == source): source for source in dict.fromkeys(said.values())}

    @cached_property
    def fixed(self) -> dict[str, float]:
        """Values of the fixed parameters, and of those that are tied to one of them."""
        roots = ((name, self.entries[self.root(name)]) for name in parameters.in_order(self.entries))
        return {name: float(entry) for name, entry in roots if isinstance(entry, int | float)}

    @cached_property
    def ties(self) -> dict[str, str]:
        """Parameter that each tied one is tied to."""
        return {name: entry.to for name, entry in self.entries.items() if isinstance(entry, Tie)}

    def root(self, name: str) -> str:
        """The free or fixed parameter whose value ``name`` has, itself where it is not tied.

        Raises
        ------
        StudyError : the tie leads to itself, to a parameter without a prior, or to another dimension.
        """
        seen = [name]
        while seen[-1] in self.ties:
            seen.append(self.ties[seen[-1]])
            if seen[-1] in seen[:-1]:
                raise StudyError(f"'{name}' must not be tied to itself ({' = '.join(seen)})")
        if seen[-1] not in self.entries:
            raise StudyError(f"'{seen[-2]}' is tied to '{seen[-1]}', which must have a prior of its own")
        dimensions = [parameters.PARAMETERS[parameter].dimension for parameter in (name, seen[-1])]
        if dimensions[0] != dimensions[1]:
            kinds = " and ".join(f"'{dimension or 'pure number'}'" for dimension in dimensions)
            raise StudyError(f"'{name}' must be tied to a parameter of its own dimension (got {kinds})")
        return seen[-1]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the free parameters, the columns of every parameter array."""
        return tuple(self.laws)

    def column(self, name: str, x: FloatArray) -> FloatArray:
        """Values (n,) of a parameter, free, fixed or tied, of free parameter sets ``x`` (n, d)."""
        root = self.root(name)
        return x[:, self.names.index(root)] if root in self.laws else np.full(len(x), self.fixed[root])

    @property
    def stretched(self) -> bool:
        """True where the laws of the moduli are stated at a sinkage."""
        return self.reference != 1.0

    @property
    def stretches(self) -> FloatArray:
        """Least, middle and greatest factor (3,) of moduli over what their laws are about; see ``TAIL``."""
        law, tail = self.laws[self.exponent], np.array(TAIL)
        low, high = np.where(np.isfinite(law.range), law.range, (law.quantile(tail), law.upper_quantile(tail)))
        return np.sort(self.reference ** -np.array([low, law.median, high]))

    def log_stretch(self, x: FloatArray) -> FloatArray:
        """Log of what each parameter (n, d) is multiplied with to become what its law is about."""
        stretch = np.zeros_like(x)
        if self.stretched:
            moduli = [self.names.index(name) for name in parameters.MODULI]
            stretch[:, moduli] = x[:, [self.names.index(self.exponent)]] * np.log(self.reference)
        return stretch

    def stated(self, x: FloatArray) -> FloatArray:
        """Quantities (n, d) that the laws are about, of parameter sets (n, d)."""
        with np.errstate(over="ignore"):
            return x * np.exp(self.log_stretch(x)) if self.stretched else x

    @cached_property
    def soil_template(self) -> tuple[FloatArray, list[int], list[int]]:
        """A soil array (1, p) of what is fixed, and which of its columns are filled from which of x."""
        roots = {name: self.root(name) for name in parameters.PRIOR_PARAMETERS if name in self.entries}
        free = {name: self.names.index(root) for name, root in roots.items() if root in self.laws}
        return parameters.soil_array(self.fixed), parameters.columns_of(free), list(free.values())

    def soil_values(self, x: FloatArray) -> FloatArray:
        """Soil array (n, p) of free parameter sets ``x`` (n, d); its K_s is that of ``width``."""
        template, into, source = self.soil_template
        soil = np.repeat(template, len(x), axis=0)
        soil[:, into] = x[:, source]
        return self._with_modulus(soil)

    def soil_of(self, values: Mapping[str, float]) -> FloatArray:
        """Soil array (1, p) of values by name, which override what is fixed and free alike."""
        roots = {name: self.root(name) for name in parameters.PRIOR_PARAMETERS if name in self.entries}
        overrides = {name: values.get(name, values.get(root)) for name, root in roots.items()}
        stated = {name: value for name, value in overrides.items() if value is not None}
        return self._with_modulus(parameters.soil_array({**self.fixed, **stated}))

    def _with_modulus(self, soil: FloatArray) -> FloatArray:
        if self.uses_moduli:
            soil[:, parameters.SoilColumns.Ks] = (
                soil[:, parameters.SoilColumns.kc] / self.width + soil[:, parameters.SoilColumns.kphi]
            )
        return soil

    @cached_property
    def score_correlation(self) -> FloatArray:
        """Stated correlations (d, d) of the normal scores of the free parameters, without mixtures."""
        matrix = np.eye(len(self.names))
        for pair, value in self.correlation.items():
            i, j = (self.names.index(name) for name in pair.split(", "))
            matrix[i, j] = matrix[j, i] = value
        return matrix

    @cached_property
    def correlated(self) -> list[int]:
        """Columns of parameters that depend on another one."""
        others = self.score_correlation - np.eye(len(self.names))
        return sorted([*np.flatnonzero(others.any(axis=1)).tolist(), *(i for c, _ in self.mixed for i in c)])

    @cached_property
    def mixed(self) -> list[tuple[list[int], MixtureCopula]]:
        """Columns of every mixture, rising, and its dependence of their scores."""
        mixed = []
        for key, mixture in self.mixtures.items():
            columns = [self.names.index(name) for name in key.split(", ")]
            mixed.append((sorted(columns), mixture.marginal(np.argsort(columns).tolist())))
        return mixed

    def dependence(self, straight: tuple[str, ...] = ()) -> Dependence:
        """Dependence of the scores of the columns in ``correlated``.

        A mixture that holds a parameter of ``straight`` is taken by its correlations alone.
        """
        matrix, bent = self.score_correlation.copy(), []
        for columns, mixture in self.mixed:
            if any(self.names[i] in straight for i in columns):
                matrix[np.ix_(columns, columns)] = mixture.correlation
            else:
                bent.append((tuple(self.correlated.index(i) for i in columns), mixture))
        others = tuple(i for i in range(len(self.correlated)) if all(i not in at for at, _ in bent))
        columns = [self.correlated[i] for i in others]
        gaussian = GaussianCopula(matrix[np.ix_(columns, columns)])
        if not bent:
            return gaussian
        return JoinedDependence(((others, gaussian), *bent) if others else tuple(bent))

    def scores(self, x: FloatArray, columns: list[int] | None = None) -> FloatArray:
        """Normal scores of parameter sets (n, d) under their own laws, of some columns or all."""
        laws = list(self.laws.values())
        chosen, x = range(len(laws)) if columns is None else columns, self.stated(x)
        scores = [laws[i].score(x[:, i]) for i in chosen]
        return np.column_stack(scores) if scores else np.empty((len(x), 0))

    def log_dependence(self, x: FloatArray) -> FloatArray:
        """Log of the joint density over the product of the laws (n,)."""
        if not self.correlated:
            return np.zeros(len(x))
        return self._dependence.log_density(self.scores(x, self.correlated))

    @cached_property
    def _dependence(self) -> Dependence:
        return self.dependence()

    def slope_and_curvature(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Slope (n, d) of :meth:`log_dependence` along the scores (n, d) of all free parameters.

        With it, a curvature (n or 1, d, d) of minus the log joint density of the scores, never negative.
        """
        slope, curvature = GaussianCopula(self.score_correlation).slope_and_curvature(z)
        if self.mixed:
            curvature = np.tile(curvature, (len(z), 1, 1))
        for columns, mixture in self.mixed:
            slope[:, columns], bent = mixture.slope_and_curvature(z[:, columns])
            curvature[:, np.array(columns)[:, None], columns] = bent
        return slope, curvature

    @cached_property
    def _at_sinkage(self) -> "Prior":
        """The prior of what the laws are about."""
        return replace(self, reference=1.0)

    def log_density(self, x: FloatArray) -> FloatArray:
        """Log density (n,) of parameter sets (n, d) under the stated laws, before the physical cut."""
        if self.stretched:
            return np.asarray(self._at_sinkage.log_density(self.stated(x)) + self.log_stretch(x).sum(axis=1))
        columns, low, high, level = self._flat
        flat = x[:, columns]
        total = np.where(((flat >= low) & (flat <= high)).all(axis=1), level, -np.inf)
        for column, law in enumerate(self.laws.values()):
            if column not in columns:
                total += law.log_density(x[:, column])
        return total + self.log_dependence(x) if self.correlated else total

    @cached_property
    def _flat(self) -> tuple[list[int], FloatArray, FloatArray, float]:
        """Columns of the flat laws, their lowest and highest values, and their joint log density."""
        laws = {column: law for column, law in enumerate(self.laws.values()) if law.dist == "uniform"}
        ends = np.array([law.range for law in laws.values()]).reshape(-1, 2)
        return list(laws), ends[:, 0], ends[:, 1], -float(np.log(ends[:, 1] - ends[:, 0]).sum())

    def sample(self, n: int, rng: Generator) -> FloatArray:
        """Draw parameter sets (n, d) from the stated laws, before the physical cut."""
        return self.quantile(rng.random((n, len(self.names))))

    def quantile(self, q: FloatArray) -> FloatArray:
        """Parameter sets (n, d) at probabilities ``q`` (n, d): independent uniform ones give draws.

        A column is the quantile of its own law, or, where it correlates, of its law given columns before it.
        """
        if not self.names:
            return np.empty((len(q), 0))
        x = np.column_stack([law.quantile(q[:, i]) for i, law in enumerate(self.laws.values())])
        if self.correlated:
            laws = list(self.laws.values())
            z = self._dependence.completed(np.empty((len(q), 0)), ndtri(q[:, self.correlated]))
            for i, column in zip(self.correlated, z.T, strict=True):
                x[:, i] = laws[i].at_score(column)
        return x * np.exp(-self.log_stretch(x)) if self.stretched else x
