"""Candidate drives of a design, and what each would read for every draw."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.random import Generator

from bayesterra.arrays import BoolArray, FloatArray, frozen
from bayesterra.errors import StudyError, known
from bayesterra.likelihood.correlated import CorrelatedLikelihood
from bayesterra.likelihood.forward import Forward, load_of, offset_of, reference_load
from bayesterra.likelihood.posterior import Posterior
from bayesterra.models import Conditions, Wheel
from bayesterra.parameters import CHANNELS, OUTCOMES
from bayesterra.stats.tails import GAUSSIAN
from bayesterra.study.drive import Drive
from bayesterra.study.noise import Noise
from bayesterra.study.observations import Observations
from bayesterra.study.study import Study
from bayesterra.study.units import quantity
from bayesterra.study.wheels import checked_slips

SLIPS = 13
"""Slips of the default grid."""
MARGIN = 0.25
"""Reach of the default grid beyond the driven slips, as a share of their range."""
LOADS = 4
"""Distinct loads of a study that become candidates; of more, the lowest, the median and the highest do."""


@dataclass(frozen=True)
class Candidate:
    """One drive, or one new sensor on all drives: the rows that it would add."""

    wheel: tuple[str, ...]  # name of the wheel of every row
    wheels: tuple[Wheel, ...]  # its dimensions
    slip: FloatArray  # of every row (m,), on the shearing radius
    load: FloatArray  # of every row (m,), N
    noise: tuple[Noise, ...]  # noise of every channel that is read, in the order of the package
    repeats: bool = False  # whether these are the rows of the study, driven once more

    @property
    def channels(self) -> tuple[str, ...]:
        """Channels that are read."""
        return tuple(noise.channel for noise in self.noise)

    @property
    def where(self) -> str:
        """What is driven, in a few words.

        >>> from bayesterra.models import Wheel
        >>> wheel = Wheel(radius=0.157, width=0.165)
        >>> Candidate(("Wh",), (wheel,), np.array([0.3]), np.array([80.0]), ()).where
        'wheel Wh, 80 N, slip 0.3'
        """
        if self.repeats:
            return f"the {len(self.slip)} rows of the study again"
        return f"wheel {self.wheel[0]}, {self.load[0]:.4g} N, slip {self.slip[0]:.3g}"


def candidates(
    study: Study,
    slips: Sequence[float] = (),
    loads: Sequence[float | str] = (),
    wheels: Mapping[str, Wheel] = MappingProxyType({}),
    sensors: Sequence[str] = (),
) -> list[Candidate]:
    """Every wheel under every load at every slip, read as in the study and with new sensors too.

    With new sensors there is one candidate more: they alone, on the rows of the study driven again.

    Parameters
    ----------
    slips : on the shearing radius; by default the driven ones and a quarter of their range beyond.
    loads : N or texts with units; by default those of the study.
    wheels : by name; by default those of the study.
    sensors : channels to be read beside the study's, ``name`` or ``name=0.15 N m`` with its noise.

    Raises
    ------
    StudyError : a slip, load or channel that cannot be, or no load is known.
    """
    under = [load_of(study, load) for load in loads or _measured_loads(study)]
    at = checked_slips(slips) if len(slips) else _default_slips(study)
    own = tuple(study.noise.values())
    added = tuple(_sensor(study, text) for text in sensors)
    sets = [own, _ordered((*own, *added))] if added else [own]
    grid = [
        Candidate((name,), (wheel,), np.array([slip]), np.array([load]), noise)
        for name, wheel in (wheels or study.wheels).items()
        for load in under
        for noise in sets
        for slip in at
    ]
    return [*grid, _again(study, _ordered(added))] if added else grid


def parameters_of_interest(study: Study, about: Sequence[str]) -> tuple[str, ...]:
    """The parameters asked for, or all that are free.

    StudyError where nothing is free, or one of them is unknown, fixed or tied.
    """
    free, prior = study.prior.names, study.prior
    if not free:
        raise StudyError("nothing is free: give at least one parameter a prior law")
    wanted = tuple(dict.fromkeys(about))
    for name in wanted:
        if name in prior.ties:
            raise StudyError(f"'{name}' is tied to '{prior.root(name)}': ask about that")
        if name in prior.fixed:
            raise StudyError(f"'{name}' is fixed at {prior.fixed[name]:g}: no drive tells more about it")
        known("parameter", name, free)
    return wanted or free


def _default_slips(study: Study) -> FloatArray:
    driven = study.observations.used().slip
    low, high = float(driven.min()), float(driven.max())
    margin = MARGIN * (high - low) if high > low else 0.2
    return np.linspace(max(0.0, low - margin), min(0.95, high + margin), SLIPS)


def _measured_loads(study: Study) -> Sequence[float | None]:
    """Loads of the study, ``LOADS`` at most; None, which stands for the reference load, without any."""
    rows = study.observations.used()
    measured = rows.known_loads[~np.isnan(rows.known_loads)]
    distinct = np.unique([float(f"{load:.3g}") for load in measured])
    if distinct.size > LOADS:
        distinct = np.quantile(measured, (0.0, 0.5, 1.0))
    return distinct.tolist() or [None]


def _sensor(study: Study, text: str) -> Noise:
    """Noise of a new channel, from ``name`` or ``name=sd``."""
    name, equals, sd = (part.strip() for part in text.partition("="))
    known("channel", name, study.drive.outcomes)
    if name in study.noise:
        raise StudyError(f"'{name}' is read already: every candidate has it")
    if not equals:
        unit = CHANNELS[name].unit
        example = {"mm": "0.5 mm", "N m": "0.15 N m"}.get(unit, f"1 {unit}")
        raise StudyError(f"'{name}' needs its noise: --channel \"{name}={example}\"")
    return Noise(name, sd=quantity(sd, CHANNELS[name].dimension, f"noise of {name}"))


def _ordered(noise: tuple[Noise, ...]) -> tuple[Noise, ...]:
    return tuple(sorted(noise, key=lambda sensor: list(CHANNELS).index(sensor.channel)))


def _again(study: Study, noise: tuple[Noise, ...]) -> Candidate:
    """New sensors alone, on the study's rows driven again."""
    rows = study.observations.used()
    load = np.where(np.isnan(rows.known_loads), reference_load(study), rows.known_loads)
    return Candidate(rows.wheel, tuple(study.wheels[n] for n in rows.wheel), rows.slip, load, noise, True)


NORMAL_FORCE = "normal_force"


@dataclass(frozen=True)
class Situation:
    """Knowledge before the next drive."""

    study: Study  # conditions, model and noise
    posterior: Posterior  # its density, which knows which columns of the draws are noise
    draws: FloatArray  # parameter sets (n, d), of the posterior or of the cut prior
    source: str  # ``posterior`` or ``prior``
    basis: str = ""  # of one group of a joint posterior: where its parameters come from, a sentence


@dataclass(frozen=True)
class Reading:
    """One row as every draw expects it: y = f + W⁻¹ ε with independent standard noise ε."""

    mean: FloatArray  # f (n, k), NaN where the model has no answer
    whitening: FloatArray  # W (n, k, k), lower triangular
    noise: tuple[Noise, ...]  # laws of ε

    @property
    def answered(self) -> BoolArray:
        """Draws (n,) for which the model has an answer."""
        return np.asarray(np.isfinite(self.mean).all(axis=1))

    def draw(self, standard: FloatArray) -> FloatArray:
        """Readings (n, k) from standard noise (n, k), one for every draw."""
        return self.mean + np.linalg.solve(self.whitening, standard[:, :, None])[:, :, 0]

    def log_density(self, readings: FloatArray, draws: slice | FloatArray = slice(None)) -> FloatArray:
        """Log density (m, n) of readings (m, k) under each of some draws."""
        mean, whitening = self.mean[draws], self.whitening[draws]
        total = np.log(np.diagonal(whitening, axis1=1, axis2=2)).sum(axis=1)[None, :]
        apart = [readings[:, b, None] - mean[None, :, b] for b in range(mean.shape[1])]
        for a, noise in enumerate(self.noise):
            used = [b for b in range(a + 1) if whitening[:, a, b].any()]
            standard = sum((apart[b] * whitening[None, :, a, b] for b in used[1:]), apart[used[0]]
                           * whitening[None, :, a, used[0]])  # fmt: skip
            total = total + noise.tails.log_density(standard)
        return np.asarray(total)


def readings_of(situation: Situation, candidate: Candidate) -> tuple[Reading, ...]:
    """Every row of a candidate as every draw expects it.

    Drive ``sinkage``: readings at the median, over the draws, of the sinkage that the load makes, as that
    drive takes the sinkage as known. Drive ``both``: the readings given the normal force; an error in the
    load is carried to them to first order. A discrepancy is as the readings of the table leave it.
    """
    return tuple(_row(situation, row) for row in _rows(candidate))


def _rows(candidate: Candidate) -> Iterator[Candidate]:
    for i in range(len(candidate.slip)):
        row = slice(i, i + 1)
        yield replace(
            candidate, wheel=candidate.wheel[row], wheels=candidate.wheels[row], slip=candidate.slip[row],
            load=candidate.load[row],
        )  # fmt: skip


def _row(situation: Situation, row: Candidate) -> Reading:
    """One row by the law of its readings, given those of the table where rows hang together."""
    study, latent = situation.study, situation.study.load_range
    noise, known = row.noise, {NORMAL_FORCE: row.load} if latent else {}
    if latent and NORMAL_FORCE not in row.channels:  # a load that nothing reads is about the one that is meant
        noise = (*noise, Noise(NORMAL_FORCE, sd=latent[1] - latent[0]))
    errors, soil = study.errors.of(row.channels), study.prior.soil_values(situation.draws)
    if study.drive.by_sinkage:
        known = {"sinkage": _carried(study, row, soil)}
    nothing = frozen(np.zeros(1), np.bool_)
    rows = Observations(row.wheel, row.slip, row.load, known, {}, nothing, (0,))
    if errors and situation.source == "posterior":
        rows = study.observations.used().followed_by(rows)
    blank = {entry.channel: frozen(np.full(len(rows), np.nan)) for entry in noise}
    rows = replace(rows, values={**blank, **rows.values})
    wheels = {**study.wheels, **dict(zip(row.wheel, row.wheels, strict=True))}
    forward = Forward.of(study.model, study.drive, rows, wheels)
    likelihood = CorrelatedLikelihood(forward, rows, noise, latent, errors)
    unknown = [each.parameter for each in (*noise, *errors) if each.parameter]
    sizes = situation.draws[:, [situation.posterior.names.index(name) for name in unknown]]
    target = np.arange(len(rows)) == len(rows) - 1
    mean, covariance, _ = likelihood.jointly_ahead(soil, sizes, target)
    read = [i for i, entry in enumerate(noise) if not (latent and entry.channel == NORMAL_FORCE)]
    mean, covariance = mean[:, 0, read], covariance[:, 0][:, read][:, :, read]
    answered: BoolArray = np.asarray(np.isfinite(covariance).all(axis=(1, 2)))
    safe = np.where(answered[:, None, None], covariance, np.eye(len(read)))
    whitening: FloatArray = np.asarray(np.linalg.inv(np.linalg.cholesky(safe)), dtype=np.float64)
    return Reading(np.where(answered[:, None], mean, np.nan), whitening, tuple(noise[i] for i in read))


def _carried(study: Study, row: Candidate, soil: FloatArray) -> FloatArray:
    """Median (1,) over the draws of the sinkage, as it is read, that the load makes."""
    forward = Forward(study.model, Drive.LOAD, Conditions.of(row.wheels, row.slip), row.load)
    carried = forward(soil)["sinkage"]
    if not np.isfinite(carried).any():
        return row.load
    return frozen(np.nanmedian(carried + offset_of(soil), axis=0))


def standard_noise(reading: Reading, rng: Generator) -> FloatArray:
    """Standard noise (n, k) of one row; one stream gives one channel the same noise in every candidate."""
    normal = rng.standard_normal((len(reading.mean), len(OUTCOMES)))
    drawn = normal[:, [OUTCOMES.index(noise.channel) for noise in reading.noise]]
    for column, noise in enumerate(reading.noise):
        if noise.tails != GAUSSIAN:
            drawn[:, column] = noise.tails.draw((len(drawn),), rng)
    return drawn
