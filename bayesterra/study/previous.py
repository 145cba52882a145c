"""Priors from an earlier result: its posterior draws as laws of single parameters and their correlations.

Every parameter keeps the quantiles of its draws (:mod:`bayesterra.stats.quantile_law`); the correlation of
their normal scores joins them, a Gaussian copula. How far that stands for the draws is measured here: along
the principal directions of the scores, scaled to one deviation, the copula is a product of standard normal
laws; draws on a ridge that bends are not. Compared are the probabilities to lie below given cuts along one
direction or two, tails among them. Where the copula differs from the draws clearly beyond their noise, a
mixture copula (:mod:`bayesterra.stats.dependence`) is measured likewise, on draws that its fit has not
seen, and stands in for the correlations if it differs by less.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtr

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, did_you_mean, errors_after
from bayesterra.models import RANGES
from bayesterra.parameters import MODULI, PARAMETERS, PRIOR_PARAMETERS, SIZES
from bayesterra.report.sections import Prose
from bayesterra.runtime.netcdf import Drawn, read_drawn
from bayesterra.stats.dependence import SINGULAR, TRIED, MixtureCopula, fit_mixture_copula
from bayesterra.stats.diagnostics import array_ess, rank_scores
from bayesterra.stats.quantile_law import QuantileLaw
from bayesterra.study import entries
from bayesterra.study.priors import Source
from bayesterra.study.schema import know_model, read_toml

say = Prose("previous")

ENOUGH = 400
"""Effective draws of every parameter below which tails and correlations are not known well enough."""
STEP = 0.5
"""Distance of the scores in a table: 5 % of the draws lie between most rows even beyond two deviations."""
BEYOND = 10.0
"""Effective draws that lie beyond the first and the last row of a table."""
HIGHEST = 3.5
"""Largest score in a table."""
CUTS = (
    *(-1.6448536269514729, -1.2815515655446004, -0.6744897501960817),
    *(0.0, 0.6744897501960817, 1.2815515655446004, 1.6448536269514722),
)
"""Scores at which probabilities are compared: 5 and 95 %, the deciles 1 and 9, the quartiles, the median."""
NOISE = 1.0
"""Largest difference of a probability that n draws of the copula itself show, times √n."""
CLEAR = 1.5
"""Noises beyond which correlations miss something: of eight parameters none of 100 draws of a copula did."""
POOR = 0.1
"""Difference of a probability from which a joint law stands badly for the draws."""
SIMULATED = 2**15
"""Draws of a mixture that its probabilities are counted on."""


@dataclass(frozen=True)
class Fidelity:
    """Fidelity of a joint law to the draws that it stands for."""

    pair: tuple[str, ...]  # the two parameters of the direction for which it stands worst; empty for one
    difference: float  # largest difference of a probability between joint law and draws
    noise: float  # largest difference that as many draws of the law itself would show

    @property
    def poor(self) -> bool:
        """True where the law stands badly for the draws, beyond their own noise."""
        return self.difference > max(POOR, self.noise)


@dataclass(frozen=True)
class PosteriorPrior:
    """A joint law from an earlier result.

    Attributes
    ----------
    label : where it comes from.
    take : parameter there by parameter here.
    widen : factor by which the normal scores were spread.
    draws : effective draws behind it, of the worst parameter.
    laws : by parameter here.
    correlation : of normal scores, by pair.
    fidelity : how well these correlations stand for the draws.
    notes : what to keep in mind; one sentence each.
    mixture : the mixture copula that stands in for correlations; None where these do no worse.
    mixture_fidelity : how well a mixture stands for the draws; None where none was needed.
    """

    label: str
    take: Mapping[str, str]
    widen: float
    draws: float
    laws: Mapping[str, QuantileLaw]
    correlation: Mapping[str, float]
    fidelity: Fidelity
    notes: tuple[str, ...]
    mixture: MixtureCopula | None = None
    mixture_fidelity: Fidelity | None = None

    def record(self) -> dict[str, Any]:
        """Content of the prior in ``run.json``."""
        tried = self.mixture_fidelity
        used = self.fidelity if self.mixture is None or tried is None else tried
        return {
            "from": self.label,
            "take": dict(self.take),
            "widen": self.widen,
            "effective_draws": self.draws,
            "joint_law": "correlations" if self.mixture is None else "mixture",
            "components": None if self.mixture is None else len(self.mixture.weights),
            "worst_pair": list(used.pair),
            "largest_difference": used.difference,
            "its_noise": used.noise,
            "bad": used.poor,
            "difference_of_correlations": self.fidelity.difference,
            "difference_of_mixture": None if tried is None else tried.difference,
        }


def taken(source: Source, names: Sequence[str] = PRIOR_PARAMETERS, tied: Collection[str] = ()) -> PosteriorPrior:
    """The joint law that a study takes from an earlier result.

    Parameters
    ----------
    names : the parameters that it may have.
    tied : parameters with stated correlations, which go together with correlations only.

    Raises
    ------
    StudyError : the result is missing, unfinished or too short, or lacks a parameter; or dimensions differ.
    """
    drawn, ranges = _opened(source.result)
    take = _names(source, drawn, names)
    columns = [drawn.draws[there] for there in take.values()]
    sizes = [array_ess(column) for column in columns]
    slowest = int(np.argmin(sizes))
    if not sizes[slowest] >= ENOUGH:
        there = list(take.values())[slowest]
        raise StudyError(
            f"a prior needs at least {ENOUGH} effective draws of every parameter"
            f" (got {sizes[slowest]:.0f} of '{there}' from {drawn.label})"
        )
    size = float(sizes[slowest])
    scores = np.column_stack([rank_scores(column).ravel() for column in columns])
    matrix = np.atleast_2d(np.corrcoef(scores.T))
    fidelity = _fidelity(tuple(take), scores, matrix, size)
    mixture, tried = None, None
    if fidelity.difference > CLEAR * fidelity.noise and np.linalg.eigvalsh(matrix)[0] > SINGULAR:
        mixture, halves = fit_mixture_copula(scores[:: max(1, round(len(scores) / size))])
        away = [  # how far either half is from draws of the fit to the other
            _shares(unseen, matrix) - _shares(fit.sample(SIMULATED, np.random.default_rng(0)), matrix)
            for fit, unseen in halves
        ]
        tried = _compared(tuple(take), np.mean(away, axis=0), matrix, min(size, TRIED))
        mixture = mixture if tried.difference < fidelity.difference else None
    bound = [name for name in take if name in tied] if mixture is not None else []
    mixture = None if bound else mixture
    text = say.plain("source", drawn.label, size, source.widen, fidelity, mixture, tried)
    laws = {
        here: _law(here, there, drawn.draws[there], ranges.get(there), size, text).widened(source.widen)
        for here, there in take.items()
    }
    pairs = combinations(enumerate(laws), 2)
    correlation = {entries.pair(a, b): round(float(matrix[i, j]), 6) for (i, a), (j, b) in pairs}
    notes = [] if drawn.converged else [f"{drawn.label}, whose posterior is a prior here, has not converged"]
    stiff = [name for name in ("Ks", "kphi") if name in take]
    if stiff and "n0" not in take:
        notes.append(f"{stiff[0]} is taken from {drawn.label} without its exponent: its unit changes with n0")
    if fidelity.poor or mixture is not None:
        notes.append(say.plain("stand", drawn.label, fidelity, mixture, tried))
    if bound:
        notes.append(f"{bound[0]} has stated correlations, so {drawn.label} gives these, not a mixture")
    rest = (correlation, fidelity, tuple(notes), mixture, tried)
    return PosteriorPrior(drawn.label, take, source.widen, size, laws, *rest)


def _opened(result: Any) -> tuple[Drawn, Mapping[str, tuple[float, float]]]:
    """Draws of a result folder or object, and the ranges that its own prior had."""
    if isinstance(result, str | Path):
        know_model(Path(result))
        return read_drawn(Path(result)), _ranges(Path(result))
    try:
        drawn = Drawn.of(result.draws["posterior"].to_dataset(), result.record, "")
    except (AttributeError, KeyError, TypeError) as error:
        raise StudyError(f"'result' must be a result folder or a result (got {result!r:.60})") from error
    prior = getattr(getattr(result, "study", None), "prior", None)
    laws, reference = ({}, 1.0) if prior is None else (prior.laws, prior.reference)
    return drawn, {name: law.range for name, law in laws.items() if reference == 1.0 or name not in MODULI}


def _ranges(folder: Path) -> dict[str, tuple[float, float]]:
    """Ranges of the laws that a result's study states, but of moduli at a reference; none in another form."""
    try:
        stated = entries.table(read_toml(folder / "study.toml").get("priors", {}), "priors")
    except StudyError:
        return {}
    ranges, unbound = {}, MODULI if "reference_sinkage" in stated else ()
    for name, entry in stated.items():
        if name in PARAMETERS and name not in unbound and isinstance(entry, Mapping) and "dist" in entry:
            law = entries.law(name, dict(entry), PARAMETERS[name].dimension, bare=False)
            ranges[name] = law.range
    return ranges


def _names(source: Source, drawn: Drawn, names: Sequence[str]) -> dict[str, str]:
    """Parameter there by parameter here, in the package's order."""
    if source.take is None:
        take = {name: name for name in names if name in drawn.draws}
        if not take:
            raise StudyError(f"{drawn.label} has no parameter of this study's (has {', '.join(drawn.draws)})")
        return take
    for here, there in source.take.items():
        if here not in PRIOR_PARAMETERS:
            raise StudyError(f"'take': unknown parameter '{here}'{did_you_mean(here, PRIOR_PARAMETERS)}")
        if there not in drawn.draws:
            raise StudyError(f"'take': {drawn.label} has no draws of '{there}' (has {', '.join(drawn.draws)})")
        ours, theirs = PARAMETERS[here].dimension, _dimension(there, drawn.units[there])
        if theirs is not None and theirs != ours:
            kinds = f"{ours or 'pure number'} and {theirs or 'pure number'}"
            raise StudyError(f"'take': '{here}' and '{there}' must have the same dimension (got {kinds})")
    twice = [there for there in source.take.values() if list(source.take.values()).count(there) > 1]
    if twice:
        raise StudyError(f"'take': '{twice[0]}' is taken more than once")
    return {name: source.take[name] for name in PARAMETERS if name in source.take}


def _dimension(name: str, unit: str) -> str | None:
    """SI unit of draws without the power of a sinkage exponent; None where nothing says it."""
    if unit:
        return re.sub(r"\s*/\s*m\^\w+$", "", unit).removesuffix("1")
    return PARAMETERS[name].dimension if name in PARAMETERS else None


def _law(
    here: str, there: str, draws: FloatArray, stated: tuple[float, float] | None, size: float, text: str
) -> QuantileLaw:
    """The law of one parameter, within its physical range and that of the earlier prior."""
    physical = (0.0, np.inf) if here.startswith(SIZES) else RANGES.get(here, (-np.inf, np.inf))
    low, high = (-np.inf, np.inf) if stated is None else stated
    steps = np.arange(1, int(HIGHEST / STEP) + 1) * STEP
    beyond = steps[ndtr(-steps) * size >= BEYOND]
    scores = np.concatenate([-beyond[::-1], [0.0], beyond])
    values = [float(f"{value:.6g}") for value in np.quantile(draws, ndtr(scores))]
    with errors_after(f"draws of '{there}' make no law: "):
        return QuantileLaw(
            lower=max(low, physical[0]),
            upper=min(high, physical[1]),
            source=text,
            scores=tuple(scores.tolist()),
            values=tuple(values),
        )


def _fidelity(names: tuple[str, ...], scores: FloatArray, matrix: FloatArray, size: float) -> Fidelity:
    """Compare probabilities along the principal directions of scores (n, d) of correlation (d, d)."""
    if len(names) < 2:
        return Fidelity((), 0.0, NOISE / float(np.sqrt(size)))
    p = ndtr(CUTS)
    expected = np.where(
        np.eye(len(names), dtype=bool)[:, None, :, None],
        np.minimum.outer(p, p)[None, :, None, :],
        np.multiply.outer(p, p)[None, :, None, :],
    )
    return _compared(names, _shares(scores, matrix) - expected, matrix, size)


def _shares(scores: FloatArray, matrix: FloatArray) -> FloatArray:
    """Shares (d, cuts, d, cuts) of scores (n, d) that lie below two cuts along principal directions."""
    values, directions = np.linalg.eigh(matrix)
    below = (scores @ directions / np.sqrt(values))[:, :, None] <= np.array(CUTS)
    flat = below.reshape(len(scores), -1).astype(np.float64)
    return np.asarray((flat.T @ flat / len(scores)).reshape(below.shape[1:] * 2))


def _compared(names: tuple[str, ...], away: FloatArray, matrix: FloatArray, size: float) -> Fidelity:
    """The fidelity that differences (d, cuts, d, cuts) of shares show."""
    off = np.abs(away).max(axis=(1, 3))
    narrow = min(np.unravel_index(int(off.argmax()), off.shape))  # eigenvalues rise
    leading = np.argsort(-np.abs(np.linalg.eigh(matrix)[1][:, narrow]))[:2]
    pair = tuple(names[i] for i in sorted(leading))
    return Fidelity(pair, float(off.max()), NOISE / float(np.sqrt(size)))
