"""The commands predict and compare."""

from pathlib import Path

import pandas as pd
import pytest

from bayesterra.__main__ import main
from tests.support.pages import undrawn

Captured = pytest.CaptureFixture[str]


def test_predict_writes_and_prints(saved: Path, tmp_path: Path, capsys: Captured) -> None:
    """Every wheel under every load, doubtful slips marked; exit code 0."""
    out = tmp_path / "p"
    asked = ["--slip", "0.1,0.99", "--load", "80 N", "--load", "800 N", "--out", str(out)]
    assert main(["predict", str(saved / "wide-result"), *asked]) == 0
    printed = capsys.readouterr().out
    assert "z [mm]" in printed
    assert "do not rely on it" in printed
    bands = pd.read_csv(out / "bands.csv")
    assert sorted(set(bands["load [N]"])) == [80, 800]
    assert sorted(set(bands["slip"])) == [0.1, 0.99]
    assert (out / "prediction.png").read_bytes().startswith(b"\x89PNG")
    assert main(["predict", str(saved / "wide-result"), "--out", str(out)]) == 2
    assert "add --overwrite" in capsys.readouterr().err


def test_compare_writes_and_prints(
    saved: Path, tmp_path: Path, capsys: Captured, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The page goes to a new folder in the working directory and is named at the end."""
    monkeypatch.chdir(tmp_path)
    with undrawn():
        assert main(["compare", str(saved / "wide-result"), str(saved / "narrow-result")]) == 0
    assert "Page: comparison/comparison.html" in capsys.readouterr().out
    assert (tmp_path / "comparison" / "evidence.csv").is_file()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["predict", "nowhere"], "'nowhere' is not a result folder"),
        (["predict", "{}", "--slip", "fast"], "'slip' must be numbers with commas"),
        (["predict", "{}", "--load", "80"], "'load' needs a unit"),
        (["predict", "{}", "--wheel", "none.toml"], "none.toml: no such study file"),
        (["compare", "{}"], "two to 6 results can be compared (got 1)"),
        (["compare", "{}", "nowhere"], "'nowhere' is not a result folder"),
    ],
)
def test_mistakes_are_one_line_and_leave_nothing(
    arguments: list[str], message: str, saved: Path, capsys: Captured, tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    """Bad input ends with 2 and one line that names it; no folder appears."""
    monkeypatch.chdir(tmp_path)
    code = main([argument.format(saved / "wide-result") for argument in arguments])
    printed = capsys.readouterr().err
    assert code == 2
    assert message in printed
    assert printed.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
