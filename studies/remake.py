"""Remake studies, each by its command: ``python studies/remake.py [NAME ... | all]``; without names, a list.

Commands run one after the other in this environment and from the working directory; results of
``bayesterra run`` and of the tutorial are written there. Some take hours: their READMEs say how long.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).parent
RUN = ("-m", "bayesterra", "run", "{folder}")
SCRIPT = (("{folder}/run.py",),)
COMMANDS: dict[str, tuple[tuple[str, ...], ...]] = {
    "tutorial": (("{folder}/tutorial.py",),),
    "hit-wh32": (RUN,),
    "cmu-grouser": (RUN, ("-m", "bayesterra", "run", "{folder}/wide.toml", "--out", "cmu-grouser-wide-result")),
    "tables": SCRIPT,
    "logs": SCRIPT,
    "paper/readings": SCRIPT,
    "paper/claims": SCRIPT,
    "paper/sensitivity": SCRIPT,
    "paper/identification": SCRIPT,
    "paper/variants": SCRIPT,
    "paper/load-effect": SCRIPT,
    "rover": SCRIPT,
    "soil-tests": SCRIPT,
    "soil-tests/plates-then-wheel": SCRIPT,
    "soil-tests/together": SCRIPT,
    "recovery": SCRIPT,
    "recovery/drives": SCRIPT,
    "identifiability": SCRIPT,
    "identifiability/verdicts": SCRIPT,
    "design": tuple(("{folder}/run.py", part) for part in ("additions", "slips", "estimator")),
    "streaming": SCRIPT,
    "streaming/sequential": SCRIPT,
    "many-wheels": SCRIPT,
    "misfit/planted": SCRIPT,
    "misfit/first-screen": SCRIPT,
    "misfit/leave-slip-out": SCRIPT,
    "misfit/model-error": SCRIPT,
    "misfit/other-models": SCRIPT,
    "calibration": SCRIPT,
    "calibration/groups": (*SCRIPT, ("{folder}/factors.py",)),
    "faults": SCRIPT,
    "faults/hostile-input": SCRIPT,
    "benchmarks/kernel": SCRIPT,
    "benchmarks/samplers": tuple(("{folder}/run.py", part) for part in ("reference", "compare", "cost", "divide")),
    "benchmarks/modes": SCRIPT,
    "benchmarks/rows": SCRIPT,
    "benchmarks/scale-out": SCRIPT,
    "paper": tuple(  # last: it gathers the statements of the others
        (f"{{folder}}/{part}run.py",)
        for part in ("sensitivity/", "identification/", "variants/", "load-effect/", "readings/", "claims/", "")
    ),
}
"""Arguments of the interpreter, by study."""
NOTHING_TO_RUN = ("priors", "misfit", "benchmarks")


def commands(name: str) -> list[list[str]]:
    """The commands that remake a study."""
    return [[part.format(folder=HERE / name) for part in command] for command in COMMANDS[name]]


def main(names: list[str]) -> int:
    """Remake the studies named, or list all; the exit status of the first command that fails."""
    unknown = [name for name in names if name not in COMMANDS and name != "all"]
    if unknown:
        print(f"'name' must be all or one of {', '.join(COMMANDS)} (got {unknown[0]!r})", file=sys.stderr)
        return 2
    for name in COMMANDS if not names or "all" in names else names:
        for command in commands(name):
            print(f"{name}: python {' '.join(command)}", flush=True)
            status = subprocess.run([sys.executable, *command], check=False).returncode if names else 0
            if status:
                return status
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
