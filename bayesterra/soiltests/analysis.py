"""The posterior of a soil test, and everything that a report shows of it."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr
from numpy.random import Generator, SeedSequence, default_rng
from scipy.optimize import minimize
from scipy.stats import norm

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, check_kind, check_seed
from bayesterra.identifiability.verdicts import STRUCTURAL, Identifiability, identifiability, undetermined
from bayesterra.likelihood.posterior import PriorDraws, draw_cut_prior
from bayesterra.parameters import Parameter
from bayesterra.report.verdicts import Failures, with_failures
from bayesterra.runtime.folders import check_free
from bayesterra.runtime.netcdf import labelled_tree
from bayesterra.runtime.status import job_folder
from bayesterra.sampling import sampler
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.evidence import ensembles_evidence, of_evidence
from bayesterra.sampling.sampler import PRIOR_DRAWS, Progress, Samples, Target, ThinnedDraws, progress_bar, sample, thin
from bayesterra.sampling.summary import parameter_rows, summary_row
from bayesterra.soiltests.checks import PLAN, Fitted, LeftOut, fit, leave_out, none_left_out
from bayesterra.soiltests.posterior import TestPosterior, coordinates, marginal_sd, structural
from bayesterra.soiltests.schema import LEVELS, PATHS, QUANTITIES, STRESSES
from bayesterra.soiltests.study import SoilTest, load_soil_test, write_soil_test
from bayesterra.soiltests.study import soil_test as from_tables
from bayesterra.stats.diagnostics import array_ess, array_r_hat
from bayesterra.study.result import CURVE_QUANTILES as QUANTILES
from bayesterra.study.result import DrawnResult, OriginRecord, labelled_dataset, origin, parameter_dataset

BAND_DRAWS = 1000
GRID = 60
SI_UNITS = {"phi": "rad", "kc": "Pa m/m^n", "kphi": "Pa/m^n"}
"""Units of draws that their dimension does not say in full."""


@dataclass(frozen=True, kw_only=True, repr=False)
class SoilTestResult(DrawnResult):
    """Outcome of a soil test: all that it tells of its soil.

    Attributes
    ----------
    test : what was analysed.
    draws : xarray DataTree with the groups posterior, prior, sample_stats, log_likelihood (by test),
        observed_data and constant_data; SI, radians.
    summary : one row per parameter, then the stress at a typical sinkage or displacement under every plate or
        normal stress; field units.
    least_squares : method, parameter, unit, value, published, posterior_share (of draws below the value).
    identifiability : one row per parameter, as that of a wheel study; moduli as their laws are stated.
    left_out : every test beside its prediction from the others, as in
        :class:`bayesterra.soiltests.checks.LeftOut`; field units.
    bands : quantiles of the mean curve and of a new test, by plate or normal stress, over a grid; field
        units.
    record : versions, seed, settings, verdicts, notes; ``failures`` say what could not be computed, and why.
    """

    TABLES = ("summary", "least_squares", "identifiability", "left_out", "bands")
    RECORD = OriginRecord
    VIEW = "bayesterra.soiltests.page:soil_test"
    ORDER = tuple(QUANTITIES)
    DIGITS = "%.6g"

    test: SoilTest
    least_squares: pd.DataFrame
    identifiability: pd.DataFrame
    left_out: pd.DataFrame
    bands: pd.DataFrame

    def posterior(self) -> TestPosterior:
        """The density that was sampled."""
        return TestPosterior.of(self.test)

    @property
    def sentence(self) -> str:
        """Sentence on what these tests determine."""
        return str(self.record["finding"])

    @property
    def misfit(self) -> str:
        """The check that says most strongly that tests are not as the others predict them; empty without."""
        checks = self.record["checks"] if self.record["alarm"] else {}
        worst = min(checks, key=lambda name: checks[name], default="")
        said = f"tests are not as the others predict them ({worst}: p {checks.get(worst, 1.0):.2g})"
        return said if worst else ""

    def write_inputs(self, part: Path) -> None:
        """Write draws, the soil-test file and its readings."""
        super().write_inputs(part)
        write_soil_test(self.test, part)


def analyse(
    test: SoilTest,
    *,
    seed: int = 1,
    report: Callable[[Progress], None] = lambda progress: None,
    plan: AdaptationOptions = PLAN,
) -> SoilTestResult:
    """Sample the posterior of a loaded test; see :func:`soil_test`. ``plan``: size of the adaptation."""
    started = time.perf_counter()
    posterior = TestPosterior.of(test)
    if not posterior.names:
        raise StudyError("every parameter is fixed: there is nothing to sample")
    sampling, drawing, weighing, predicting, leaving = SeedSequence(seed).spawn(5)
    prior = draw_cut_prior(posterior, PRIOR_DRAWS, default_rng(drawing))
    target = Target(posterior, coordinates(posterior))
    samples = sample(target, test.sampling, sampling, report, adaptation=plan)
    kept = thin(samples.chains)
    failures = Failures(lambda title: report(Progress("checking", 1.0, step=title)))
    left_out = failures.attempt(
        "left_out", lambda: leave_out(posterior, kept.spaced(4 * BAND_DRAWS), leaving), lambda: none_left_out(test.kind)
    )

    def integral() -> dict[str, Any]:
        estimate = ensembles_evidence(target.densities, samples.adaptations, default_rng(weighing))
        return {"evidence": of_evidence(estimate, prior)}

    weighed = failures.attempt("evidence", integral, dict[str, Any])
    fitted = failures.attempt("fits", lambda: fit(test.readings), lambda: Fitted({}, ()))
    return _Parts(test, posterior, prior, samples, kept, left_out, fitted, failures).result(
        seed, weighed, default_rng(predicting), started
    )


@dataclass(frozen=True)
class _Parts:
    """Everything that was found, before it is put into tables; ``failures``: what was not."""

    test: SoilTest
    posterior: TestPosterior
    prior: PriorDraws
    samples: Samples
    kept: ThinnedDraws
    left_out: LeftOut
    fitted: Fitted
    failures: Failures

    def result(self, seed: int, integral: dict[str, Any], rng: Generator, started: float) -> SoilTestResult:
        """Tables, labelled draws and the record."""
        table, told = self._told()
        summary = self._summary()
        bands = self.failures.attempt("bands", lambda: self._bands(rng), lambda: _no_bands(self.test.kind))
        record = {
            **self._origin(seed),
            "verdict": sampler.of_diagnosis(self.samples.diagnosis),
            "sampling": sampler.of_samples(self.samples, self.kept.every),
            **integral,
            "prior_support": {"tried": self.prior.tried, "shares": dict(self.prior.shares)},
            "checks": self.left_out.checks,
            "alarm": None if "left_out" in self.failures else self.left_out.alarm,
            "fits": {"notes": list(self.fitted.notes)},
            **told,
            "seconds": {**self.samples.seconds, "total": time.perf_counter() - started},
        }
        return SoilTestResult(
            test=self.test, draws=self._draws(), summary=summary, least_squares=self._least_squares(),
            identifiability=table, left_out=_in_field_units(self.left_out.table, self.test.kind),
            bands=_in_field_units(bands, self.test.kind), record=with_failures(record, self.failures),
        )  # fmt: skip

    def _told(self) -> tuple[pd.DataFrame, dict[str, Any]]:
        """Verdicts on all parameters, and the record of the directions and of the finding."""
        both = self.failures.attempt("identifiability", self.identifiability, lambda: None)
        if both is None:
            prior, draws = (self.posterior.prior.stated(x) for x in (self.prior.x, self.kept.flat))
            return undetermined(self.posterior.names, prior, draws), {"finding": ""}
        table, whole = both[0].table, both[1]
        said = self.failures.attempt("finding", lambda: finding(self.test, table), str)
        directions = {"determined": whole.determined, "of": len(whole.contractions)}
        return table, {"directions": directions, "finding": said}

    @property
    def soil(self) -> list[str]:
        """Free soil parameters."""
        return [name for name in self.test.soil if name in self.posterior.names]

    def identifiability(self) -> tuple[Identifiability, Identifiability]:
        """Verdicts on all parameters, and the directions of those of the soil."""
        names, laws = self.posterior.names, self.posterior.prior
        ranges = [law.range for law in laws.laws.values()]
        prior, draws = (laws.stated(x) for x in (self.prior.x, self.kept.flat))
        free = np.array([name in names for name in self.test.soil])
        sound = np.ones(len(names), dtype=np.bool_)
        if free.any():
            seen = structural(self.test.readings, self.posterior.soil(self.prior.x[:300]), free)
            sound[: len(self.soil)] = seen[free]
        logs = np.array([law.logarithmic for law in laws.laws.values()])
        table = identifiability(names, ranges, prior, draws, sound, logs)
        soil = slice(0, max(len(self.soil), 1))
        part = (names[soil], ranges[soil], prior[:, soil], draws[:, soil], sound[soil], logs[soil])
        return table, identifiability(*part)

    def _summary(self) -> pd.DataFrame:
        mode, quantities = self._mode(), [QUANTITIES[name] for name in self.posterior.names]
        rows = parameter_rows(quantities, self.kept.chains, self.prior.x, mode, self.samples.diagnosis)

        def stresses() -> list[dict[str, Any]]:
            return [self._stress_row(float(level), mode) for level in np.unique(self.test.readings.levels)]

        return pd.DataFrame(rows + self.failures.attempt("derived", stresses, list[dict[str, Any]]))

    def _stress_row(self, level: float, mode: FloatArray) -> dict[str, Any]:
        """The stress at the typical path under a plate or normal stress, which tests measure directly."""
        kind, path = self.test.kind, float(np.exp(np.median(np.log(self.test.readings.path))))

        def stress(x: FloatArray) -> FloatArray:
            curve = self.test.readings.model.log_stress(self.posterior.soil(x), np.array([path]), np.array([level]))
            return np.asarray(np.exp(curve[:, 0]))

        chains = stress(self.kept.flat).reshape(self.kept.chains.shape[:2])
        sizes = array_ess(chains, "bulk"), array_ess(chains, "tail"), array_r_hat(chains)
        of, symbol = LEVELS[kind], STRESSES[kind].symbol
        name = f"{symbol}({1e3 * path:.3g} mm; {level / of.scale:g} {of.unit})"
        quantity = Parameter(name, name, symbol, "kPa", 1e3, "Pa", "mean stress")
        return summary_row(quantity, chains, stress(self.prior.x), float(stress(mode[None])[0]), sizes)

    def _mode(self) -> FloatArray:
        """Most probable soil parameters, the scatter at its posterior median (as for wheels)."""
        d, draws = len(self.soil), self.kept.spaced(2000)
        held = draws.copy()
        held[:, d:] = np.median(draws[:, d:], axis=0)
        start: FloatArray = held[int(self.posterior.log_density(held).argmax())]
        if not d:
            return start

        def climbed() -> FloatArray:
            factor = np.linalg.cholesky(np.atleast_2d(np.cov(draws[:, :d].T)))

            def at(y: FloatArray) -> FloatArray:
                return np.concatenate([start[:d] + factor @ y, start[d:]])

            def height(y: FloatArray) -> float:
                return float(np.minimum(-self.posterior.log_density(at(y)[None])[0], 1e10))

            options = {"xatol": 1e-4, "fatol": 1e-7, "maxiter": 2000}
            return at(minimize(height, np.zeros(d), method="Nelder-Mead", options=options).x)

        return self.failures.attempt("mode", climbed, lambda: start)

    def _least_squares(self) -> pd.DataFrame:
        reference = self.test.published or self.test.truth
        rows = []
        for method, values in self.fitted.values.items():
            for name in (name for name in self.test.soil if name in values):
                scale = QUANTITIES[name].scale
                published = reference.values.get(name, np.nan) / scale if reference else np.nan
                share = np.nan
                if name in self.posterior.names:
                    share = float((self.kept.flat[:, self.posterior.names.index(name)] < values[name]).mean())
                rows.append((method, name, QUANTITIES[name].unit, values[name] / scale, published, share))
        columns = ["method", "parameter", "unit", "value", "published", "posterior_share"]
        return pd.DataFrame(rows, columns=pd.Index(columns))

    def _bands(self, rng: Generator) -> pd.DataFrame:
        readings, x = self.test.readings, self.kept.spaced(BAND_DRAWS)
        tables = []
        for level in np.unique(readings.level):
            path = readings.path[readings.level == level]
            grid = np.geomspace(path.min(), path.max(), GRID)
            spread = self.posterior.spread(x)
            true = spread.true_path(grid)
            curve = readings.model.log_stress(self.posterior.soil(x), true, np.full(GRID, level))
            # quantiles of a mixture of normal laws, by fixed scores in every draw
            scores = norm.ppf((np.arange(20) + rng.random()) / 20)
            new = curve[:, None] + marginal_sd(grid, spread)[:, None] * scores[:, None]
            scaled = dict(zip(_columns(readings.kind), (np.full(GRID, level), 1e3 * grid), strict=True))
            for name, values in (("curve", curve), ("test", new.reshape(-1, GRID))):
                bands = np.exp(np.quantile(values, QUANTILES, axis=0)) / 1e3
                scaled |= {f"{name}_q{100 * q:02.0f}": row for q, row in zip(QUANTILES, bands, strict=True)}
            tables.append(pd.DataFrame(scaled))
        return pd.concat(tables, ignore_index=True)

    def _draws(self) -> xr.DataTree:
        readings, kept = self.test.readings, self.kept
        shape, flat = kept.chains.shape[:2], kept.flat
        tests = self.posterior.log_likelihoods(flat)
        density = self.posterior.prior.log_density(flat) + tests.sum(axis=1)
        two, names = ("chain", "draw"), self.posterior.names
        path, level, stress = (names[readings.kind].name for names in (PATHS, LEVELS, STRESSES))

        def of_readings(columns: dict[str, Any]) -> xr.Dataset:
            return labelled_dataset({name: (("reading",), values) for name, values in columns.items()})

        groups = {
            "posterior": parameter_dataset(names, kept.chains, QUANTITIES, SI_UNITS),
            "prior": parameter_dataset(names, self.prior.x[None], QUANTITIES, SI_UNITS),
            "sample_stats": labelled_dataset(
                {name: (two, each) for name, each in {"lp": density.reshape(shape), **kept.labels}.items()}
            ),
            "log_likelihood": labelled_dataset({"test": ((*two, "name"), tests.reshape(*shape, -1))}).assign_coords(
                name=list(readings.tests)
            ),
            "observed_data": of_readings({stress: readings.stress}),
            "constant_data": of_readings({path: readings.path, level: readings.level, "number": readings.test}),
        }
        return labelled_tree(groups)

    def _origin(self, seed: int) -> dict[str, Any]:
        content, data = self.test.content, self.test.content.data
        return {
            **origin(content.title, data.kind, data.source, seed, self.test.notes),
            "test": content.test,
            "readings": len(self.test.readings),
            "tests": len(self.test.readings.tests),
            "independent": self.test.independent,
            "settings": asdict(self.test.sampling),
        }


NONE_ALONE = "No soil parameter is determined on its own."
ONE_LEVEL = {
    "plate": "Plates of one radius: only k_c/b + k_φ is determined, at b = ",
    "shear": "One normal stress: only c + σ tan φ is determined, at σ = ",
}


def finding(test: SoilTest, table: pd.DataFrame) -> str:
    """Sentence on what the tests determine: one radius or one stress leaves a sum only."""
    words = dict(zip(table["parameter"], table["verdict"], strict=True))
    of = {
        verdict: ", ".join(QUANTITIES[name].symbol for name in test.soil if words.get(name) == verdict)
        for verdict in ("determined", STRUCTURAL, "coupled")
    }
    alone = f"Determined: {of['determined']}." if of["determined"] else NONE_ALONE
    coupled = f"Coupled: {of['coupled']}." if of["coupled"] else ""
    least, level = float(test.readings.levels.min()), LEVELS[test.kind]
    lost = f"{ONE_LEVEL[test.kind]}{least / level.scale:g} {level.unit}." if of[STRUCTURAL] else ""
    return " ".join(filter(None, (alone, lost, coupled)))


def _columns(kind: str) -> tuple[str, str]:
    """Columns of the bands that say where, SI and field units."""
    return LEVELS[kind].name, f"{PATHS[kind].name} [mm]"


def _no_bands(kind: str) -> pd.DataFrame:
    quantiles = [f"{name}_q{100 * q:02.0f}" for name in ("curve", "test") for q in QUANTILES]
    return pd.DataFrame(columns=[*_columns(kind), *quantiles], dtype=float)


def _in_field_units(table: pd.DataFrame, kind: str) -> pd.DataFrame:
    name, unit, scale = LEVELS[kind].name, LEVELS[kind].unit, LEVELS[kind].scale
    return table.assign(**{name: table[name] / scale}).rename(columns={name: f"{name} [{unit}]"})


def soil_test(
    test: SoilTest | str | Path | None = None,
    *,
    data: pd.DataFrame | None = None,
    seed: int = 1,
    progress: Callable[[Progress], None] = lambda update: None,
    **tables: Any,
) -> SoilTestResult:
    """Sample what plate or shear tests tell of their soil, and set it beside least squares.

    Parameters
    ----------
    test : a soil-test file, the folder of one, or a loaded test.
    data : in place of a file: readings with units in the headers; further keywords are then the tables of the
        file (``kind="plate"``, ``priors``, ``noise``, ...), with numbers in SI, and options of [data] by
        name.
    seed : same seed, same draws on one machine.
    progress : called as the sampling goes on.

    Raises
    ------
    StudyError : something in the file or the tables cannot be used as it stands.
    SupportError : the prior leaves no physical parameter set.
    """
    if data is not None:
        check_kind("bt.soil_test", data, pd.DataFrame)
        content = dict(tables)
        options = ("source", "pressure_range", "displacement_range", "spacing")
        rows = {"file": "readings.csv", **{name: content.pop(name) for name in options if name in content}}
        test = from_tables(data, {"test": content.pop("kind", None), "data": rows, **content})
    elif isinstance(test, str | Path):
        test = load_soil_test(test)
    if test is None or (tables and data is None):
        raise TypeError("soil_test() takes a file, a loaded test, or data with its tables")
    check_kind("bt.soil_test", test, SoilTest)
    check_seed(seed)
    return analyse(test, seed=seed, report=progress)


def soil_test_into(
    file: Path, out: Path, *, seed: int = 1, overwrite: bool = False, quiet: bool = False
) -> SoilTestResult:
    """Analyse a soil-test file into a new folder, which appears whole or not at all.

    Raises
    ------
    StudyError : something in the file cannot be used as it stands.
    ResultError : the folder exists (and ``overwrite`` is not given) or cannot be written.
    """
    test = load_soil_test(file)
    check_free(out, overwrite=overwrite)
    with job_folder(out, overwrite=overwrite) as (part, status):
        with progress_bar(status, quiet=quiet) as update:
            update(Progress("reading", 0.0))
            result = soil_test(test, seed=seed, progress=update)
            update(Progress("writing the report", 1.0))
        return result.write(part)
