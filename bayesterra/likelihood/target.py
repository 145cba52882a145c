"""Minus the log density of a study on a chart of its parameters, as an optimiser wants it.

The curvature is Fisher's information of the readings (for Gaussian noise the Gauss–Newton matrix), from the
models' exact derivatives, and so is the gradient. Only a latent load has none: it is a nuisance to each row,
projected out of its information, and the gradient is taken by differences.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from bayesterra.arrays import BoolArray, FloatArray
from bayesterra.likelihood.posterior import Posterior
from bayesterra.likelihood.sensitivities import score_and_information
from bayesterra.models import RANGES
from bayesterra.parameters import MODULI, NOISE_PREFIX, TEST_SIZES, whole_and_part
from bayesterra.stats.laws import Law
from bayesterra.stats.optimiser import Local
from bayesterra.study.priors import TAIL

LATENT_STEP = 0.03
"""Step of differences, in standard deviations; the latent likelihood is known to 1e-3 only."""
ENOUGH, LATENT_ENOUGH, FINEST = 2e-6, 5e-4, 1e-11
"""Changes of the log density that are worth a step; the second is what a latent likelihood resolves, the last
what a mode is worth."""
PULL = 3e-4
"""Curvature, per squared range, of the pull towards an anchor."""
PRIOR_STEP = 1e-4
"""Step of differences of the log prior, as a share of the range."""


@dataclass(frozen=True)
class Target:
    """Minus log likelihood, or with the log prior minus log posterior density in physical parameters.

    A faint pull towards ``anchor`` (d,), scaled, decides between points that are as good as each other: along
    directions without any information nothing moves that need not. Without an anchor (None) there is no pull
    and the least change is worth a step, as a mode wants it.
    """

    posterior: Posterior
    chart: "Chart"
    with_prior: bool
    anchor: FloatArray | None

    @property
    def rows(self) -> FloatArray:
        """The chart's inequalities (k, d)."""
        return self.chart.rows

    def slack(self, y: FloatArray) -> FloatArray:
        """Slack of scaled parameters (n, d) inside each of them, (n, k)."""
        return self.chart.slack(y)

    def value(self, y: FloatArray) -> FloatArray:
        """Values (n,) at scaled parameters (n, d) with the pull, +inf outside the support."""
        return np.asarray(-self.log_density(y) + 0.5 * PULL * (self._away(y) ** 2).sum(axis=1))

    def _away(self, y: FloatArray) -> FloatArray:
        """Way (n, d) from the anchor; 0 without one."""
        return np.zeros_like(y) if self.anchor is None else y - self.anchor

    def log_density(self, y: FloatArray) -> FloatArray:
        """Log likelihood or log posterior density (n,), without the pull."""
        prior, likelihood = self.posterior.log_prior_and_likelihood(self.chart.to_physical(y))
        return np.asarray(likelihood + np.where(np.isfinite(prior), prior, 0.0) * self.with_prior)

    def local(self, y: FloatArray) -> Local:
        """Quadratic models at scaled parameters (n, d) inside the support."""
        x = self.chart.to_physical(y)
        score, information = (np.nan_to_num(values) for values in score_and_information(self.posterior, x))
        stretch = self.chart.stretch(x)
        information = information * stretch[:, :, None] * stretch[:, None, :]
        if self.latent:
            sizes = LATENT_STEP / np.sqrt(np.einsum("nii->ni", information) + 1.0)
            slope = self._differences(y, sizes)
        else:
            slope = -score * stretch
        if self.with_prior:
            first, second = self._stretched_prior(y) if self.posterior.prior.stretched else self._prior(y)
            slope = slope - first
            if self.posterior.prior.correlated:
                bent, joint = self._dependence(y)
                slope, information = slope - bent, information + joint
                second[:, self.posterior.prior.correlated] = 0.0
            information = information + np.maximum(-second, 0.0)[:, :, None] * np.eye(y.shape[1])
        slope = slope + PULL * self._away(y)
        return Local(slope, information + PULL * np.eye(y.shape[1]))

    def _differences(self, y: FloatArray, sizes: FloatArray) -> FloatArray:
        """Slope (n, d) of minus the log likelihood by central differences, one-sided at an edge."""
        n, d = y.shape
        offsets = sizes[:, :, None] * np.eye(d)
        shifted = np.stack([y[:, None] + offsets, y[:, None] - offsets])
        inside = (self.chart.slack(shifted.reshape(-1, d)) >= 0).all(axis=1).reshape(2, n, d)
        level = np.full((2, n, d), np.inf)
        likelihood = replace(self, with_prior=False)
        level[inside] = -likelihood.log_density(shifted[inside])
        centre = -likelihood.log_density(y)[:, None]
        usable = np.isfinite(level)
        ahead, behind = np.where(usable, level, centre)
        runs = np.maximum(usable.sum(axis=0), 1) * sizes
        return np.asarray((ahead - behind) / runs)

    @property
    def digits(self) -> float:
        """Change of the value that is worth a step."""
        if self.anchor is None:
            return FINEST
        return LATENT_ENOUGH if self.latent else ENOUGH

    @property
    def latent(self) -> bool:
        """True where loads are integrated out, which takes long."""
        return self.posterior.likelihood.load_range is not None

    @cached_property
    def _shaped(self) -> list[int]:
        """Columns whose log prior is not flat."""
        return [i for i, law in enumerate(self.posterior.prior.laws.values()) if law.dist != "uniform"]

    def _prior(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """First and second derivatives (n, d) of each parameter's log prior by its scaled value."""
        first, second = np.zeros_like(y), np.zeros_like(y)
        laws = list(self.posterior.prior.laws.values())
        middle = np.clip(y, PRIOR_STEP, 1 - PRIOR_STEP)
        points = [self.chart.to_physical(middle + step) for step in (-PRIOR_STEP, 0.0, PRIOR_STEP)]
        for i in self._shaped:
            below, here, above = (laws[i].log_density(x[:, i]) for x in points)
            first[:, i] = (above - below) / (2 * PRIOR_STEP)
            second[:, i] = (above - 2 * here + below) / PRIOR_STEP**2
        first += second * (y - middle)
        return np.nan_to_num(first), np.nan_to_num(second)

    def _stretched_prior(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The same where laws of moduli are stated at a sinkage, so that the prior of n is in them."""
        first, second = np.zeros_like(y), np.zeros_like(y)
        middle, density = np.clip(y, PRIOR_STEP, 1 - PRIOR_STEP), self.posterior.prior.log_density
        here = density(self.chart.to_physical(middle))
        with np.errstate(invalid="ignore"):  # at the edge of a law there is no slope
            for i, step in enumerate(PRIOR_STEP * np.eye(y.shape[1])):
                above, below = (density(self.chart.to_physical(middle + sign * step)) for sign in (1, -1))
                first[:, i] = (above - below) / (2 * PRIOR_STEP)
                second[:, i] = (above - 2 * here + below) / PRIOR_STEP**2
        lost = ~np.isfinite(first) | ~np.isfinite(second)
        return np.where(lost, 0.0, first), np.where(lost, 0.0, second)

    def _dependence(self, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Slope (n, d) that dependence adds to the log prior's, and the whole curvature of the scores (n, d, d)."""
        prior, d = self.posterior.prior, y.shape[1]
        stretch = np.zeros((len(y), d))
        middle = np.clip(y, PRIOR_STEP, 1 - PRIOR_STEP)
        below, above = (prior.scores(self.chart.to_physical(middle + h)) for h in (-PRIOR_STEP, PRIOR_STEP))
        stretch[:, prior.correlated] = ((above - below) / (2 * PRIOR_STEP))[:, prior.correlated]
        slope, curvature = prior.slope_and_curvature(prior.scores(self.chart.to_physical(y)))
        return np.nan_to_num(stretch * slope), np.nan_to_num(stretch[:, :, None] * curvature * stretch[:, None, :])


MARGIN = 1e-9
"""Distance kept from the open limits θm/θ1 = c3 and 1 and N = 0, and φ = 90°."""
SMALLEST = 1e-4
"""Lowest value, as a share of the highest, of a positive parameter whose range begins at 0."""


@dataclass(frozen=True)
class Chart:
    """Scaled parameters y of parameters x: each prior's range is [0, 1], on a log scale for some.

    The support of the prior is ``rows @ y <= limits``; limits that are not linear (a load that no sinkage
    carries) show as log likelihoods of −inf.
    """

    logs: BoolArray  # parameters on a log scale: moduli K_s and K, noise (d,)
    ends: FloatArray  # lower and upper end of each range (d, 2)
    low: FloatArray  # lower end of each range, on its scale (d,)
    width: FloatArray  # of each range, likewise
    rows: FloatArray  # the inequalities (k, d), the box among them
    limits: FloatArray  # of these (k,)

    def to_physical(self, y: FloatArray) -> FloatArray:
        """Parameters x (n, d) of scaled ones (n, d); never beyond the range by a rounding error."""
        scaled = np.clip(self.low + self.width * y, self.low, self.low + self.width)
        x = np.where(self.logs, np.exp(np.where(self.logs, scaled, 0.0)), scaled)
        return np.clip(x, self.ends[:, 0], self.ends[:, 1])

    def from_physical(self, x: FloatArray) -> FloatArray:
        """Scaled parameters (n, d) of parameters x (n, d)."""
        scaled = np.where(self.logs, np.log(np.where(self.logs, np.maximum(x, 1e-300), 1.0)), x)
        return np.asarray((scaled - self.low) / self.width)

    def stretch(self, x: FloatArray) -> FloatArray:
        """Derivatives dx/dy (n, d) at parameters x (n, d)."""
        return np.where(self.logs, x, 1.0) * self.width

    def slack(self, y: FloatArray) -> FloatArray:
        """Slack of scaled parameters (n, d) inside each inequality, (n, k)."""
        return np.asarray(self.limits - y @ self.rows.T)

    @cached_property
    def span(self) -> FloatArray:
        """Lowest and highest scaled value of each parameter that some others go with, (d, 2)."""
        from scipy.optimize import linprog

        unit = np.eye(len(self.low))
        free: list[tuple[None, None]] = [(None, None)] * len(unit)
        extremes = [
            [linprog(sign * axis, self.rows, self.limits, bounds=free).fun for sign in (1, -1)] for axis in unit
        ]
        ends = np.array([(0.0, -1.0) if None in pair else pair for pair in extremes], dtype=np.float64)
        return np.asarray(np.clip(ends * np.array([1.0, -1.0]), 0.0, 1.0))


def chart(posterior: Posterior, holding: FloatArray | None = None) -> Chart:
    """The chart of a posterior's free parameters; it reaches as far as the points ``holding`` (n, d) do."""
    prior, names = posterior.prior, posterior.names
    ends = np.array([_ends(name, law, posterior) for name, law in prior.laws.items()]).reshape(-1, 2)
    positive = [whole_and_part(n)[0] in ("Ks", "K") or n.startswith((NOISE_PREFIX, *TEST_SIZES)) for n in names]
    logs = np.array(positive, dtype=np.bool_) & (ends[:, 1] > 0)
    ends[:, 0] = np.where(logs, np.maximum(ends[:, 0], SMALLEST * ends[:, 1]), ends[:, 0])
    if holding is not None:
        ends = np.column_stack(
            [np.minimum(ends[:, 0], holding.min(axis=0)), np.maximum(ends[:, 1], holding.max(axis=0))]
        )
    scaled = np.where(logs[:, None], np.log(np.where(logs[:, None], ends, 1.0)), ends)
    low, width = scaled[:, 0], scaled[:, 1] - scaled[:, 0]
    identity = np.eye(len(names))
    rows, limits = [*identity, *-identity], [1.0] * len(names) + [0.0] * len(names)
    for weights, lowest in _physical(posterior):
        roots = {name: prior.root(name) for name in weights}
        offset = sum(weights[name] * prior.fixed.get(root, 0.0) for name, root in roots.items())
        row = np.zeros(len(names))
        for name, root in roots.items():
            if root in names:
                row[names.index(root)] += weights[name]
        if row.any():
            rows.append(-row * width)
            limits.append(float(row @ low) + offset - lowest)
    sizes = np.abs(np.array(rows)).max(axis=1)
    return Chart(logs, ends, low, width, np.array(rows) / sizes[:, None], np.array(limits) / sizes)


def _ends(name: str, law: Law, posterior: Posterior) -> tuple[float, float]:
    """Ends of the range of a law, inside the physical range of the parameter."""
    prior, (low, high) = posterior.prior, law.range
    if not np.isfinite(low):
        low = float(law.quantile(np.array(TAIL)))
    if not np.isfinite(high):
        high = float(law.upper_quantile(np.array(TAIL)))
    base = whole_and_part(name)[0]
    physical = {**RANGES, **posterior.likelihood.forward.model.ranges}.get(base, (-np.inf, np.inf))
    if base not in ("Ks", "K"):  # these are taken by their logarithms
        low, high = max(low, physical[0]), min(high, physical[1])
    if prior.stretched and name in MODULI:  # over the range of n
        return float((low * prior.stretches).min()), float((high * prior.stretches).max())
    return (low, min(high, np.pi / 2 - MARGIN)) if base == "phi" else (low, high)


EDGE = 1e-6
"""Distance from an edge, as a share of the range, within which a point lies on it."""


def edges(posterior: Posterior, x: FloatArray) -> dict[str, str]:
    """Edges of the support that a parameter set (d,) lies on, by parameter: bounds of its prior, and of physics.

    What is bounded by physics is a sum of parameters; ``c1 + 0.1 c2 = 0`` names it.
    """
    values = {**posterior.prior.fixed, **dict(zip(posterior.names, map(float, x), strict=True))}
    found = {}
    for name, law in posterior.prior.laws.items():
        for end, word in zip(_ends(name, law, posterior), ("lower bound", "upper bound"), strict=True):
            if end in law.range and abs(values[name] - end) < EDGE * float(np.ptp(_ends(name, law, posterior))):
                found[name] = word
    for weights, lowest in _physical(posterior):
        roots = {name: posterior.prior.root(name) for name in weights}
        free = {name: weight for name, weight in weights.items() if roots[name] in posterior.names}
        if free and sum(weight * values.get(roots[name], 0.0) for name, weight in weights.items()) - lowest < EDGE:
            fixed = sum(weights[name] * values.get(roots[name], 0.0) for name in weights if name not in free)
            sign = 1.0 if next(iter(free.values())) > 0 else -1.0
            terms = " + ".join(name if sign * w == 1.0 else f"{sign * w:.3g} {name}" for name, w in free.items())
            words = f"{terms} = {round(sign * (lowest - fixed), 6) + 0.0:.3g}".replace("+ -", "- ")
            found |= dict.fromkeys(map(roots.__getitem__, free), words)
    return found


def _physical(posterior: Posterior) -> Iterator[tuple[Mapping[str, float], float]]:
    """Weighted sums of soil parameters, and what each must not be below."""
    for experiment in posterior.experiments:
        if experiment.readings.kind == "plate":
            for radius in np.unique(experiment.readings.levels)[[0, -1]]:
                yield dict(zip(experiment.test.soil, (1.0 / radius, 1.0), strict=False)), 0.0
    if not posterior.driven:
        return
    forward = posterior.likelihood.forward
    yield from ((weights, least + MARGIN) for weights, least in forward.model.limits(forward.conditions))
    if posterior.prior.uses_moduli:
        for width in np.unique(forward.conditions.width):
            yield dict(zip(MODULI, (1.0 / width, 1.0), strict=True)), 1.0
