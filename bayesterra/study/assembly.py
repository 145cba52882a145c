"""The parts of a study put together: prior, wheels, what the drive conditions on, noise of the outcomes."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from bayesterra import parameters
from bayesterra.arrays import FloatArray, frozen
from bayesterra.errors import StudyError, errors_after, known
from bayesterra.models import MODELS, ForwardModel, OwnModel, Soil, Wheel
from bayesterra.stats.dependence import MixtureCopula
from bayesterra.stats.laws import Law
from bayesterra.study.drive import Drive
from bayesterra.study.entries import StatedPriors, prior_set
from bayesterra.study.model_errors import ModelErrors
from bayesterra.study.noise import Noise
from bayesterra.study.observations import Observations, sifted
from bayesterra.study.priors import Entry, Prior, Tie
from bayesterra.study.schema import ModelOptions, WheelTable
from bayesterra.study.soil_tests import EXAMPLES, SoilTest, check_above

if TYPE_CHECKING:
    from bayesterra.study.previous import PosteriorPrior


DEFAULT_PRIOR_SET = "paper-box"
_ANY_SOIL = {"Ks": 1e6, "n0": 1.0, "n1": 0.0, "c": 0.0, "phi": 0.5, "K": 0.01, "c1": 0.5, "c2": 0.0}

LOAD_EFFECT_MODEL = "M2L"
HELD_UNDER_LOAD = {"c1": 0.5, "c2": 0.0, **parameters.HELD}
"""Contact angles that Ding et al. 2015 hold where the load effect is identified, (42)."""

LOAD_MARGIN = 6.0
"""Standard deviations by which the range of a latent load reaches beyond the measured normal forces."""

SoilPrior = dict[str, Entry]


@dataclass(frozen=True)
class StatedSoil:
    """Prior of the soil parameters as a study states it."""

    entries: SoilPrior  # laws, fixed values and ties of all soil parameters
    correlation: Mapping[str, float]  # of normal scores, by pair
    mixtures: Mapping[str, MixtureCopula]  # of normal scores, by parameters
    taken: "tuple[PosteriorPrior, ...]"  # joint laws from earlier results, whose single laws stand among the entries
    notes: tuple[str, ...]  # what was filled in, and what to keep in mind
    reference: float = 1.0  # sinkage (m) with which laws of the moduli are stated, as of ``Prior``
    exponent: str = "n"  # name of the exponent there


def soil_prior(
    stated: StatedPriors, model: str | OwnModel, *, constant_exponent: bool, wheels: bool = True
) -> StatedSoil:
    """Laws, fixed values and ties of all soil parameters, and notes on what was filled in.

    Parameters
    ----------
    stated : the [priors] table.
    model : its parameters are needed; with M2L c1, c2, c3 are held unless they are given.
    constant_exponent : N = n0, so n1 is held at 0.
    wheels : whether there is a wheel; without one nothing is filled in.

    Raises
    ------
    StudyError : a fixed value outside the set's range or the physical one; n1 beside a constant exponent; k_c
        without k_φ, or beside K_s; an earlier result that gives no prior, or what is given already; the load
        effect with a model that does not know it.
    """
    entries: SoilPrior = dict(stated.entries)
    if constant_exponent and entries.setdefault("n1", 0.0) != 0.0:
        raise StudyError("[priors] 'n1' must be left out or 0, as 'constant_exponent' holds it at 0")
    idle = {"n1"} if constant_exponent else set()
    earlier = _taken(stated, entries, idle if model == LOAD_EFFECT_MODEL else {*idle, *parameters.LOAD_EFFECT})
    notes = [note for prior in earlier for note in prior.notes]
    correlation, mixtures = dict(stated.correlation), dict(stated.mixtures)
    for prior in earlier:
        _add(entries, prior.laws, "'{}' is given and taken from {}", prior.label)
        joint = {} if prior.mixture is None else {", ".join(prior.laws): prior.mixture}
        _add(mixtures, joint, "mixture of '{}' is given and taken from {}", prior.label)
        pairs = prior.correlation if prior.mixture is None else {}
        _add(correlation, pairs, "correlation of '{}' is given and taken from {}", prior.label)
    if not wheels:
        return StatedSoil(entries, correlation, mixtures, earlier, tuple(notes))
    notes += _load_effect(entries, model)
    needed = _needed(entries, model)
    missing = [name for name in needed if name not in entries and name not in parameters.HELD]
    if missing and stated.chosen is None:
        notes.append(f"prior set '{DEFAULT_PRIOR_SET}' taken for {', '.join(missing)}, as no set is named")
    chosen = stated.chosen or (DEFAULT_PRIOR_SET if missing else None)
    taken: SoilPrior = {**prior_set(chosen), **prior_set(chosen, load_effect=True)} if chosen else {}
    _check_fixed({n: v for n, v in entries.items() if isinstance(v, int | float)}, taken, chosen)
    from_set = {name: entry for name, entry in taken.items() if name in needed}
    held = {name: value for name, value in parameters.HELD.items() if name in needed}
    return StatedSoil({**held, **from_set, **entries}, correlation, mixtures, earlier, tuple(notes))


def _needed(entries: SoilPrior, model: str | OwnModel) -> tuple[str, ...]:
    """Parameters that the wheels' model reads, k_c and k_φ in place of K_s where they are given.

    A parameter that one's own model brings along is flat over its range where it has no entry.
    """
    names = MODELS[model].parameters if isinstance(model, str) else model.parameters
    stiffness = _stiffness(entries)
    needed = tuple(each for name in names for each in (stiffness if name == "Ks" else (name,)))
    if isinstance(model, str):
        return needed
    for name in entries:
        if name not in needed and name != parameters.OFFSET and not parameters.of_soil_tests(name):
            raise StudyError(
                f"[priors] '{name}' is no parameter of the model {model.name} (it has {', '.join(names)}): leave it out"
            )
    for name in (name for name in model.own if name not in entries):
        low, high = model.ranges[name]
        if not np.isfinite([low, high]).all():
            raise StudyError(f"[priors] needs '{name}', as the model {model.name} states no range for it")
        entries[name] = Law("uniform", lower=low, upper=high, source=f"flat on its range in the model {model.name}")
    return needed


def _taken(stated: StatedPriors, entries: SoilPrior, idle: set[str]) -> "tuple[PosteriorPrior, ...]":
    """Joint laws from earlier results of what has use for them: not of the ``idle`` parameters."""
    if not stated.sources:
        return ()
    from bayesterra.study.previous import taken  # brings ArviZ along, which most studies need not wait for

    moduli = any(name in entries for name in parameters.MODULI)
    other = {"Ks"} if moduli else set(parameters.MODULI) if "Ks" in entries else set[str]()
    other |= {parameters.OFFSET, *idle}  # a zero error is that of its own test
    names = tuple(name for name in parameters.PRIOR_PARAMETERS if name not in other)
    tied = {name for pair in stated.correlation for name in pair.split(", ")}
    with errors_after("[priors.from] "):
        return tuple(taken(source, names, tied) for source in stated.sources)


def _add(into: dict[str, Any], additions: Mapping[str, Any], rule: str, label: str) -> None:
    """Add what nothing else gives; StudyError where something does."""
    for name, value in additions.items():
        if name in into:
            raise StudyError(f"[priors] {rule.format(name, label)}: leave one of them out")
        into[name] = value


def _load_effect(entries: SoilPrior, model: str | OwnModel) -> list[str]:
    """Hold what (42) holds where the model is that of the load effect, with a note."""
    if isinstance(model, OwnModel):
        return []
    if model != LOAD_EFFECT_MODEL:
        coefficient = next((name for name in parameters.LOAD_EFFECT if name in entries), None)
        if coefficient:
            raise StudyError(
                f"[priors] '{coefficient}' belongs to the load effect of the model '{LOAD_EFFECT_MODEL}'"
                f" (got model '{model}'): leave it out, or set model = \"{LOAD_EFFECT_MODEL}\""
            )
        return []
    held = {name: value for name, value in HELD_UNDER_LOAD.items() if name not in entries}
    entries.update(held)
    shown = ", ".join(f"{name} = {value:g}" for name, value in held.items() if name not in parameters.HELD)
    return [f"{shown} held, as in (42); an entry in [priors] frees them"] if shown else []


def forward_model(name: str | OwnModel, options: ModelOptions, rows: Observations) -> tuple[ForwardModel, list[str]]:
    """The model with its options; M2L without a mean load takes the mean load of all rows, and notes it.

    StudyError for a mean load that the model does not know, or none known, and options outside their ranges.
    """
    if isinstance(name, OwnModel):
        if options != ModelOptions():
            raise StudyError(
                "[model_options] belong to the models of Ding et al. 2015: what makes another stands beside its"
                " 'use' in [model]"
            )
        return name, []
    arguments, notes = asdict(options), []
    mean = arguments.pop("mean_load")
    if name != LOAD_EFFECT_MODEL and mean is not None:
        raise StudyError(f"[model_options] 'mean_load' belongs to the model '{LOAD_EFFECT_MODEL}' (got '{name}')")
    if name == LOAD_EFFECT_MODEL:
        if mean is None:
            if np.isnan(rows.carried).all():
                raise StudyError(
                    f"[model_options] 'mean_load' must be given with the model '{LOAD_EFFECT_MODEL}', as no"
                    " row has a load"
                )
            mean = float(np.nanmean(rows.carried))
            notes.append(f"mean load per wheel W̄ = {mean:.6g} N, the mean of all rows, as none is given")
        arguments["mean_load"] = mean
    with errors_after("[model_options] "):
        return MODELS[name](**arguments), notes


def _stiffness(entries: Mapping[str, Entry]) -> tuple[str, ...]:
    """K_s, or k_c and k_φ in its place."""
    moduli = [name for name in parameters.MODULI if name in entries]
    if not moduli:
        return ("Ks",)
    if "Ks" in entries:
        raise StudyError(f"[priors] '{moduli[0]}' stands in place of 'Ks': give either")
    if len(moduli) == 1:
        other = next(name for name in parameters.MODULI if name not in moduli)
        raise StudyError(f"[priors] '{moduli[0]}' needs '{other}' beside it, as K_s = kc/b + kphi")
    return parameters.MODULI


def with_soil_tests(
    soil: StatedSoil, stated: StatedPriors, tests: Mapping[str, SoilTest], *, wheels: bool
) -> StatedSoil:
    """The prior with the scatter of soil tests, checked to hold all that these read and nothing idle.

    StudyError where a parameter of a test has no prior, or one is read by nothing; laws of moduli are stated at a
    sinkage whose exponent is not that of the plates, or of the wheel.
    """
    read = {name: own for test in tests.values() for own, name in test.names.items() if name not in test.scatter}
    for name, own in read.items():
        if name not in soil.entries:
            key = f'"{name}"' if "." in name else name
            raise StudyError(f"[priors] needs '{name}', e.g. {key} = {EXAMPLES[own]}")
        if own == "K":
            check_above(f"[priors] '{name}'", soil.entries[name])
    goals = {entry.to for entry in soil.entries.values() if isinstance(entry, Tie)}
    for name in soil.entries:
        if name not in (*read, *goals) and (not wheels or parameters.of_soil_tests(name)):
            known("parameter", name, read, "[priors] no wheel or soil test of this study reads it: ")
    scatter = {name: entry for test in tests.values() for name, entry in test.scatter.items()}
    exponents = [test.names["n"] for test in tests.values() if test.kind == "plate"]
    if stated.reference == 1.0:
        return replace(soil, entries={**soil.entries, **scatter})
    named = (*parameters.MODULI, *exponents[:1])
    if not exponents or any(not isinstance(soil.entries.get(name), Law) or name not in read for name in named):
        raise StudyError("[priors] 'reference_sinkage' goes with plate tests whose kc, kphi and n all have laws")
    if any(name in prior.laws for prior in soil.taken for name in named):
        raise StudyError(
            "[priors] 'reference_sinkage' is for stated laws: leave it out where 'from' gives kc, kphi or n"
        )
    if wheels and exponents[0] != "n0":
        raise StudyError("[priors] 'reference_sinkage' with wheels needs 'tie = { n = \"n0\" }' in [soil_tests]")
    return replace(soil, entries={**soil.entries, **scatter}, reference=stated.reference, exponent=exponents[0])


def full_prior(
    soil: StatedSoil,
    noise: Mapping[str, Noise],
    errors: ModelErrors,
    wheels: Mapping[str, Wheel],
    reads: tuple[str, ...] = parameters.SOIL_PARAMETERS,
) -> Prior:
    """The prior of all parameters; soil arrays hold the K_s of the first wheel."""
    estimated = {entry.parameter: entry.law for entry in noise.values() if entry.parameter and entry.law}
    entries, width = {**soil.entries, **estimated, **errors.laws}, next((w.width for w in wheels.values()), np.nan)
    rest = (soil.correlation, soil.mixtures, soil.reference, soil.exponent, reads if wheels else ())
    with errors_after("[priors] "):
        return Prior(entries, width, *rest)


def _check_fixed(fixed: Mapping[str, float], prior_set: Mapping[str, Entry], chosen: str | None) -> None:
    for name, value in fixed.items():
        law = prior_set.get(name)
        if isinstance(law, Law) and not law.range[0] <= value <= law.range[1]:
            shown = parameters.PARAMETERS[name].field_text
            inside = f"{shown(law.range[0])} to {shown(law.range[1])}"
            raise StudyError(
                f"[priors] '{name}' must be fixed inside the range of '{chosen}', {inside} (got {shown(value)})"
            )
    with errors_after("[priors] "):
        Soil(**{**_ANY_SOIL, **{name: value for name, value in fixed.items() if name in parameters.SOIL_PARAMETERS}})


def resolved_wheels(tables: Mapping[str, WheelTable], phi: Entry | None) -> tuple[dict[str, Wheel], list[str]]:
    """Wheels by name; a coefficient that is left out comes, once, from (2) at the prior median of phi.

    Without ``phi``, where the model has none, of 30°.
    """
    if not tables:
        raise StudyError("[wheels] needs at least one wheel, e.g. [wheels.Wh1]")
    if isinstance(phi, Tie):
        raise StudyError("[priors] 'phi' must not be tied: it is the only angle")
    at = np.pi / 6 if phi is None else phi.median if isinstance(phi, Law) else float(phi)
    wheels, notes = {}, []
    for name, table in tables.items():
        with errors_after(f"[wheels.{name}] "):
            wheel = Wheel(**asdict(table))
            wheels[name] = with_coefficient(wheel, at)
        if wheels[name] != wheel:
            value = wheels[name].shearing_radius_coefficient
            notes.append(f"shearing-radius coefficient of {name} from (2) at φ = {np.degrees(at):.3g}°: {value:.4g}")
    return wheels, notes


def with_coefficient(wheel: Wheel, phi: float) -> Wheel:
    """The same wheel with its shearing-radius coefficient, by (2) at ``phi`` (rad) where none is given."""
    if wheel.lug_height == 0 or wheel.shearing_radius_coefficient is not None:
        return wheel
    coefficient = (float(wheel.shearing_radius(phi)) - wheel.radius) / wheel.lug_height
    return replace(wheel, shearing_radius_coefficient=coefficient)


def conditioned(observations: Observations, drive: Drive, *, expected: bool = False) -> tuple[Observations, list[str]]:
    """Rows with what the drive conditions on in place, and notes on columns that stand in or stand idle.

    With drive ``load`` and no load, the normal force is the load; with drive ``sinkage`` and no normal
    force, the load is the measured normal force; with drive ``both`` likewise, and nothing is conditioned on
    but slip. Where readings are only ``expected``, a row needs none.
    """
    notes: list[str] = []
    has_load, has_force = not np.isnan(observations.load).all(), "normal_force" in observations.values
    if not drive.reads_force and has_force and not has_load:
        observations = replace(observations, load=observations.values["normal_force"])
        notes.append("no load column: the measured normal force is the load")
    elif not drive.reads_force and has_force:
        notes.append(f"normal_force is not used, as the drive '{drive}' conditions on the load")
    elif drive.reads_force and has_load and not has_force:
        sd = observations.given_sd.get("load", np.full(len(observations), np.nan))
        values = {**observations.values, "normal_force": observations.load}
        observations = replace(observations, values=values, given_sd={**observations.given_sd, "normal_force": sd})
        notes.append("no normal_force column: the load is the measured normal force")
    elif drive.reads_force and has_load:
        why = "infers it from the readings" if drive.latent_load else "conditions on the sinkage"
        notes.append(f"load is not used, as the drive '{drive}' {why}")
    if not drive.reads_force and not np.isnan(observations.given_sd.get("load", np.nan)).all():
        notes.append(f"load_sd is not used, as the drive '{drive}' takes loads as exact")
    if not drive.latent_load:
        ((channel, given),) = drive.conditioned(observations).items()
        if np.isnan(given).all():
            raise StudyError(f"the drive '{drive}' needs a column {drive.needed} with values")
        problems = [_condition_problem(channel, v, row) for v, row in zip(given, observations.rows, strict=True)]
        return sifted(observations, problems), notes
    return observations if expected else _with_readings(observations, drive), notes


def _with_readings(observations: Observations, drive: Drive) -> Observations:
    """The rows, of which every one in use must say something on its load: sinkage, normal force or both."""
    none = np.full(len(observations), np.nan)
    sinkage, force = (observations.values.get(name, none) for name in ("sinkage", "normal_force"))
    silent = np.isnan(sinkage) & np.isnan(force)
    rule = f"with the drive '{drive}' every row needs {drive.needed}"
    problems = [f"{rule} (row {r})" if s else None for r, s in zip(observations.rows, silent, strict=True)]
    return sifted(observations, problems)


def load_range(
    observations: Observations, noise: Mapping[str, Noise], stated: tuple[float, float] | None, drive: Drive
) -> tuple[tuple[float, float] | None, list[str]]:
    """Range (N) of the flat prior of a latent load, and a note on it; None where the load is no unknown.

    StudyError where no range is given and no normal force measured.
    """
    if not drive.latent_load:
        return None, [] if stated is None else [f"load_range is not used with the drive '{drive}'"]
    if stated is not None:
        return stated, []
    used = observations.used()
    force = used.values.get("normal_force", np.full(len(used), np.nan))
    if "normal_force" not in noise or np.isnan(force).all():
        raise StudyError(f"the drive '{drive}' needs 'load_range' or readings of 'normal_force'")
    if used.limited("normal_force").any():
        raise StudyError(f"the drive '{drive}' needs 'load_range' where a normal force is known by a limit")
    margin = LOAD_MARGIN * reading_sd(noise["normal_force"], force, used.given_sd["normal_force"])
    low = max(float(np.nanmin(force - margin)), 0.01 * float(np.nanmax(force)))
    high = float(np.nanmax(force + margin))
    note = f"loads: flat prior from {low:.4g} to {high:.4g} N, the normal forces and six sd of noise"
    return (low, high), [note]


def _condition_problem(channel: str, value: float, row: int) -> str | None:
    if value > 0:
        return None
    rule = f"'{channel}' must be above 0 in every row, as the drive conditions on it"
    if np.isnan(value):
        return f"{rule} (empty in row {row})"
    unit = {"sinkage": "m from the rim"}.get(channel, parameters.CHANNELS[channel].dimension)
    return f"{rule} (got {value:g} {unit}, row {row})"


def outcome_noise(
    observations: Observations, stated: Mapping[str, Noise], drive: Drive, *, expected: bool = False
) -> tuple[dict[str, Noise], list[str]]:
    """Noise of every outcome measured in a row in use, and notes on noise that is not used.

    With ``expected`` an outcome that is yet to be measured, but has noise, counts as measured.

    Raises
    ------
    StudyError : no outcome is measured, an outcome has no noise, or a sinkage is negative beyond its noise.
    """
    used = observations.used()
    stated = _renamed(stated, drive)
    measured = [
        name
        for name in drive.outcomes
        if (name in used.values and not np.isnan(used.values[name]).all()) or (expected and name in stated)
    ]
    if not measured:
        outcomes = ", ".join(drive.outcomes)
        if expected:
            raise StudyError(f"[noise] needs an entry for at least one of {outcomes}, which are yet to be measured")
        rule = f"the rows in use must hold at least one reading of {outcomes}"
        raise StudyError(f"{rule} (before that: run --prior-only)")
    noise = {name: _channel_noise(name, stated.get(name), observations) for name in measured}
    if "sinkage" in noise:
        _check_negative_sinkage(used, noise["sinkage"])
    reason = {True: f"the drive '{drive}' conditions on it", False: "it is not measured"}
    idle = ("slip", *drive.idle)
    return noise, [f"noise of {n} is not used, as {reason[n in idle]}" for n in stated if n not in noise]


def errors_of_outcomes(
    errors: ModelErrors, noise: Mapping[str, Noise], rows: Observations, drive: Drive
) -> tuple[ModelErrors, list[str]]:
    """Discrepancy, ripple and slip errors of the measured outcomes, and notes on what to keep in mind."""
    if not errors:
        return errors, []
    for channel, entry in noise.items():
        try:
            _ = entry.tails.parts
        except ValueError as error:
            raise StudyError(f"beside errors that tie rows, residuals of '{channel}' {error}") from error
    tables = {"discrepancy": errors.discrepancy, "ripple": errors.ripple}
    notes = [
        f"{name} of {channel} is not used, as it is not a measured outcome of the drive '{drive}'"
        for name, part in tables.items()
        for channel in part
        if channel not in noise
    ]
    return errors.of(tuple(noise)), notes + (_several_loads(rows, drive) if errors.discrepancy else [])


def check_limits(rows: Observations, noise: Mapping[str, Noise], drive: Drive) -> tuple[Observations, list[str]]:
    """Rows with the limits of measured outcomes only, and notes on readings known by a limit.

    StudyError where such a reading is conditioned on.
    """
    notes = []
    for name in rows.limits:
        limited = rows.limited(name) & rows.use
        where = f"row{'s' if limited.sum() > 1 else ''} {', '.join(map(str, np.array(rows.rows)[limited]))}"
        if not limited.any():
            continue
        if name not in noise and name in (*drive.conditioned(rows), "normal_force"):
            raise StudyError(f"'{name}' must be a number where the drive conditions on it (a limit in {where})")
        if name in noise:
            notes.append(f"{name} is known to lie below or above a limit only in {where}")
    return replace(rows, limits={name: ends for name, ends in rows.limits.items() if name in noise}), notes


def _several_loads(rows: Observations, drive: Drive) -> list[str]:
    """A note where one curve of discrepancy stands for several loads."""
    used = rows.used()
    for wheel in dict.fromkeys(used.wheel):
        loads = used.load[[name == wheel for name in used.wheel]]
        if not drive.by_sinkage and np.ptp(loads) > 0.1 * np.mean(loads):
            ends = f"{loads.min():.4g} to {loads.max():.4g} N"
            return [f"the discrepancy of {wheel} is one curve over slip for all of its loads, {ends}"]
    return []


def awaited(observations: Observations, noise: Mapping[str, Noise], drive: Drive) -> Observations:
    """The same rows with an empty column for every outcome that has noise and no column."""
    empty = frozen(np.full(len(observations), np.nan))
    missing = [n for n in drive.outcomes if n in _renamed(noise, drive) and n not in observations.values]
    return replace(
        observations,
        values={**observations.values, **dict.fromkeys(missing, empty)},
        given_sd={**observations.given_sd, **dict.fromkeys(missing, empty)},
    )


def _renamed(stated: Mapping[str, Noise], drive: Drive) -> dict[str, Noise]:
    """With drives ``sinkage`` and ``both``, noise of the load is that of the normal force it stands for."""
    if drive.reads_force and "load" in stated and "normal_force" not in stated:
        rest = {name: noise for name, noise in stated.items() if name != "load"}
        return {**rest, "normal_force": replace(stated["load"], channel="normal_force")}
    return dict(stated)


def _channel_noise(name: str, stated: Noise | None, observations: Observations) -> Noise:
    if stated is not None:
        return stated
    sd = observations.given_sd[name][~np.isnan(observations.values[name])]
    if np.isnan(sd).any():
        example = f'{name} = "1 {parameters.CHANNELS[name].unit}"'
        raise StudyError(f"[noise] needs an entry for the measured channel '{name}', e.g. {example}")
    return Noise(name, sd=float(np.median(sd)))  # overridden by the table in every row that has a reading


def reading_sd(noise: Noise, values: FloatArray, sd: FloatArray) -> FloatArray:
    """Standard deviations (m,) of readings, before any model: estimated noise at its upper 97.5 % point."""
    estimated = None if noise.law is None else np.array([float(noise.law.quantile(np.array(0.975)))])
    scale: FloatArray = np.broadcast_to(noise.scale(values[None, :], estimated, sd), (1, len(values)))[0]
    return scale


def _check_negative_sinkage(used: Observations, noise: Noise) -> None:
    sinkage = used.values["sinkage"]
    wrong = sinkage < -3 * reading_sd(noise, sinkage, used.given_sd["sinkage"])
    if wrong.any():
        index = int(np.argmax(wrong))
        raise StudyError(
            "'sinkage' must not be negative by more than three standard deviations of its noise"
            f" (got {sinkage[index]:g} m from the rim, row {used.rows[index]})"
        )
