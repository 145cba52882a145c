"""The command line: exit codes, one-line errors, and what the commands leave behind."""

import json
import re
import subprocess
import sys
import tomllib
from dataclasses import replace
from pathlib import Path

import pytest

from bayesterra.__main__ import main
from bayesterra.errors import ResultError, StudyError
from bayesterra.runtime.checkpoints import read_tasks
from bayesterra.study.result import Result
from bayesterra.study.study import load_study
from tests.support.folder import Write

HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"
Captured = pytest.CaptureFixture[str]


def refused(arguments: list[str], capsys: Captured) -> str:
    """Run a command that must fail on its input, and return its one line."""
    code = main(arguments)
    captured = capsys.readouterr()
    assert code == 2
    assert captured.out == ""
    assert captured.err.startswith("error: ")
    assert captured.err.count("\n") == 1
    return captured.err


def python(*arguments: str) -> "subprocess.CompletedProcess[str]":
    """Run the interpreter of the tests."""
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, timeout=300)


def test_version_and_help(capsys: Captured) -> None:
    """Both end with 0; no arguments at all show the help."""
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("bayesterra ")
    for arguments in (["--help"], []):
        assert main(arguments) == 0
        assert "simulate" in capsys.readouterr().out


def test_help_and_version_import_nothing_heavy() -> None:
    """The command line starts in a blink because libraries are imported where they are used."""
    code = (
        "import sys; from bayesterra.__main__ import main\n"
        "main(['--help']); main(['--version']); main(['run', '--help'])\n"
        "heavy = {'numpy', 'scipy', 'pandas', 'numba', 'pint', 'matplotlib', 'arviz_stats', 'emcee'}\n"
        "print('heavy:', sorted(heavy & set(sys.modules)))"
    )
    assert python("-c", code).stdout.splitlines()[-1] == "heavy: []"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["chek", "x"], "No such command 'chek'"),
        (["chek", "x"], "id you mean 'check'"),
        (["run", "x", "--overwrit"], "No such option: --overwrit (did you mean --overwrite?)"),
        (["run", str(HIT), "--resume", "--prior-only"], "goes on with sampling, and --prior-only does none"),
        (["check", "x", "--frobnicate"], "No such option: --frobnicate"),
        (["check"], "Missing argument 'STUDY'"),
        (["check", "x", "y"], "unexpected extra argument"),
        (["simulate", "x", "--seed", "many"], "Invalid value for '--seed'"),
        (["simulate", "x", "--seed", "-1"], "Invalid value for '--seed'"),
        (["simulate", "x", "--set", "phi"], "must be NAME=VALUE"),
        (["check", "nowhere"], "nowhere: no such study file"),
        (["fit", str(HIT), "--method", "IM4"], "'methods' must be among IM1, IM2, IM3, joint (got 'IM4')"),
        (["simulate", str(HIT), "--out", "x", "--set", "phi=30"], "'phi' needs a unit"),
        (["simulate", str(HIT), "--out", "x", "--set", "fi=30 deg"], "unknown parameter 'fi'"),
        (["simulate", str(HIT), "--out", "x", "--set", "c1=2"], "nothing can be simulated"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(
    arguments: list[str], message: str, capsys: Captured, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Mistyped commands, options and values end with 2, one line on standard error, and no files."""
    monkeypatch.chdir(tmp_path)
    assert message in refused(arguments, capsys)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("sinkage =", "sinkge ="), "[noise] unknown channel 'sinkge' (did you mean 'sinkage'?)"),
        (('"1 mm"', "1"), "[noise] 'sinkage' needs a unit"),
        (("[priors]", "[prior]"), "unknown key 'prior' (did you mean 'priors'?)"),
        (("0.1,80", "1.0,80"), "'slip' must lie in [0, 1) (got 1, row 1)"),
        (("0.1,80", "0.1,nan"), "'load' must be finite or empty (got nan, row 1)"),
        (("5.0,14.0", "157.35,14.0"), "'sinkage' must be below the wheel radius 157.35 mm (got 157.35 mm, row 1)"),
        (("load [N]", "slip"), "column 'slip' must appear once"),
        (("c3 = 0.0", 'K = "60 mm"'), "'K' must be fixed inside the range of 'paper-box', 2 mm to 50 mm (got 60 mm)"),
    ],
)
@pytest.mark.parametrize("command", ["check", "fit", "simulate", "run"])
def test_bad_studies_are_refused_by_every_command(
    command: str, change: tuple[str, str], message: str, write: Write, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same line whichever command reads the study, and nothing new in the working directory."""
    file = write(change)
    monkeypatch.chdir(file.parent)
    before = set(file.parent.iterdir())
    assert message in refused([command, str(file)], capsys)
    assert set(file.parent.iterdir()) == before


def test_a_prior_without_support_is_refused(write: Write, capsys: Captured) -> None:
    """Where no parameter set can explain the slips and loads, check says why."""
    line = refused(["check", str(write(("c3 = 0.0", "c1 = 0.9\nc2 = 0.9")))], capsys)
    assert "no parameter set of the prior fits the conditions of the data" in line
    assert "θm outside (θ2, θ1)" in line


@pytest.mark.parametrize(
    ("out", "message"),
    [
        (".", "'.' is the working directory: leave it first, or give another with --out"),
        ("/proc/nothing", "'/proc/nothing"),
    ],
)
def test_a_run_into_a_place_that_cannot_be_ends_at_once(
    out: str, message: str, write: Write, monkeypatch: pytest.MonkeyPatch, capsys: Captured
) -> None:
    """The folder it stands in, which holds a result, and one where even root can make nothing."""
    folder = write().parent
    (folder / "run.json").touch()
    monkeypatch.chdir(folder)
    before = sorted(folder.iterdir())
    line = refused(["run", ".", "--out", out, "--overwrite", "--quiet"], capsys)
    assert line.startswith(f"error: {message}")
    assert sorted(folder.iterdir()) == before
    assert not folder.with_name(f"{folder.name}.part").exists()


def test_tasks_of_the_working_directory(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    """The path of one dot has no name, from which that of the unfinished folder would be made."""
    monkeypatch.chdir(write().parent)
    with pytest.raises(ResultError, match=r"^'\.' holds no finished tasks: none was saved there, or"):
        read_tasks(".")


def test_errors_reach_the_shell_without_a_traceback(tmp_path: Path) -> None:
    """Through the interpreter: code 2, one line on standard error."""
    done = python("-m", "bayesterra", "check", str(tmp_path))
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == f"error: {tmp_path / 'study.toml'}: no such study file\n"


def test_ctrl_c_ends_with_130(monkeypatch: pytest.MonkeyPatch, capsys: Captured) -> None:
    """An interrupted command says so and nothing else."""

    def interrupted(path: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("bayesterra.study.study.load_study", interrupted)
    assert main(["check", str(HIT)]) == 130
    assert capsys.readouterr().err.strip() == "error: interrupted"


def test_check_shows_what_was_understood(write: Write, capsys: Captured) -> None:
    """Readings with their units, priors in field units, rows, notes and the share of the prior in use."""
    assert main(["check", str(write(('"1 mm"', '"1 mm"\nload = "1 N"')))]) == 0
    shown = capsys.readouterr().out
    for text in ("Small study", "in the fit", "z [mm]", "7.5", "flat from 100 to 10 000 kPa/m^N"):
        assert text in shown
    assert "Note: noise of load is not used" in shown
    assert "inside the support" in shown


def test_the_template_is_a_good_study(tmp_path: Path, capsys: Captured) -> None:
    """What init writes is understood as soon as there are measurements beside it."""
    file = tmp_path / "study.toml"
    assert main(["init", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "bayesterra check" in printed
    assert "Leave the noise to be estimated" in printed
    table = "slip,load [N],sinkage [mm],drawbar_pull [N],resistance_moment [N m]\n0.1,80,5,14,3.5\n"
    (tmp_path / "measurements.csv").write_text(table)
    study = load_study(file)
    assert study.prior.names[-3:] == ("noise_sinkage", "noise_drawbar_pull", "noise_resistance_moment")
    assert list(study.noise) == ["sinkage", "drawbar_pull", "resistance_moment"]


def _switched_on(text: str) -> str:
    """Lines of a study file whose keys and tables are no longer commented out."""
    return "\n".join(re.sub(r"^# (?=\[|\w+ = )", "", line) for line in text.splitlines())


def test_the_schema_knows_the_keys_of_studies(capsys: Captured) -> None:
    """JSON for editors: every table and key of a study that ships, quantities as text or numbers."""
    assert main(["schema"]) == 0
    schema = json.loads(capsys.readouterr().out)
    content = tomllib.loads((HIT / "study.toml").read_text(encoding="utf-8"))
    assert {"data", "soil_tests"} < set(schema["properties"])
    assert set(content) <= set(schema["properties"])
    wheel = schema["$defs"]["WheelTable"]
    assert set(content["wheels"]["Wh32"]) <= set(wheel["properties"])
    assert wheel["properties"]["radius"]["anyOf"] == [{"type": "string"}, {"type": "number"}]
    assert not wheel["additionalProperties"]


def test_commented_lines_of_the_template_are_good_too(tmp_path: Path) -> None:
    """Every example that the template only shows can be switched on; an earlier result needs its folder."""
    file, rows = tmp_path / "study.toml", "\n0.1,80,5,14,3.5,a\n0.2,80,7,18,4.5,b\n"
    main(["init", str(file)])
    table = "slip,load [N],sinkage [mm],drawbar_pull [N],resistance_moment [N m],run"
    (tmp_path / "measurements.csv").write_text(table + rows)
    text = file.read_text()
    first, rest = text.split("# [[priors.from]]")
    earlier, rest = rest.split("# [pooling]")
    earlier, tests = earlier.split("# [soil_tests.plates]")
    pooling, last = ("# [pooling]" + rest).split("[least_squares]")

    file.write_text(_switched_on(first + "[least_squares]" + last))
    study = load_study(file)
    assert study.published is not None
    assert study.model.options["shear_start"] == "rim"
    assert study.least_squares.hold == {"Ks": 2.5e6}
    file.write_text(first + _switched_on(pooling).replace('"wheel"', '"run"', 1) + "[least_squares]" + last)
    assert load_study(file).pooling is not None
    (tmp_path / "plates.csv").write_text("test,plate_diameter [mm],sinkage [mm],force [N]\na,60,2,20\na,60,5,50\n")
    file.write_text(_switched_on(first + "# [soil_tests.plates]" + tests + "[least_squares]" + last))
    assert load_study(file).soil_tests["plates"].soil == ("kc", "kphi", "n0")
    file.write_text(first + _switched_on("# [[priors.from]]" + earlier) + "\n[least_squares]" + last)
    with pytest.raises(StudyError, match=r"\[priors.from\].*other-result"):
        load_study(file)


def test_init_never_overwrites(tmp_path: Path, capsys: Captured) -> None:
    """An existing file stays as it is; a folder and a missing folder are refused."""
    file = tmp_path / "study.toml"
    file.write_text("mine")
    assert "exists already and is not overwritten" in refused(["init", str(file)], capsys)
    assert file.read_text() == "mine"
    assert "is a folder: name a file in it" in refused(["init", str(tmp_path)], capsys)
    assert "cannot be written (No such file or directory)" in refused(["init", str(tmp_path / "a" / "b")], capsys)


def test_fit_prints_every_method(capsys: Captured) -> None:
    """The table holds the methods asked for, beside the published values."""
    assert main(["fit", str(HIT), "--method", "IM2", "--method", "IM3"]) == 0
    shown = capsys.readouterr().out
    assert all(word in shown for word in ("IM2", "IM3", "published", "error of F_N"))
    assert "IM1" not in shown.replace("IM1 on Wh32", "")


@pytest.mark.parametrize(
    ("overall", "converged", "strict", "code"),
    [(0.5, True, True, 0), (0.002, True, False, 0), (0.002, True, True, 4), (0.002, False, True, 3)],
)
def test_strict_ends_with_4_where_a_verdict_is_bad(
    overall: float, converged: bool, strict: bool, code: int, small_result: Result, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """And only then; a sampling that did not converge is 3 as before."""
    record = dict(small_result.record)
    record["predictive_checks"] = {**record["predictive_checks"], "overall": overall}
    record["verdict"] = {**record["verdict"], "converged": converged}
    made = replace(small_result, record=record)
    monkeypatch.setattr("bayesterra.analysis.run.run_study", lambda study, **how: made)
    words = ["run", str(HIT), "--out", str(tmp_path / "out"), "--quiet", *(["--strict"] if strict else [])]
    assert main(words) == code
