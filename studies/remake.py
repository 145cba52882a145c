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
COMMANDS: dict[str, tuple[tuple[str, ...], ...]] = {
    "tutorial": (("{folder}/tutorial.py",),),
    "hit-wh32": (RUN,),
    "paper-sensitivity": (("{folder}/run.py",),),
    "paper-identification": (("{folder}/run.py",),),
    "paper-variants": (("{folder}/run.py",),),
    "recovery": (("{folder}/run.py",),),
    "cmu-grouser": (RUN,),
    "cmu-grouser-wide": (RUN,),
    "drives": (("{folder}/run.py",),),
    "load-effect": (("{folder}/run.py",),),
    "sequential": (("{folder}/run.py",),),
    "plates-then-wheel": (("{folder}/run.py",),),
    "soil-tests": (("{folder}/run.py",),),
    "identifiability": (("{folder}/run.py",),),
    "verdicts": (("{folder}/run.py",),),
    "design": tuple(("{folder}/run.py", part) for part in ("additions", "slips", "estimator")),
    "rover": (("{folder}/run.py",),),
    "streaming": (("{folder}/run.py",),),
    "hostile-input": (("{folder}/run.py",),),
    "planted-misfits": (("{folder}/run.py",),),
    "leave-slip-out": (("{folder}/run.py",),),
    "model-error": (("{folder}/run.py",),),
    "calibration": (("{folder}/run.py",),),
    "calibration-groups": (("{folder}/run.py",), ("{folder}/factors.py",)),
    "many-wheels": (("{folder}/run.py",),),
    "faults": (("{folder}/run.py",),),
    "scale-out": (("{folder}/run.py",),),
    "benchmark-kernel": (("{folder}/run.py",),),
    "benchmark-samplers": tuple(
        ("{folder}/run.py", part) for part in ("reference", "compare", "cost", "divide")
    ),
    "paper": (("{folder}/run.py",),),  # last: it gathers the statements of the others
}
"""Arguments of the interpreter, by study."""
NOTHING_TO_RUN = ("priors",)


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
