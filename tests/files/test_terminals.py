"""What is printed: control characters and markup in titles, names and messages do nothing to a terminal."""

from __future__ import annotations

import io
import os
from pathlib import Path

import pytest
from rich.table import Table

from bayesterra.__main__ import main
from bayesterra.errors import LONGEST, BayesterraError, StudyError
from bayesterra.report.terminal import PlainConsole, note
from bayesterra.study.study import load_study

from . import targets

Captured = pytest.CaptureFixture[str]
HOSTILE = "\x1b[31m[red]\x1b]0;title\x07 [/] :smile: \x9b2J \u202e [link=http://x]x[/link]"


def shown(*things: object) -> str:
    """What a colour terminal would get."""
    console = PlainConsole()
    console.file = stream = io.StringIO()
    for thing in things:
        console.print(thing)
    return stream.getvalue()


def test_text_is_text_on_the_console() -> None:
    """In sentences, titles, headers and cells: brackets and colons as they are, escapes spelled out."""
    table = Table(HOSTILE, title=HOSTILE)
    table.add_row(HOSTILE)
    for text in (shown(HOSTILE), shown(table)):
        assert not any(not one.isprintable() for one in text.replace("\n", ""))
        whole = "".join(text.split())
        for part in ("[red]", "[/]", ":smile:", "\\x1b", "\\u202e"):
            assert part in whole


def test_lines_and_spaces_stay() -> None:
    """Nothing else changes."""
    assert shown("a  b\n  c") == "a  b\n  c\n"


def test_notes_are_harmless(capsys: Captured) -> None:
    """On standard error too."""
    note(HOSTILE)
    text = capsys.readouterr().err
    assert "\x1b" not in text
    assert "[red]" in text


@pytest.mark.parametrize("key", ["title", "soil"])
@pytest.mark.parametrize("text", ["a\\u001b[2Jb", "\\u0007", "\\u009b31m", "\\u202eb", "\\u0000"])
def test_control_characters_are_refused_in_texts(key: str, text: str, tmp_path: Path, capsys: Captured) -> None:
    """By every command, in a line that has none itself."""
    toml, table = (targets.SEEDS / "study" / "sound").read_bytes().split(targets.BREAK)
    body = toml.decode().replace('title = "Small study"\n', "")
    (tmp_path / "study.toml").write_text(f'{key} = "{text}"\n{body}')
    (tmp_path / "measurements.csv").write_bytes(table)
    assert main(["check", str(tmp_path)]) == 2
    line = capsys.readouterr().err
    assert f"'{key}' must have no control characters" in line
    assert line.strip().isprintable()


def test_markup_in_a_study_is_shown_as_it_is(tmp_path: Path, capsys: Captured) -> None:
    """Rich would take it for colours, or fail on it."""
    toml, table = (targets.SEEDS / "study" / "sound").read_bytes().split(targets.BREAK)
    named = toml.decode().replace("wheels.A", 'wheels."[/b]"')
    text = named.replace("Small study", "[/] [red]x[/red] :bomb:")
    (tmp_path / "study.toml").write_text(text)
    (tmp_path / "measurements.csv").write_bytes(table)
    for command in ("check",):
        assert main([command, str(tmp_path)]) == 0
        assert "[/] [red]x[/red] :bomb:" in " ".join(capsys.readouterr().out.split())


def test_file_names_are_spelled_out(tmp_path: Path, capsys: Captured) -> None:
    """Names with escapes, half characters and line breaks, in errors and in what is written."""
    for name in (b"\x1b[2J", b"\xff\xfe", b"a\nerror: b", "\u202e".encode()):
        path = tmp_path / os.fsdecode(name)
        assert main(["check", str(path)]) == 2
        line = capsys.readouterr().err
        assert line.startswith("error: ")
        assert line.count("\n") == 1
        assert line.strip().isprintable()
        assert main(["init", f"{path}.toml"]) == 0
        assert all(part.isprintable() for part in capsys.readouterr().out.splitlines())


def test_messages_are_short_and_in_one_line(tmp_path: Path) -> None:
    """However long and strange what they quote."""
    assert str(BayesterraError("a\nb\x1b")) == "a b\\x1b"
    assert len(str(StudyError("x" * 10**6))) < 2 * LONGEST
    (tmp_path / "study.toml").write_text('"' + "a\\n" * 10**5 + '" = 1\n')
    with pytest.raises(StudyError, match="unknown key") as caught:
        load_study(tmp_path)
    assert len(str(caught.value)) < 2 * LONGEST
    assert str(caught.value).isprintable()
