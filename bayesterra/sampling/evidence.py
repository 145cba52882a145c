"""Importance sampling from proposals fitted to draws, log evidence by it, and both once more by nested sampling.

The only module that imports dynesty, an optional extra. Nested samplers err on ridges without a warning, so that two
settings are run: where they differ from each other they are no judge, and it is not said who is wrong.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from typing import Any, Generic, TypeVar

import numpy as np
import pandas as pd
from numpy.random import Generator, SeedSequence, default_rng

from bayesterra.arrays import FloatArray, IntArray, spaced
from bayesterra.errors import StudyError
from bayesterra.likelihood.joint import JointPosterior, Whole
from bayesterra.likelihood.posterior import INSIDE, REASONS, Posterior, PriorDraws
from bayesterra.sampling.adaptation import Adaptation, AdaptationOptions, Densities, adapt, refine
from bayesterra.sampling.coordinates import Coordinates, coordinates
from bayesterra.sampling.sampler import Target
from bayesterra.stats import mixture as mixtures
from bayesterra.stats.diagnostics import effective_size
from bayesterra.stats.transport import fit_proposal

COMPONENTS = 12
FITTED = 4096
"""Draws, at most, that a proposal is fitted to."""
REFINEMENT = AdaptationOptions(particles=1024, components=COMPONENTS, refinements=(4, 4), more=(), shores=12)


@dataclass(frozen=True)
class Proposed:
    """Parameter sets inside the range of the prior, drawn from a proposal."""

    u: FloatArray  # sampling coordinates (n, d)
    x: FloatArray  # the same in physical units (n, d), SI and radians
    log_base: FloatArray  # log prior over proposal (n,); with a log likelihood added, log importance weights
    drawn: int  # number of sets drawn, those outside the prior's range included

    def take(self, chosen: IntArray) -> "Proposed":
        """Those of the sets, also repeatedly."""
        return Proposed(self.u[chosen], self.x[chosen], self.log_base[chosen], self.drawn)


W = TypeVar("W", Posterior, JointPosterior)


@dataclass(frozen=True)
class PosteriorProposal(Generic[W]):
    """A posterior, its sampling coordinates, and draws of it in these (n, d)."""

    posterior: W
    coordinates: Coordinates
    u: FloatArray

    @classmethod
    def of(cls, posterior: W, draws: FloatArray) -> "PosteriorProposal[W]":
        """Around posterior draws (n, d), of which ``FITTED`` at most are used."""
        chosen = coordinates(posterior)
        return cls(posterior, chosen, chosen.from_physical(spaced(draws, FITTED)))

    def mixture(self, rng: Generator, widening: float = 1.0) -> mixtures.StudentMixture:
        """A law fitted to the draws, every component stretched by ``widening``."""
        fitted = mixtures.fit_mixture(self.u, np.ones(len(self.u)), COMPONENTS, rng)
        return replace(fitted, factors=widening * fitted.factors)

    def shifted(self, centre: FloatArray) -> mixtures.StudentMixture:
        """A law as wide as the draws around another centre (d,)."""
        covariance = np.atleast_2d(np.cov(self.u.T))
        steadied = covariance + 1e-9 * np.diag(np.diagonal(covariance))
        factor: FloatArray = np.asarray(np.linalg.cholesky(steadied), dtype=np.float64)
        return mixtures.StudentMixture(np.ones(1), centre[None], factor[None], 4.0)

    def from_prior(self, densities: Densities, rng: Generator) -> mixtures.ProposalLaw:
        """A proposal for another target over the same parameters, found all the way from the prior."""
        plan = AdaptationOptions(shores=24, more=(16,))  # weights see to the rest
        start = self.coordinates.from_physical(self.posterior.cut_prior(plan.particles, rng))
        return adapt(densities, start, plan, rng).proposal

    def propose(self, mixture: mixtures.ProposalLaw, n: int, rng: Generator) -> Proposed:
        """Draw ``n`` sets from a proposal and keep those inside the prior's range."""
        u = mixture.sample(n, rng)
        x, log_jacobian = self.coordinates.to_physical(u)
        log_prior = self.posterior.log_before(x)
        inside = np.flatnonzero(np.isfinite(log_prior) & np.isfinite(log_jacobian))
        base = log_prior[inside] + log_jacobian[inside] - mixture.log_density(u[inside])
        return Proposed(u[inside], x[inside], base, n)


def refined(start: FloatArray, densities: Densities, rng: Generator) -> mixtures.ProposalLaw:
    """A proposal for the target of ``densities`` that starts from points (n, d) near it."""
    widths, plan = start.std(axis=0), REFINEMENT
    first = fit_proposal(start, np.ones(len(start)), widths, plan.components, plan.defence, rng)
    return refine(first, start, widths, densities, plan, rng)[0]


@dataclass(frozen=True)
class Pair:
    """Two proposals in equal shares: where the one is thin, the other may not be."""

    first: mixtures.ProposalLaw
    second: mixtures.ProposalLaw

    def sample(self, n: int, random: mixtures.RandomSource) -> FloatArray:
        """Draw n points (n, d)."""
        return np.concatenate([self.first.sample(n // 2, random), self.second.sample(n - n // 2, random)])

    def log_density(self, u: FloatArray) -> FloatArray:
        """Log density (n,) at points (n, d)."""
        return np.asarray(np.logaddexp(self.first.log_density(u), self.second.log_density(u)) - np.log(2.0))


EVEN, ENOUGH = 0.5, 400.0
"""Pareto k̂ and effective number of weights with which draws stand for another posterior's quantiles."""
REDRAWN = 4000


@dataclass(frozen=True)
class Redrawn:
    """Draws of another posterior over the same parameters."""

    x: FloatArray  # draws (n, d), SI and radians
    k_hat: float  # Pareto k̂ of the weights that lead there
    refitted: bool  # whether these would not do, and a proposal of its own was fitted
    reliable: bool  # False where that one's weights are too uneven, too


def redrawn(near: PosteriorProposal[Posterior], other: Posterior, rng: Generator) -> Redrawn:
    """Draws of a posterior that differs in its likelihood, by weights or by a proposal of its own."""
    x, _ = near.coordinates.to_physical(near.u)
    ratio = other.log_prior_and_likelihood(x)[1] - near.posterior.log_prior_and_likelihood(x)[1]
    finite = np.isfinite(ratio)
    smoothed, k_hat = mixtures.pareto_smoothed(ratio[finite])
    weights = np.exp(smoothed)
    if k_hat <= EVEN and mixtures.effective_number(weights) >= ENOUGH:
        return Redrawn(x[finite][mixtures.systematic(weights, REDRAWN, rng)], k_hat, False, True)
    densities = Target(other, near.coordinates).densities
    start = near.u[finite][mixtures.systematic(weights, REFINEMENT.particles, rng)]
    law = Pair(refined(start, densities, rng), near.mixture(rng))
    for n in (2 * REDRAWN, 8 * REDRAWN):
        u = law.sample(n, rng)
        prior, likelihood = densities(u)
        log_weights = np.where(prior > -np.inf, prior + likelihood, -np.inf) - law.log_density(u)
        u, log_weights = u[log_weights > -np.inf], log_weights[log_weights > -np.inf]
        smoothed, own = mixtures.pareto_smoothed(log_weights)
        if own < mixtures.pareto_limit(n):
            break
    chosen = u[mixtures.systematic(np.exp(smoothed), REDRAWN, rng)]
    return Redrawn(near.coordinates.to_physical(chosen)[0], k_hat, True, own < mixtures.pareto_limit(n))


DRAWS = 16384
SPREAD = 0.3
"""Root mean square distance of the ensembles' own log evidences from the pooled one, above which it cannot be
relied on. Proposals that cover their posterior agree to some hundredths."""


@dataclass(frozen=True)
class Evidence:
    """Log of prior density times likelihood, integrated over all parameters.

    Attributes
    ----------
    log_z : log evidence; the prior is the stated one, cut to the physical support and not renormalised.
    error : its Monte Carlo standard error, with what the ensembles' own values say of it.
    efficiency : effective share of the draws.
    k_hat : Pareto shape of the greatest weights; above ``limit`` the error cannot be relied on.
    limit : largest reliable k̂ for this number of draws.
    draws : importance draws.
    spread : root mean square distance of the ensembles' own values from ``log_z``, see :meth:`beside`; 0
        where they are not known.
    """

    log_z: float
    error: float
    efficiency: float
    k_hat: float
    limit: float
    draws: int
    spread: float = 0.0

    @property
    def reliable(self) -> bool:
        """True where the weights have a tail light enough for the error to hold, and the ensembles agree."""
        return self.k_hat <= self.limit and self.spread <= SPREAD

    def beside(self, own: Sequence[float]) -> "Evidence":
        """The same with the log evidences that every ensemble found alone, from draws of its own proposal.

        Where all proposals miss the same part of a posterior, draws of theirs cannot show it: neither the
        spread of their weights nor the tail. Each proposal alone misses more, though, and each another
        share, so that what they have apart from the pooled value, as of so many estimates, joins the error.
        """
        finite = np.array([value for value in own if np.isfinite(value)])
        if not len(finite):
            return self
        spread = float(np.sqrt(np.mean((finite - self.log_z) ** 2)))
        error = float(np.hypot(self.error, spread / np.sqrt(len(finite))))
        return replace(self, error=error, spread=spread)


def evidence(
    densities: Densities, proposals: Sequence[mixtures.ProposalLaw], rng: Generator, draws: int = DRAWS
) -> Evidence:
    """Weigh fresh draws, as many from each proposal, against the mixture of them all.

    No fit has seen these draws. A part of the posterior that one proposal misses is covered by the others
    (the balance heuristic of Veach and Guibas 1995).
    """
    each = -(-draws // len(proposals))
    u = np.concatenate([proposal.sample(each, rng) for proposal in proposals])
    pooled = mixtures.log_mean([proposal.log_density(u) for proposal in proposals], axis=0)
    log_prior, log_likelihood = densities(u)
    log_weights = np.where(np.isneginf(log_prior), -np.inf, log_prior + log_likelihood) - pooled
    return summed(log_weights.reshape(len(proposals), each))


def ensembles_evidence(densities: Densities, adaptations: Sequence[Adaptation], rng: Generator) -> Evidence:
    """Evidence from the proposals of all ensembles, beside what each of them found alone."""
    pooled = evidence(densities, [adaptation.proposal for adaptation in adaptations], rng)
    return pooled.beside([adaptation.log_evidence for adaptation in adaptations])


def summed(log_weights: FloatArray) -> Evidence:
    """Evidence of log weights (proposals, draws); draws of one proposal are a stratum."""
    top, weights = log_weights.max(), mixtures.relative(log_weights)
    mean, (strata, each) = weights.mean(), weights.shape
    error = np.sqrt(weights.var(axis=1, ddof=1).sum() / each) / strata
    k_hat = mixtures.pareto_smoothed(log_weights[np.isfinite(log_weights)])[1]
    return Evidence(
        log_z=float(top + np.log(mean)), error=float(error / mean),
        efficiency=mixtures.effective_number(weights) / weights.size, k_hat=k_hat,
        limit=mixtures.pareto_limit(weights.size), draws=weights.size,
    )  # fmt: skip


def of_evidence(value: Evidence, prior: PriorDraws) -> dict[str, Any]:
    """Log evidence under the stated prior, and the log share of that prior which physics leaves."""
    share = prior.shares[REASONS[INSIDE]]
    error = np.sqrt((1.0 - share) / (share * prior.tried))
    return {**asdict(value), "reliable": value.reliable, "log_share": np.log(share), "log_share_error": error}


LIVE = (500, 1500)
"""Live points of the two settings."""
QUANTILES = (0.05, 0.5, 0.95)
APART = 4.0
"""Standard errors from which two samplers disagree."""

MANY = 6
"""Parameters from which nested sampling walks at random in place of drawing uniformly in ellipsoids."""


@dataclass(frozen=True)
class Weighted:
    """Weighted draws and log evidence of one sampler.

    Attributes
    ----------
    name : what a reader calls it.
    x : parameter sets (n, d).
    weights : (n,), summing to one.
    sizes : effective draws behind the mean and the share below every one of ``QUANTILES``, per parameter
        (d, statistics).
    log_z, error : log evidence under the stated prior; NaN where it is not known.
    """

    name: str
    x: FloatArray
    weights: FloatArray
    sizes: FloatArray
    log_z: float
    error: float

    @classmethod
    def independent(cls, name: str, x: FloatArray, weights: FloatArray, log_z: float, error: float) -> "Weighted":
        """Independent draws with weights; their effective number is Kish's."""
        size = mixtures.effective_number(weights)
        return cls(name, x, weights, np.full((x.shape[1], 1 + len(QUANTILES)), size), log_z, error)

    @classmethod
    def of_ensembles(cls, name: str, chains: FloatArray, evidence: Evidence | None) -> "Weighted":
        """Draws of ensembles (ensembles, steps, walkers, d), which depend on each other.

        Every statistic has the effective size that the diagnosis of the sampling would give it.
        """
        flat = chains.reshape(-1, chains.shape[-1])
        sizes = np.array([_sizes(chains[..., i]) for i in range(chains.shape[-1])])
        log_z, error = (evidence.log_z, evidence.error) if evidence else (np.nan, np.nan)
        return cls(name, flat, np.full(len(flat), 1 / len(flat)), sizes, log_z, error)


def _sizes(chains: FloatArray) -> list[float]:
    """Effective draws behind the mean and the shares below quantiles of a parameter's chains."""
    shares = [(chains <= value).astype(float) for value in np.quantile(chains, QUANTILES)]
    return [max(1.0, min(effective_size(part), chains.size)) for part in (chains, *shares)]


@dataclass(frozen=True)
class CrossCheck:
    """Statistics of several samplers side by side.

    Attributes
    ----------
    table : one row per pair of samplers and statistic: ``one, other, parameter, statistic, z``; z is their
        difference in standard errors.
    samplers : names, ours first.
    """

    table: pd.DataFrame
    samplers: tuple[str, ...]

    @property
    def verdict(self) -> str:
        """``agree``, ``disagree``, or ``nested sampling disagrees with itself``."""
        apart = self.table["z"].abs() > APART
        ours = (self.table["one"] == self.samplers[0]) | (self.table["other"] == self.samplers[0])
        if (apart & ~ours).any():
            return "nested sampling disagrees with itself"
        return "disagree" if apart.any() else "agree"

    @property
    def worst(self) -> str:
        """The statistic that differs most, in words."""
        row = self.table.iloc[int(self.table["z"].abs().argmax())]
        where = f"{row['statistic']} of {row['parameter']}" if row["parameter"] else row["statistic"]
        return f"{where}: {abs(row['z']):.1f} errors between {row['one']} and {row['other']}"

    def record(self) -> dict[str, Any]:
        """Everything, for ``run.json``."""
        return {
            "verdict": self.verdict,
            "worst": self.worst,
            "threshold": APART,
            "samplers": list(self.samplers),
            "table": self.table.to_dict("records"),
        }


def compare(samplers: tuple[Weighted, ...], names: tuple[str, ...]) -> CrossCheck:
    """Set every pair of samplers side by side."""
    rows = []
    for k, this in enumerate(samplers):
        for other in samplers[k + 1 :]:
            z = {("", "log evidence"): float((other.log_z - this.log_z) / np.hypot(this.error, other.error))}
            z = {what: value for what, value in z.items() if not np.isnan(value)}
            for i, name in enumerate(names):
                z |= {(name, what): value for what, value in _differences(this, other, i).items()}
            pair = {"one": this.name, "other": other.name}
            rows += [{**pair, "parameter": p, "statistic": what, "z": v} for (p, what), v in z.items()]
    return CrossCheck(pd.DataFrame(rows), tuple(sampler.name for sampler in samplers))


def _differences(this: Weighted, other: Weighted, i: int) -> dict[str, float]:
    """Differences of a parameter's mean and of the probability below quantiles, in standard errors."""
    (m, sd), (n, other_sd) = _moments(this, i), _moments(other, i)
    errors = 1 / this.sizes[i], 1 / other.sizes[i]
    differences = {"mean": (n - m) / np.hypot(sd * np.sqrt(errors[0][0]), other_sd * np.sqrt(errors[1][0]))}
    order = np.argsort(this.x[:, i])
    steps = np.cumsum(this.weights[order])
    for q, variance in zip(QUANTILES, (errors[0] + errors[1])[1:], strict=True):
        at = min(int(np.searchsorted(steps, q)), len(order) - 1)
        value = float(this.x[order[at], i])
        error = np.sqrt(q * (1 - q) * variance)
        differences[f"{100 * q:.0f} % quantile"] = (other.weights[other.x[:, i] <= value].sum() - q) / error
    return {name: float(value) for name, value in differences.items()}


def _moments(sampler: Weighted, i: int) -> tuple[float, float]:
    mean = float(sampler.weights @ sampler.x[:, i])
    return mean, float(np.sqrt(sampler.weights @ (sampler.x[:, i] - mean) ** 2))


def check_installed() -> None:
    """Raise a StudyError where nested sampling is not installed."""
    if find_spec("dynesty") is None:
        raise StudyError("'--crosscheck' needs dynesty: pip install 'bayesterra[crosscheck]'")


def against_nested(
    posterior: Whole,
    ours: Weighted,
    seed: SeedSequence,
    live: tuple[int, ...] = LIVE,
    report: Callable[[str], None] = lambda stage: None,
) -> CrossCheck:
    """Sample a posterior by nested sampling at every number of live points and compare with our draws.

    StudyError where dynesty is not installed.
    """
    samplers = [ours]
    for points, stream in zip(live, seed.spawn(len(live)), strict=True):
        report(f"nested sampling, {points} live points")
        samplers.append(nested(posterior, points, stream))
    return compare(tuple(samplers), posterior.names)


def nested(posterior: Whole, live: int, seed: SeedSequence) -> Weighted:
    """Static nested sampling from the unit cube of the stated prior, by dynesty."""
    check_installed()
    from dynesty import NestedSampler

    d = len(posterior.names)
    moves = "auto" if d < MANY else "rwalk"  # uniform draws do not come to an end in eight dimensions

    def physical(cube: FloatArray) -> FloatArray:
        return np.asarray(posterior.prior.quantile(cube[None])[0])

    def log_likelihood(x: FloatArray) -> float:
        return float(posterior.log_prior_and_likelihood(x[None])[1][0])

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its remarks on progress and plateaus
        sampler = NestedSampler(log_likelihood, physical, d, nlive=live, rstate=default_rng(seed), sample=moves)
        sampler.run_nested(print_progress=False, dlogz=0.1)
        results = sampler.results
    weights = np.asarray(results.importance_weights())
    weights /= weights.sum()
    return Weighted.independent(
        f"nested ({live})", results.samples, weights, float(results.logz[-1]), float(results.logzerr[-1])
    )
