"""Kills, full disks, damaged files and shared folders, thousands of times; every trial must end right.

Run ``python studies/faults/run.py``, or parts of it: ``points``, ``moments``, ``damage``, ``disks``,
``sharing``, ``workers``, ``renames``, ``owned``, ``table``. Tables are gone on with where they end: remove
them to begin anew. Linux; ``points`` and ``renames`` need a C compiler; a small file system and files that
are not readable need root. About half an hour of a processor. ``--out DIR`` writes elsewhere, ``--share 0.1``
makes a tenth of the trials, ``--only NAME`` those at one place.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import pandas as pd

HERE = Path(__file__).parent
PARTS = ("points", "moments", "damage", "disks", "sharing", "workers", "renames", "owned")
COLUMNS = ("fault", "where", "trial", "moment", "outcome", "detail")
BARE = {"calibrate", "a store of tasks", "a store of tasks that is read"}
"""Places whose trials need no result that was made before."""
ALONE = {"renames"}
"""Parts of which that is so."""
RIGHT, CLEAR = "right", "clear error"
MARK = "<!-- table: made by run.py from the stored trials -->\n"


def make(names: list[str], out: Path, share: float, only: tuple[str, ...]) -> None:
    """Make the trials of some parts; in a process of its own, where everything is made quick."""
    sys.path[:0] = [str(HERE), str(HERE.parent / "support")]
    import damage
    import disks
    import moments
    import owned
    import points
    import renames
    import sharing
    import trials
    import workers

    modules = {"points": points, "moments": moments, "damage": damage, "disks": disks}
    modules |= {"sharing": sharing, "workers": workers, "renames": renames, "owned": owned}
    parent = Path("/dev/shm") if Path("/dev/shm").is_dir() else None  # noqa: S108
    with tempfile.TemporaryDirectory(dir=parent) as folder:
        work = Path(folder)
        work.chmod(0o755)
        made = work / "made"
        made.mkdir()
        trials.make_quick()
        if ({*names} - ALONE) and (not only or {*only} - BARE):
            trials.make_results(made)
            if {*names} - {*ALONE, "owned"}:
                moments.prepare(made)
        for name in names:
            modules[name].fill(trials.Table.opened(out / f"{name}.csv"), work, made, share=share, only=only)


def built() -> Path | None:
    """Compile ``failing.c``; None where there is no C compiler for it."""
    compiler, target = shutil.which("cc"), Path(tempfile.mkdtemp()) / "failing.so"
    if compiler is None or not sysconfig.get_platform().startswith("linux"):
        return None
    source = HERE / "failing.c"
    subprocess.run([compiler, "-O1", "-shared", "-fPIC", source, "-o", target, "-ldl"], check=True)
    return target


def started(names: list[str], arguments: argparse.Namespace) -> int:
    """Make the trials of some parts in a new process; its exit status."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    if counting := {"points", "renames"} & {*names}:
        library = built()
        if library is None:
            print("points, renames: need Linux and a C compiler; left out")
            names = [name for name in names if name not in counting]
        else:
            environment["LD_PRELOAD"] = str(library)
    command = [sys.executable, __file__, *names, "--within", "--out", str(arguments.out)]
    command += ["--share", str(arguments.share), *(f"--only={one}" for one in arguments.only)]
    return subprocess.run(command, env=environment, check=False).returncode


def trials_of(folder: Path) -> pd.DataFrame:
    """All stored trials, one row each."""
    tables = [pd.read_csv(folder / f"{name}.csv", dtype=str, keep_default_na=False).assign(part=name)
              for name in PARTS if (folder / f"{name}.csv").exists()]  # fmt: skip
    return pd.concat(tables, ignore_index=True)


def counted(trials: pd.DataFrame) -> pd.DataFrame:
    """One row per fault and place: trials, those that ended right or with a clear error, and all others."""
    kinds = trials["outcome"].map({RIGHT: RIGHT, CLEAR: CLEAR}).fillna("broken")
    table = pd.crosstab([trials["fault"], trials["where"]], kinds)
    table = table.reindex(columns=[RIGHT, CLEAR, "broken"], fill_value=0)
    order = trials.drop_duplicates(["fault", "where"]).set_index(["fault", "where"]).index
    return table.loc[order].assign(trials=table.sum(axis=1)).reset_index()


def words(table: pd.DataFrame) -> str:
    """The fault table as Markdown."""
    lines = ["| fault | at | trials | right | clear error, then right | broken |", "|---|---|---|---|---|---|"]
    before = ""
    for row in table.to_dict("records"):
        fault = row["fault"] if row["fault"] != before else ""
        before = row["fault"]
        numbers = " | ".join(str(row[name]) for name in ("trials", RIGHT, CLEAR, "broken"))
        lines.append(f"| {fault} | {row['where']} | {numbers} |")
    return "\n".join(lines) + "\n"


def write_readme() -> None:
    """Put the table of the stored trials into the README."""
    trials, file = trials_of(HERE), HERE / "README.md"
    head = file.read_text(encoding="utf-8").partition(MARK)[0]
    kills = int(trials["fault"].str.startswith("kill").sum())
    total = f"\n{len(trials)} trials, {kills} of them kills.\n"
    file.write_text(head + MARK + "\n" + words(counted(trials)) + total, encoding="utf-8")


def main() -> int:
    """Make what is asked for; 1 where a trial has not ended as promised."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("parts", nargs="*", help=", ".join((*PARTS, "table")))
    parser.add_argument("--out", type=Path, default=HERE)
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--only", action="append", default=[])
    parser.add_argument("--within", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.within:
        make(arguments.parts, arguments.out, arguments.share, tuple(arguments.only))
        return 0
    if unknown := [name for name in arguments.parts if name not in (*PARTS, "table")]:
        parser.error(f"no such part: {unknown[0]}")
    names = [name for name in PARTS if name in arguments.parts or not arguments.parts]
    if names and (status := started(names, arguments)):
        return status
    if "table" in arguments.parts or not arguments.parts:
        write_readme()
    return int(counted(trials_of(arguments.out))["broken"].sum() > 0)


if __name__ == "__main__":
    sys.exit(main())
