"""Structure of a design: directions of the parameters that no reading of it could see.

A design is what a study measures where: the slips, wheels and loads (or sinkages) of its rows, and the
channels that are read. A direction is beyond it if it changes no reading anywhere in the prior. So the rank
of the exact sensitivity matrix (Jacquez & Greif 1985, Math. Biosci. 77, 201; Cole 2020, Parameter Redundancy
and Identifiability) is found at many draws of the cut prior: the models are analytic in their parameters, so
the rank is the same almost everywhere, and a lower one in single draws is an accident of the place.

A null space that is the same everywhere is a redundancy of the parameters as they stand, e.g. of k_c and k_φ
under wheels of one width, or of n0 and n1 at one slip; one that turns from draw to draw is a curve.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
import pandas as pd

from bayesterra.arrays import BoolArray, FloatArray, IntArray
from bayesterra.errors import counted, enumerated
from bayesterra.likelihood.joint import Whole
from bayesterra.likelihood.likelihood import Likelihood
from bayesterra.likelihood.sensitivities import has_own_sd, read_where, sensitivities, without_load
from bayesterra.parameters import CHANNELS, MODULI, PARAMETERS, SIZES

DRAWS, FEWEST, NUMBERS = 300, 30, 100_000
"""Draws of the cut prior that are plenty; of tables of many rows so many numbers in all are, and the fewest draws."""


@dataclass(frozen=True)
class Null:
    """Directions that change no reading and have parameters in common.

    Attributes
    ----------
    parameters : those that take part, in the package's order.
    directions : (count, d), SI, each with one parameter to itself, which moves by its prior standard
        deviation; at one draw of the prior where bent.
    straight : whether they are the same everywhere.
    words : what is determined instead, and why no more.
    """

    parameters: tuple[str, ...]
    directions: FloatArray
    straight: bool
    words: str


@dataclass(frozen=True)
class Structure:
    """Structural identifiability: parameters and directions that the design of a study can determine.

    Attributes
    ----------
    names : the d free parameters.
    design : rows and channels of the study.
    rank : number of directions that the design sees, d if it sees all.
    nulls : the others.
    table : one row per parameter: parameter, determined (bool), because (words, empty where it is).
    accidents : share of the prior's draws at which the rank is lower still.
    least_seen, most_unseen : singular values on both sides of ``RANK_TOLERANCE``: the median of the weakest
        direction seen, the largest of one unseen (0 where all are seen).
    draws : number of draws behind it.
    """

    names: tuple[str, ...]
    design: "Design"
    rank: int
    nulls: tuple[Null, ...]
    table: pd.DataFrame
    accidents: float
    least_seen: float
    most_unseen: float
    draws: int

    @property
    def determined(self) -> tuple[str, ...]:
        """Parameters that the design can determine."""
        lost = {name for null in self.nulls for name in null.parameters}
        return tuple(name for name in self.names if name not in lost)


def structure(posterior: Whole, prior: FloatArray) -> Structure:
    """Find what no data of this design can determine.

    Parameters
    ----------
    posterior : of the study; only where there are readings counts, not what they are. A channel that has
        noise but no reading at all counts as read in every row: a study made before its measurements.
    prior : draws (n, d) of the cut prior, a few hundred.

    Raises
    ------
    ValueError : the model has no answer for any of the draws.
    """
    spectra = ranks(posterior, prior, design_of(posterior).channels)
    if not len(spectra.matrices):
        raise ValueError("the model has no answer in some row for every draw of the prior")
    nulls = (*_soil_nulls(posterior, prior, spectra), *_noise_nulls(posterior))
    seen = spectra.values[:, : spectra.rank]
    return Structure(
        names=posterior.names, design=design_of(posterior),
        rank=len(posterior.names) - sum(len(null.directions) for null in nulls), nulls=nulls,
        table=_table(posterior.names, nulls), accidents=float((spectra.of_sets < spectra.rank).mean()),
        least_seen=float(np.median(seen.min(axis=1))) if spectra.rank else 0.0,
        most_unseen=float(spectra.values[:, spectra.rank :].max(initial=0.0)), draws=len(spectra.matrices),
    )  # fmt: skip


def _soil_nulls(posterior: Whole, prior: FloatArray, spectra: "Ranks") -> list[Null]:
    """Unseen directions of all but the noise."""
    columns = soil_columns(posterior)
    names = [posterior.names[i] for i in columns]
    unseen, design = spectra.unseen(), design_of(posterior)
    remedies = _remedies(posterior, prior) if unseen else {}
    nulls = []
    for each in unseen:
        places = [i for i in range(len(names)) if each.directions[:, i].any()]
        parameters = tuple(names[i] for i in places)
        directions = np.zeros((len(each.directions), len(posterior.names)))
        directions[:, columns] = each.directions * prior[:, columns].std(axis=0)
        words = _words(parameters, directions[:, [columns[i] for i in places]], each.straight)
        counted = None if each.straight else len(names)
        reasons = [*design.reasons(parameters, counted), *_helped(parameters, remedies)]
        if len(parameters) == len(directions) and design.rows and not len(design.given):
            words += ", or only in the way that it depends on the unknown load"
        nulls.append(Null(parameters, directions, each.straight, "; ".join([words, *reasons])))
    return nulls


def _noise_nulls(posterior: Whole) -> list[Null]:
    """Estimated noise of channels whose every reading has a standard deviation of its own."""
    told: dict[int, bool] = {}
    groups = zip(posterior.groups.values(), posterior.places, read_where(posterior), strict=True)
    for own, at, read in groups:
        likelihood = own.likelihood
        for noise, where in zip(likelihood.noise, read.T, strict=True):
            if noise.parameter is not None:
                column = int(at[own.names.index(noise.parameter)])
                told[column] = told.get(column, False) or bool((where & ~has_own_sd(likelihood, noise)).any())
    words = "every reading has a standard deviation of its own"
    every = np.eye(len(posterior.names))
    return [Null((posterior.names[i],), every[[i]], True, words) for i, seen in told.items() if not seen]


def _words(parameters: tuple[str, ...], directions: FloatArray, straight: bool) -> str:
    """Words on what is determined in place of ``parameters``; ``directions`` (count, parameters), SI."""
    determined, all_of = len(parameters) - len(directions), len(parameters)
    if determined == 0:
        return f"no reading depends on {listed(parameters)}"
    if straight and all_of == 2:
        first, second = (PARAMETERS[name].scale for name in parameters)
        weight = -directions[0, 0] / directions[0, 1] * second / first
        inside = combination(parameters, np.array([1.0, weight]), least=0.0, digits=3)
        units = [PARAMETERS[name].unit for name in parameters]
        return f"only {inside} is determined" + (f" ({' and '.join(units)})" if set(units) != {"-"} else "")
    seen = f"{determined} of {all_of} directions {'is' if determined == 1 else 'are'} determined"
    bent = "" if straight else f", which {'differs' if determined == 1 else 'differ'} from soil to soil"
    return f"of {listed(parameters)} only {seen}{bent}"


def _remedies(posterior: Whole, prior: FloatArray) -> dict[tuple[str, ...], set[str]]:
    """Parameters that every channel that is not read would determine, and all of them together."""
    names = [posterior.names[i] for i in soil_columns(posterior)]
    design, determined = design_of(posterior), {}
    read, missing = design.channels, design.missing
    for added in dict.fromkeys([*((name,) for name in missing), missing] if missing else []):
        unseen = ranks(posterior, prior, (*read, *added)).unseen()
        lost = {names[i] for each in unseen for i in np.flatnonzero(each.directions.any(axis=0))}
        determined[added] = set(names) - lost
    return determined


def _helped(parameters: tuple[str, ...], remedies: Mapping[tuple[str, ...], set[str]]) -> list[str]:
    """Further channels that would determine some of ``parameters``; several only where one is too few."""
    choices: dict[tuple[str, ...], list[str]] = {}
    for channels, determined in remedies.items():
        new = tuple(name for name in parameters if name in determined)
        if new and not (len(channels) > 1 and any(set(new) <= set(earlier) for earlier in choices)):
            words = " and ".join(CHANNELS[name].description for name in channels)
            choices.setdefault(new, []).append(words)
    return [
        f"readings of {' or '.join(words)} would determine"
        f" {'them' if new == parameters and len(new) > 1 else listed(new)}"
        for new, words in choices.items()
    ]


def _table(names: tuple[str, ...], nulls: Sequence[Null]) -> pd.DataFrame:
    because = {name: [null.words for null in nulls if name in null.parameters] for name in names}
    return pd.DataFrame(
        {
            "parameter": list(names),
            "determined": [not because[name] for name in names],
            "because": ["; ".join(because[name]) for name in names],
        }
    )


@dataclass(frozen=True)
class Design:
    """Rows and channels of a study.

    Attributes
    ----------
    rows : number of rows in the fit.
    slips, widths, given : distinct slips, wheel widths (m), and loads (N; none where latent) or sinkages (m).
    levels : distinct plate radii (m) and normal stresses (Pa) of soil tests, by kind.
    channels, missing : outcomes of the drive that are read, and that are not.
    readings : number of readings that differ in more than their error, less one per latent load.
    """

    rows: int
    slips: FloatArray
    widths: FloatArray
    given: FloatArray
    channels: tuple[str, ...]
    missing: tuple[str, ...]
    readings: int
    levels: Mapping[str, FloatArray] = field(default_factory=dict)

    def reasons(self, parameters: Sequence[str], free: int | None = None) -> list[str]:
        """Reasons in the design why directions among ``parameters`` may not be seen.

        ``free`` is the number of parameters to be found, where too few readings may be the reason.
        """
        reasons = []
        if {"n1", "c2"} & set(parameters) and len(self.slips) == 1:
            reasons.append(f"all rows have the slip {self.slips[0]:.3g}")
        if set(MODULI) <= set(parameters) and len(self.widths) == 1:
            reasons.append(f"all wheels are {1e3 * self.widths[0]:.3g} mm wide")
        for kind, names in (("plate", MODULI), ("shear", ("c", "phi"))):
            if set(names) <= set(parameters) and len(levels := self.levels.get(kind, self.slips[:0])) == 1:
                word, unit = ("plates have the radius", "mm") if kind == "plate" else ("tests the normal stress", "kPa")
                reasons.append(f"all {word} {levels[0] * (1e3 if kind == 'plate' else 1e-3):.3g} {unit}")
        load_driven = "normal_force" not in (*self.channels, *self.missing)
        if {"cDP", "cM"} & set(parameters) and load_driven and len(self.given) == 1:
            reasons.append(f"all rows have the load {self.given[0]:.3g} N")
        if free is not None and self.readings < free:
            reasons.append(f"{counted(self.readings, 'different reading')} for {free} parameters")
        return reasons

    def __str__(self) -> str:
        """Name rows, slips, widths and channels in a line."""
        tests = [f"{kind} tests at {counted(len(levels), 'level')}" for kind, levels in self.levels.items()]
        if not self.rows:
            return ", ".join(tests)
        read = ", ".join([*(CHANNELS[name].description for name in self.channels), *tests])
        ends = f"{self.slips[0]:.3g}" + (f" to {self.slips[-1]:.3g}" if len(self.slips) > 1 else "")
        rows, slips = counted(self.rows, "row"), counted(len(self.slips), "slip")
        return f"{rows} at {slips} ({ends}), {counted(len(self.widths), 'wheel width')}; {read}"


def design_of(posterior: Whole) -> Design:
    """The design of a study, of all groups together."""
    masks = zip(posterior.groups.values(), read_where(posterior), strict=True)
    designs = [_of_likelihood(own.likelihood, read) for own, read in masks]
    slips, widths, given = (
        np.unique(np.concatenate([getattr(each, name) for each in designs])) for name in ("slips", "widths", "given")
    )
    rows, readings = (sum(getattr(each, name) for each in designs) for name in ("rows", "readings"))
    tests = [each for own in posterior.groups.values() for each in own.experiments]
    levels = {
        kind: np.unique(np.concatenate([each.readings.levels for each in tests if each.readings.kind == kind]))
        for kind in dict.fromkeys(each.readings.kind for each in tests)
    }
    readings += sum(len(each.readings) for each in tests)
    return replace(designs[0], rows=rows, slips=slips, widths=widths, given=given, readings=readings, levels=levels)


def _of_likelihood(likelihood: Likelihood, read: BoolArray) -> Design:
    forward, conditions = likelihood.forward, likelihood.forward.conditions
    latent = forward.drive.latent_load
    columns = [conditions.slip, conditions.radius, conditions.width, conditions.lug_height]
    columns.append(np.zeros(len(conditions.slip)) if latent else forward.given)
    _, first = np.unique(np.round(np.column_stack(columns), 9), axis=0, return_index=True)
    each = read[first].sum(axis=1)
    return Design(
        rows=len(conditions.slip), slips=np.unique(np.round(conditions.slip, 9)),
        widths=np.unique(np.round(conditions.width, 9)),
        given=np.empty(0) if latent else np.unique(forward.given), channels=likelihood.channels,
        missing=tuple(name for name in forward.outcomes if name not in likelihood.channels and len(conditions.slip)),
        readings=int(np.maximum(each - latent, 0).sum()),
    )  # fmt: skip


RANK_TOLERANCE = 1e-10
"""Singular value, for rows and columns of unit length, below which a direction is not seen.

Rounding leaves 1e-15 where nothing is seen; where something is, the least found over the paper's box is 1e-7.
"""
COMMON = 0.05
"""Share of the parameter sets that must have a rank for it to be the rank of the design."""


@dataclass(frozen=True)
class Unseen:
    """Directions (count, d) that change no reading and share parameters; see ``structure.Null``."""

    directions: FloatArray
    straight: bool


@dataclass(frozen=True)
class Ranks:
    """Singular values of the sensitivities at n parameter sets, and what they leave unseen."""

    matrices: FloatArray  # (n, q, d) with rows and columns of unit length; noise parameters are not among the columns
    lengths: FloatArray  # (n, d) by which columns in units of the prior's standard deviations were divided

    @cached_property
    def _decomposed(self) -> tuple[FloatArray, FloatArray]:
        n, q, d = self.matrices.shape  # with at least as many rows as columns
        tall = self.matrices if q >= d else np.concatenate([self.matrices, np.zeros((n, d - q, d))], axis=1)
        _, values, vectors = np.linalg.svd(tall, full_matrices=False)
        return values, vectors

    @property
    def values(self) -> FloatArray:
        """Singular values (n, d), largest first."""
        return self._decomposed[0]

    @cached_property
    def of_sets(self) -> IntArray:
        """Rank (n,) at every parameter set."""
        return np.asarray((self.values > RANK_TOLERANCE).sum(axis=1))

    @cached_property
    def rank(self) -> int:
        """The rank almost everywhere: the highest that is not rare."""
        return int(np.quantile(self.of_sets, 1.0 - COMMON, method="lower"))

    @cached_property
    def bases(self) -> FloatArray:
        """Orthonormal unseen directions (g, d − rank, d) of the sets that show them best, the best first.

        In units of the prior's standard deviations.
        """
        gap = np.where(self.of_sets == self.rank, self.values[:, max(self.rank - 1, 0)], -1.0)
        order = np.argsort(-gap, kind="stable")
        best = order[: max(1, int((gap > 0).sum()) // 2)]
        raw = self._decomposed[1][best, self.rank :] / self.lengths[best, None]
        return np.asarray(np.linalg.qr(raw.transpose(0, 2, 1))[0].transpose(0, 2, 1))

    def unseen(self) -> list[Unseen]:
        """Unseen directions in their simplest form: those that are the same everywhere, then the others."""
        if self.rank == self.values.shape[1]:
            return []
        projector = (self.bases.transpose(0, 2, 1) @ self.bases).mean(axis=0)
        shares, vectors = np.linalg.eigh(projector)
        straight, pivots = echelon(vectors[:, shares > 1.0 - NEGLIGIBLE].T)
        bent = self.bases[0] - self.bases[0] @ np.linalg.pinv(straight) @ straight
        bent = np.linalg.svd(bent)[2][: len(bent) - len(straight)]
        bent = echelon(bent - bent[:, pivots] @ straight)[0]
        alone = (straight != 0).sum(axis=1) == 1
        directions = [Unseen(straight[alone], True)] if alone.any() else []
        for rows, same in ((straight[~alone], True), (bent, False)):
            directions += [Unseen(rows[group], same) for group in gathered(rows != 0)]
        return sorted(directions, key=lambda each: int(each.directions.any(axis=0).argmax()))


def ranks(posterior: Whole, x: FloatArray, channels: Sequence[str]) -> Ranks:
    """Ranks at sets ``x`` (n, d), in units of their standard deviations, where ``channels`` are read.

    Sets for which the model has no answer are left out. See :func:`read_where` for the rows.
    """
    soil, parts = soil_columns(posterior), []
    groups = zip(posterior.groups.values(), posterior.places, posterior.values_of_groups(x), strict=True)
    for (own, at, values), read in zip(groups, read_where(posterior, channels), strict=True):
        if not own.driven:
            continue
        slopes = sensitivities(own, values).of(tuple(channels))
        whole = np.zeros((*slopes.values.shape, x.shape[1]))
        whole[..., at] = slopes.by_parameter
        by_x = np.where(read[..., None], whole[..., soil] * x[:, soil].std(axis=0), 0.0)
        parts.append((by_x, np.where(read, slopes.by_load * own.likelihood.forward.given[:, None], 0.0)))
    parts += _by_tests(posterior, x, soil, parts[0][1].shape[2] if parts else 1)
    by_x, by_load = (np.concatenate(each, axis=1) for each in zip(*parts, strict=True))
    rows = _lengths(np.concatenate([by_x, by_load[..., None]], axis=3), axis=3)
    by_x, by_load = by_x / rows[..., None], by_load / rows
    lengths = _lengths(by_x, axis=(1, 2))
    seen = without_load(by_x / lengths[:, None, None], by_load, 0.0)
    seen = seen.reshape(len(x), by_load[0].size, len(soil))
    answered = np.isfinite(seen).all(axis=(1, 2))
    return Ranks(seen[answered], lengths[answered])


def _by_tests(posterior: Whole, x: FloatArray, soil: list[int], k: int) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Slopes of the readings of soil tests as of rows with ``k`` channels, of which they read the first."""
    for own, at, values in zip(posterior.groups.values(), posterior.places, posterior.values_of_groups(x), strict=True):
        for experiment in own.experiments:
            slopes = experiment.slopes(values)
            whole = np.zeros((*slopes.shape[:2], k, x.shape[1]))
            whole[:, :, 0, at] = slopes
            yield whole[..., soil] * x[:, soil].std(axis=0), np.zeros(whole.shape[:3])


def soil_columns(posterior: Whole) -> list[int]:
    """Parameters that readings depend on by themselves: no noise, no mean or spread of a population."""
    return sorted({i for own, at in zip(posterior.groups.values(), posterior.places, strict=True)
                   for i, name in zip(at.tolist(), own.names, strict=True)
                   if not name.startswith(SIZES)})  # fmt: skip


def _lengths(values: FloatArray, axis: int | tuple[int, ...]) -> FloatArray:
    """Euclidean lengths, 1 where they are 0."""
    length = np.sqrt((values**2).sum(axis=axis))
    return np.where(length == 0, 1.0, length)


NEGLIGIBLE = 1e-6
"""Share of a direction (of unit length in prior standard deviations) below which a parameter has no part."""


def echelon(rows: FloatArray) -> tuple[FloatArray, IntArray]:
    """Reduced echelon form of directions (q, d), and the column (q,) that each has to itself with weight 1.

    Gauss–Jordan elimination with full pivoting: the simplest basis of what the directions span.
    """
    rows, pivots = rows.copy(), np.empty(len(rows), dtype=np.int64)
    for i in range(len(rows)):
        best, column = divmod(int(np.abs(rows[i:]).argmax()), rows.shape[1])
        rows[[i, i + best]] = rows[[i + best, i]]
        rows[i] /= rows[i, column]
        others = np.arange(len(rows)) != i
        rows[others] -= rows[others, column][:, None] * rows[i]
        pivots[i] = column
    return np.where(np.abs(rows) < NEGLIGIBLE, 0.0, rows), pivots


def gathered(supports: BoolArray) -> list[list[int]]:
    """Directions whose parameters, True in ``supports`` (q, d), overlap, as groups of their numbers."""
    groups: list[list[int]] = []
    for i in range(len(supports)):
        shared = [group for group in groups if (supports[group].any(axis=0) & supports[i]).any()]
        groups = [group for group in groups if group not in shared]
        groups.append(sorted([i, *(member for group in shared for member in group)]))
    return groups


def combination(
    names: Sequence[str], weights: FloatArray, *, least: float = 0.15, terms: int = 4, digits: int = 2
) -> str:
    """Leading terms of a weighted sum, in symbols.

    Parameters
    ----------
    names : parameters.
    weights : (d,); terms with less than the share ``least`` of the largest are left out.
    terms : at most so many.
    digits : significant digits; a weight of 1 is not written.

    >>> combination(("n0", "c1", "phi"), np.array([-0.57, 0.82, 0.01]))
    '0.82 c1 − 0.57 n0'
    """
    size = np.abs(weights)
    order = np.argsort(-size, kind="stable")[:terms]
    signed_terms = []
    for i in (int(i) for i in order if size[i] > 0 and size[i] >= least * size.max()):
        weight = f"{size[i]:.{digits}g} ".removeprefix("1 ")
        signed_terms.append(f"{'−' if weights[i] < 0 else '+'} {weight}{PARAMETERS[names[i]].symbol}")
    text = " ".join(signed_terms)
    return text[2:] if text.startswith("+") else text.replace("− ", "−", 1)


def listed(names: Sequence[str]) -> str:
    """Symbols of parameters as in a sentence.

    >>> listed(("Ks", "n0", "n1"))
    'K_s, n0 and n1'
    """
    return enumerated([PARAMETERS[name].symbol for name in names])
