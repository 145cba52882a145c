"""Log: time series of a drive or a plate test, read from a file and brought to SI units."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from bayesterra.arrays import FloatArray
from bayesterra.errors import StudyError, errors_in
from bayesterra.parameters import CHANNELS, OUTCOMES, Channel, quantities
from bayesterra.runtime.reading import MEGABYTE
from bayesterra.stats.diagnostics import error_of_mean
from bayesterra.study.observations import Heading, headings, labels, named_columns, read_table, unit_scale
from bayesterra.study.units import known_column

Kind = Literal["measured", "digitised", "simulated"]
MOST_LOG, MOST_SAMPLES = 256 * MEGABYTE, 2_000_000
FEWEST = 20
"""Samples, at least, of a log."""

LOGGED = {**CHANNELS, **quantities("logs", Channel)}
"""Channels of logs."""
OFFSET = ("load", *OUTCOMES[1:], "force", "pressure")
"""Channels that have an offset, which a zero record tells."""


@dataclass(frozen=True)
class Log:
    """Time series of one file."""

    name: str  # of the file
    values: Mapping[str, FloatArray]  # samples (m,) by channel of ``LOGGED``, SI; NaN where there is no reading
    test: tuple[str, ...]  # name of the test of every sample (m,), where the file has several; else empty
    kind: Kind  # ``measured``, ``digitised`` or ``simulated``
    headings: tuple[Heading, ...]  # how every column was understood
    form: str  # of the file
    zeros: Mapping[str, tuple[float, float]]  # offset that was subtracted and its standard error, by channel, SI

    def __len__(self) -> int:
        return len(next(iter(self.values.values())))

    def without_offsets(self, record: "Log") -> "Log":
        """The log minus the means of a zero record, of the channels that both have and that have an offset."""
        both = [name for name in OFFSET if name in self.values and name in record.values]
        if not both:
            known = ", ".join(OFFSET)
            raise StudyError(f"zero record '{record.name}' has no channel of '{self.name}' with an offset ({known})")
        for name in both:
            if (count := int(np.isfinite(record.values[name]).sum())) < FEWEST:
                least = f"at least {FEWEST} readings of '{name}' (got {count})"
                raise StudyError(f"zero record '{record.name}' must hold {least}")
        zeros = {name: mean_and_error(record.values[name]) for name in both}
        return replace(self, values={**self.values, **{n: self.values[n] - zeros[n][0] for n in both}}, zeros=zeros)

    def tests(self) -> "Iterator[Log]":
        """The log by tests; itself where it has one only."""
        if not self.test:
            yield self
        codes = np.array(self.test, dtype=object)
        for name in dict.fromkeys(self.test):
            mine = codes == name
            yield replace(self, name=name, test=(), values=_read({k: v[mine] for k, v in self.values.items()}))


def mean_and_error(samples: FloatArray, blocks: int = 20) -> tuple[float, float]:
    """Mean of the samples that are there, and its standard error from the means of blocks."""
    there = samples[~np.isnan(samples)]
    means = np.array([part.mean() for part in np.array_split(there, blocks)])
    return float(there.mean()), error_of_mean(means)


def read_log(path: Path, *, kind: Kind = "measured", sheet: str = "", decimal: str | None = None) -> Log:
    """Read a log; a file that calls itself simulated, in a header or a cell beside the numbers, is taken so.

    StudyError is one line that begins with the file: what is wrong and what to do.
    """
    with errors_in(path):
        table = _with_units(read_table(path, sheet, decimal, size=MOST_LOG, rows=MOST_SAMPLES))
        mine = [known_column(str(header), [*LOGGED, "test"])[0] for header in table.columns]
        chosen = table.loc[:, [name in LOGGED or name == "test" for name in mine]]
        columns = named_columns(chosen, _scale, [*LOGGED, "test"])
        values = _read({name: column.si() for name, column in columns.items() if name != "test"})
        if not values or len(table) < FEWEST:
            got = f"{len(table)} rows of {', '.join(columns) or 'none'}"
            raise StudyError(f"must hold at least {FEWEST} samples of known channels (got {got})")
        names = labels(columns["test"]) if "test" in columns else ()
        form = str(table.attrs["form"])
        aside = table.drop(columns=chosen.columns).iloc[0]
        said = " ".join(map(str, [path.name, *table.columns, *aside])).casefold()
        log = Log(
            path.name, values, names, "simulated" if "simulated" in said else kind, headings(table, columns), form, {}
        )
        return _in_order(log)


def _read(values: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """The channels that have a reading."""
    return {name: samples for name, samples in values.items() if not np.isnan(samples).all()}


def _with_units(table: pd.DataFrame) -> pd.DataFrame:
    """The table with dates as seconds from the first one, and SI units where headers of a bag have none."""
    headers = list(map(str, table.columns))
    for position, header in enumerate(headers):
        name, unit = known_column(header, LOGGED)
        cells = table.iloc[:, position]
        if name == "time" and isinstance(cells.iloc[0], str) and ":" in cells.iloc[0]:
            moments = pd.to_datetime(cells, format="ISO8601", utc=True, errors="coerce")
            seconds = (moments - moments.iloc[0]) if moments.notna().all() else pd.to_timedelta(cells, errors="coerce")
            if seconds.isna().any():
                known = "seconds, dates as 2021-03-16T17:11:02.5 or times of day as 17:11:02.5"
                raise StudyError(f"column '{header}' must hold {known} (got {cells.iloc[0]!r}, row 1)")
            table.isetitem(position, (seconds - seconds.iloc[0]).dt.total_seconds().to_numpy())
            headers[position] = f"{header} [s]" if unit is None else "time [s]"
        elif name in LOGGED and unit is None and table.attrs["form"] == "ROS bag":
            headers[position] = f"{header} [{LOGGED[name].dimension}]"
    return table.set_axis(headers, axis="columns")


def _scale(header: str, name: str, unit: str | None) -> float:
    return unit_scale(header, name, unit, LOGGED[name]) if name in LOGGED else 1.0


def _in_order(log: Log) -> Log:
    """The log from its first to its last time; StudyError where its clock runs backwards."""
    if "time" not in log.values:
        return log
    time = log.values["time"]
    there = ~np.isnan(time)
    if (back := np.diff(time[there]) < 0).any():
        row = int(np.flatnonzero(there)[int(np.argmax(back)) + 1]) + 1
        raise StudyError(f"'time' must not run backwards (it does in row {row}): sort the log, or cut it there")
    names = tuple(name for name, keep in zip(log.test, there, strict=True) if keep) if log.test else ()
    return replace(log, values={name: column[there] for name, column in log.values.items()}, test=names)
