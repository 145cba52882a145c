"""Look for inputs that break a target, guided by coverage: ``python -m tests.files.fuzz TARGET``.

Needs atheris (``pip install bayesterra[fuzz]``, Python 3.11). Distinct failures are saved as they are found,
with their tracebacks, and the search goes on; what the program itself does not survive (a crash of a library,
a hang) libFuzzer saves as ``crash-...`` or ``timeout-...`` and ends. Prints one line of JSON at the end.
"""

from __future__ import annotations

import argparse
import atexit
import json
import random
import re
import sys
import tempfile
import time
import traceback
from hashlib import sha256
from pathlib import Path
from typing import Any

import atheris

ROOT = Path(__file__).parents[2]
COMPILED = ["bayesterra.models", "bayesterra.likelihood.likelihood"]  # numba compiles their byte code as it stands

with atheris.instrument_imports(include=["bayesterra", "tomllib", "csv"], exclude=COMPILED):
    from bayesterra.analysis.inference import run
    from bayesterra.analysis.run import load_result
    from bayesterra.study.study import load_study
    from tests.files import targets

TOKEN = re.compile(rb'"[^"\n]*"|[-+]?[0-9.][0-9.eE+-]*|[A-Za-z_]+|[][{}=,]')
NASTY = tuple(
    line.encode().decode("unicode_escape").encode("latin-1")
    for line in (Path(__file__).parent / "words.txt").read_text(encoding="ascii").splitlines()
)
"""Words that mean something, or ought to be refused."""
VALUE = re.compile(rb'["0-9.+[{-]|nan|inf|true|null')
VALUES = tuple(word for word in NASTY if VALUE.match(word))
NAMES = tuple(word for word in NASTY if not VALUE.match(word))


class Search:
    """Inputs tried so far, and failures by where they come from."""

    def __init__(self, target: str, out: Path, seconds: float) -> None:
        self.target, self.out, self.seconds = targets.TARGETS[target], out, seconds
        self.tried = 0
        self.found: dict[str, str] = {}
        self.started = time.monotonic()

    def __call__(self, data: bytes) -> None:
        """Try one input."""
        self.tried += 1
        try:
            self.target(data)
        except Exception as error:
            self._keep(data, error)
        if self.tried % 200 == 0:
            self.write()

    def _keep(self, data: bytes, error: Exception) -> None:
        where = [f"{Path(f.filename).name}:{f.lineno}" for f in traceback.extract_tb(error.__traceback__)][-4:]
        name = sha256(" ".join([type(error).__name__, *where]).encode()).hexdigest()[:10]
        if name not in self.found:
            self.found[name] = f"{type(error).__name__}: {str(error)[:200]}"
            (self.out / f"{name}.input").write_bytes(data)
            (self.out / f"{name}.txt").write_text("".join(traceback.format_exception(error)))

    def write(self) -> None:
        """Save the figures; libFuzzer ends the process without coming back."""
        seconds = round(time.monotonic() - self.started, 1)
        figures: dict[str, Any] = {"inputs": self.tried, "seconds": seconds, "failures": self.found}
        (self.out / "figures.json").write_text(json.dumps(figures, indent=1) + "\n")


def small_base(folder: Path) -> None:
    """A short run for targets to spoil, made once and kept beside what is found."""
    if (folder / "run.json").is_file():
        targets.set_base(load_result(folder))
        return
    hit = ROOT / "studies" / "hit-wh32"
    text = (hit / "study.toml").read_text(encoding="utf-8") + "\n[sampling]\ntarget_ess = 400\nwalkers = 32\n"
    with tempfile.TemporaryDirectory() as name:
        (Path(name) / "study.toml").write_text(text, encoding="utf-8")
        (Path(name) / "measurements.csv").write_bytes((hit / "measurements.csv").read_bytes())
        small = run(load_study(name), seed=1)
    folder.mkdir(parents=True, exist_ok=True)
    targets.set_base(small, folder)


def mutated(data: bytes, most: int, seed: int) -> bytes:
    """Half of the time bytes are changed as libFuzzer does it, else whole tokens, lines and values."""
    rng = random.Random(seed)  # noqa: S311 (nothing to keep secret)
    if rng.random() < 0.4:
        return bytes(atheris.Mutate(data, most))
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        data = _with_other_token(data, rng) if rng.random() < 0.75 else _with_other_lines(data, rng)
    return data[:most]


def _with_other_token(data: bytes, rng: random.Random) -> bytes:
    tokens = list(TOKEN.finditer(data))
    if not tokens:
        return rng.choice(NASTY)
    one = rng.choice(tokens)
    if rng.random() < 0.1:
        other = rng.choice(NASTY)
    else:  # a value for a value and a word for a word, so that most files stay files of their kind
        alike = [token[0] for token in tokens if (VALUE.match(token[0]) is None) == (VALUE.match(one[0]) is None)]
        other = rng.choice(alike if rng.random() < 0.3 else VALUES if VALUE.match(one[0]) else NAMES)
    return data[: one.start()] + other + data[one.end() :]


def _with_other_lines(data: bytes, rng: random.Random) -> bytes:
    lines = data.split(b"\n")
    at, to = rng.randrange(len(lines)), rng.randrange(len(lines))
    change = rng.randrange(3)
    if change == 0:
        del lines[at]
    elif change == 1:
        lines.insert(to, lines[at])
    else:
        lines[at], lines[to] = lines[to], lines[at]
    return b"\n".join(lines)


def main() -> None:
    """Read the options and search."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("target", choices=targets.TARGETS)
    parser.add_argument("--seconds", type=int, default=240)
    parser.add_argument("--out", type=Path, default=Path("fuzz-findings"))
    asked = parser.parse_args()
    out = asked.out / asked.target
    corpus = out / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    small_base(asked.out / "base")
    search = Search(asked.target, out, asked.seconds)
    options = [
        f"-max_total_time={asked.seconds}", "-timeout=20", "-rss_limit_mb=3000", "-max_len=16384",
        "-print_final_stats=1", f"-artifact_prefix={out}/",
    ]  # fmt: skip
    folders = [str(corpus), str(targets.SEEDS / asked.target)]
    atheris.Setup([sys.argv[0], *options, *folders], search, custom_mutator=mutated)
    atexit.register(search.write)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
