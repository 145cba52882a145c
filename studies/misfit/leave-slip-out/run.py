"""Readings at slips that the fit has not seen: M1, M2 and M3 beside regressions that know no terramechanics.

Run it with ``python studies/misfit/leave-slip-out/run.py [PART ...]``; it takes about a quarter of an hour on
two cores. PART is one of ``measured``, ``simulated``, ``exact``, ``quick``, ``figure``, ``tables``, ``statements``;
without, all of them.
scores.csv, refits.csv and simulated.csv go on where they end; remove them to start anew.
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.random import Generator, default_rng

import bayesterra as bt
from bayesterra.arrays import FloatArray
from bayesterra.checking.calibration import replicated
from bayesterra.checking.folds import levels, predictives
from bayesterra.checking.holdout import leave_out
from bayesterra.checking.holdout_page import all_left_out
from bayesterra.checking.holdout_scores import BASELINES, clustered, skills, summarise
from bayesterra.checking.short_runs import ShortRuns
from bayesterra.likelihood.posterior import posterior
from bayesterra.report.figures import white_png

HERE = Path(__file__).parent
sys.path.append(str(HERE.parents[1] / "support"))

from readme import filled  # noqa: E402
from shipped import FILES  # noqa: E402
from stored import append, done  # noqa: E402

ESTIMATED = {
    'sinkage = "0.55 mm"': 'sinkage = { estimate = { dist = "halfnorm", scale = "3 mm", lower = "0.3 mm" } }',
    'drawbar_pull = "0.34 N"': ('drawbar_pull = { estimate = { dist = "halfnorm", scale = "1 N", lower = "0.2 N" } }'),
}
"""The noise of sinkage and pull as unknowns, which can take model error in."""
ESTIMATED_NAME = "M1, noise estimated"
CASES = [
    ("cmu-grouser", "M1", "M1", {}),
    ("hit-wh32", "M1", "M1", {}),
    ("cmu-grouser-wide", "M1", "M1", {}),
    *(("hit-wh32", model, model, {}) for model in ("M2", "M3")),
    *(("cmu-grouser", model, model, {}) for model in ("M2", "M3")),
    ("cmu-grouser", "M1", ESTIMATED_NAME, ESTIMATED),
    *(("cmu-grouser-wide", model, model, {}) for model in ("M2", "M3")),
    ("cmu-grouser-wide", "M1", ESTIMATED_NAME, ESTIMATED),
]
"""Study, model, its name in the tables, and changes to the study file."""
TABLES = 6
"""Simulated tables, each of another soil of the prior."""
EXACT_TABLES = 100
HELD = 'Ks = "2499.3 kPa"\nn0 = 0.849\nn1 = 1.063\nc = "0.268 kPa"\nK = "10.1 mm"\nc1 = 0.339\nc2 = -0.017'
"""The other parameters where φ alone is unknown: Ding et al. 2015, Table 10, wheel Wh32."""


def study(name: str, model: str = "M1", changes: Mapping[str, str] | None = None) -> bt.Study:
    """A shipped study with another model and other lines in its file."""
    path = FILES[name]
    shipped = bt.load_study(path)
    text = path.read_text(encoding="utf-8")
    file = path.parent / "measurements.csv"
    own = next(line for line in text.splitlines() if line.startswith("file = "))
    for old, new in {'model = "M1"': f'model = "{model}"', own: f'file = "{file}"', **(changes or {})}.items():
        if old not in text:
            raise ValueError(f"no {old} in the study file of {name}")
        text = text.replace(old, new)
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "study.toml").write_text(text, encoding="utf-8")
        changed = bt.load_study(folder)
    assert len(changed.observations) == len(shipped.observations)
    return changed


def measured() -> None:
    """Every measured study and model that the tables do not hold yet: scores.csv and refits.csv."""
    for name, model, called, changes in CASES:
        if (name, called) in done(HERE / "refits.csv", "study", "model"):
            continue
        one = leave_out(study(name, model, changes))
        table, own = one.table, one.table["predictor"] == model
        table.loc[own, "predictor"] = called
        kept = table if called == "M1" else table[own]  # baselines are the same for every model
        for file, rows in {"scores": kept, "refits": one.refits}.items():
            head = {"study": name, "data": one.study.kind, "model": called}
            rest = rows.drop(columns="model", errors="ignore")
            append(HERE / f"{file}.csv", pd.DataFrame(head, index=rows.index).join(rest), "%.5g")
        print(name, called, one.refits["status"].value_counts().to_dict(), flush=True)


QUICK = [case for case in CASES if case[1] == case[2] and (case[0] == "hit-wh32" or case[1] == "M1")]


def quick() -> None:
    """Slips that every ``run`` leaves out by weights or short refits, for five of the cases: quick.csv."""
    for name, model, called, changes in QUICK:
        if (name, called) in done(HERE / "quick.csv", "study", "model"):
            continue
        found = pd.DataFrame(bt.run(study(name, model, changes)).record["levels"])
        rows = found[(found["by"] == "slip") & (found["predictor"] == model)]
        columns = ["level", "row", "channel", "unit", "observed", "q05", "q50", "q95", "covered90", "reliable"]
        head = pd.DataFrame({"study": name, "data": "measured", "model": called}, index=rows.index)
        append(HERE / "quick.csv", head.join(rows[columns]), "%.5g")
        print(name, called, int(rows["covered90"].sum()), "of", len(rows), flush=True)


def beside_refits() -> pd.DataFrame:
    """Readings of quick.csv inside 90 % by either way, and how far ends and medians are apart, in widths."""
    keys = ["study", "model", "row", "channel"]
    full = pd.read_csv(HERE / "scores.csv")
    both = pd.read_csv(HERE / "quick.csv").merge(
        full[full["predictor"] == full["model"]], on=keys, suffixes=("", "_full")
    )
    width = both["q95_full"] - both["q05_full"]
    apart = pd.concat([(both[q] - both[f"{q}_full"]).abs() / width for q in ("q05", "q50", "q95")], axis=1)
    of = both.assign(apart=apart.mean(axis=1), differ=both["covered90"] != both["covered90_full"]).groupby(
        keys[:2], sort=False
    )
    return of.agg(
        readings=("row", "size"), quick=("covered90", "sum"), full=("covered90_full", "sum"), differ=("differ", "sum"),
        apart=("apart", "mean"),
    ).reset_index()  # fmt: skip


def simulated_table(number: int) -> bt.Study:
    """Readings of M1 under the conditions of ``hit-wh32``, of a soil drawn from its cut prior."""
    _, made = replicated(bt.load_study(FILES["hit-wh32"]), default_rng([2015, number]))
    return made


def simulated() -> None:
    """The same on tables that M1 made: simulated.csv."""
    columns = ["predictor", "level", "row", "slip", "channel", "unit", "extrapolated", "observed"]
    columns += ["q05", "q50", "q95", "pit", "crps", "covered50", "covered90", "no_answer", "status"]
    for number in range(1, TABLES + 1):
        if (number,) in done(HERE / "simulated.csv", "table"):
            continue
        one = leave_out(simulated_table(number), seed=number, fit=ShortRuns())
        rows = one.table.merge(one.refits[["level", "status"]], on="level")[columns]
        head = pd.DataFrame({"data": "simulated", "table": number}, index=rows.index)
        append(HERE / "simulated.csv", head.join(rows), "%.5g")
        print("simulated", number, one.refits["status"].value_counts().to_dict(), flush=True)


def exact() -> None:
    """Many tables that M1 made with φ the only unknown, whose posterior is known on a grid: exact.csv."""
    base = study("hit-wh32", changes={'set = "paper-box"': 'set = "paper-box"\n' + HELD})
    parts, rows = levels(base), []
    for number in range(1, EXACT_TABLES + 1):
        rng = default_rng([1511, number])
        made = replicated(base, rng)[1]
        for level in parts:
            training = made.with_use(made.observations.use & ~level.left)
            law = predictives(made, posterior(training), _on_grid(training, rng), level.left, rng)
            place = int(np.argmax(level.left))
            for column, channel in enumerate(law.channels):
                one = law.law(0, column)
                assert one is not None
                pit = float(one.cdf(made.observations.values[channel][[place]])[0])
                rows.append({"data": "simulated", "table": number, "level": level.name, "channel": channel, "pit": pit})
    pd.DataFrame(rows).to_csv(HERE / "exact.csv", index=False, float_format="%.4g")


def _on_grid(training: bt.Study, rng: Generator, points: int = 400, draws: int = 200) -> FloatArray:
    """Draws (n, 1) of the only unknown from its posterior on a fine grid."""
    target = posterior(training)
    edges = np.linspace(*target.prior.laws["phi"].range, points + 1)
    density = target.log_density(0.5 * (edges[1:] + edges[:-1])[:, None])
    below = np.cumsum(np.exp(density - density.max()))
    return np.interp(rng.random(draws), np.append(0.0, below / below[-1]), edges)[:, None]


def figure() -> None:
    """Left-out rows of the narrower wheel and what M1 and the baselines said of them: leave-slip-out.png."""
    table = pd.read_csv(HERE / "scores.csv")
    shown = table[(table["study"] == "cmu-grouser") & (table["model"] == "M1")]
    (HERE / "leave-slip-out.png").write_bytes(white_png(all_left_out(shown), 150))


def tables() -> None:
    """Means, coverages and skills of what scores.csv holds: summary.csv, skills.csv, tables in README.md."""
    summary().to_csv(HERE / "summary.csv", index=False, float_format="%.4g")
    skill().to_csv(HERE / "skills.csv", index=False, float_format="%.4g")
    file = HERE / "README.md"
    text = file.read_text(encoding="utf-8")
    blocks = {name: "\n".join(["", *lines, ""]) for name, lines in readme_tables().items()}
    file.write_text(filled(text, blocks), encoding="utf-8")


def _by_study() -> Iterator[tuple[str, pd.DataFrame]]:
    """Scores of every study; a predictor is a model or a baseline."""
    for name, table in pd.read_csv(HERE / "scores.csv").groupby("study", sort=False):
        yield str(name), table


def summary() -> pd.DataFrame:
    """Mean scores and coverages by study, predictor, channel and part."""
    parts = []
    for name, table in _by_study():
        found = summarise(table)
        found.insert(0, "study", name)
        parts.append(found)
    return pd.concat(parts, ignore_index=True)


def skill() -> pd.DataFrame:
    """Every model against every baseline."""
    parts = []
    for name, table in _by_study():
        models = [one for one in table["predictor"].unique() if one not in BASELINES]
        for model in models:
            found = skills(table[table["predictor"].isin([model, *BASELINES])], model)
            found.insert(0, "study", name)
            parts.append(found)
    return pd.concat(parts, ignore_index=True)


HEAD = (
    "| | CRPS, inner levels | CRPS, end levels | in 50 % | in 90 % | skill against the polynomial |",
    "|---|---|---|---|---|---|",
)


def readme_tables() -> dict[str, list[str]]:
    """The tables of the README, by study and channel; rows in the order of the file."""
    means, gains = summary(), skill()
    gains = gains[(gains["baseline"] == "polynomial") & (gains["part"] == "all")]
    gains = gains.set_index(["study", "model", "channel"])
    found = {}
    for (name, channel), rows in means.groupby(["study", "channel"], sort=False):
        lines = [*HEAD]
        for predictor in sorted(rows["predictor"].unique(), key=lambda one: (one in BASELINES, one)):
            own = rows[rows["predictor"] == predictor].set_index("part")
            gain = gains.loc[(name, predictor, channel)] if predictor not in BASELINES else None
            lines.append(_line(predictor, own, gain))
        found[f"{name} {channel}"] = lines
    found["simulated"], found["exact"] = simulated_lines(), exact_lines()
    return found


def _line(predictor: str, own: pd.DataFrame, gain: pd.Series | None) -> str:
    parts = own.loc[["inner", "end"]].to_dict("records")
    sizes = [f"{row['crps']:.2f} ± {row['crps_se']:.2f} {row['unit']}" for row in parts]
    rows = int(own.loc["all", "rows"])
    cells = [predictor, *sizes]
    cells += [f"{round(own.loc['all', name] * rows)} of {rows}" for name in ("covered50", "covered90")]
    cells.append("" if gain is None else _percents(gain["skill"], gain["skill_lo"], gain["skill_hi"]))
    return "| " + " | ".join(cells) + " |"


def _percents(middle: float, low: float, high: float) -> str:
    text = f"{100 * middle:.0f} % ({100 * low:.0f} to {100 * high:.0f})"
    return text.replace("-", "−")


def simulated_coverage() -> pd.DataFrame:
    """Shares of simulated readings inside the intervals, with standard errors by table; by predictor."""
    table = pd.read_csv(HERE / "simulated.csv")
    found = []
    for predictor in table["predictor"].unique():
        for channel in (*table["channel"].unique(), "all"):
            own = table[table["predictor"] == predictor]
            rows = own if channel == "all" else own[own["channel"] == channel]
            record: dict[str, object] = {"predictor": predictor, "channel": channel, "readings": len(rows)}
            for name in ("covered50", "covered90"):
                values = rows[name].to_numpy(float)
                record[name], record[f"{name}_se"] = clustered(values, rows["table"].to_numpy())
            found.append(record)
    return pd.DataFrame(found)


def exact_lines() -> list[str]:
    """Coverage by channel where φ alone is unknown, as a table of the README."""
    table = pd.read_csv(HERE / "exact.csv")
    lines = ["| | readings | in 50 % | in 90 % |", "|---|---|---|---|"]
    for channel, rows in [*table.groupby("channel", sort=False), ("all", table)]:
        cells = [str(channel).replace("_", " "), str(len(rows))]
        for level in (0.5, 0.9):
            inside = ((rows["pit"] - 0.5).abs() <= 0.5 * level).to_numpy(float)
            share, error = clustered(inside, rows["table"].to_numpy())
            cells.append(f"{100 * share:.1f} ± {100 * error:.1f} %")
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def simulated_lines() -> list[str]:
    """Coverage on tables that M1 made, as a table of the README."""
    lines = ["| | readings | in 50 % | in 90 % |", "|---|---|---|---|"]
    for row in simulated_coverage().to_dict("records"):
        if row["channel"] == "all":
            shares = (f"{100 * row[name]:.0f} ± {100 * row[f'{name}_se']:.0f} %" for name in ("covered50", "covered90"))
            lines.append("| " + " | ".join([row["predictor"], str(row["readings"]), *shares]) + " |")
    return lines


def statements() -> None:
    """What the index of the paper takes from here."""
    sys.path.append(str(HERE))
    import slip_statements

    slip_statements.statements().to_csv(HERE / "statements.csv", index=False)


def main(parts: list[str]) -> None:
    """Make the parts asked for."""
    known = {
        "measured": measured,
        "simulated": simulated,
        "exact": exact,
        "quick": quick,
        "figure": figure,
        "tables": tables,
        "statements": statements,
    }
    for part in parts or known:
        known[part]()


if __name__ == "__main__":
    main(sys.argv[1:])
