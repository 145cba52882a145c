"""The main job by requests, hostile tables and names, and the whole path in a real browser."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from http.cookiejar import CookieJar
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import xarray as xr

from bayesterra.study.study import load_study
from tests.ui.browser import browser, opened
from tests.ui.client import Client

HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"
TABLE = (HIT / "measurements.csv").read_bytes()
WHEEL = {"name": "Wh32", "radius": "157.35 mm", "width": "165 mm", "lug_height": "10 mm", "lug_count": "30"}
FORM = {
    **{f"wheels/0/{key}": value for key, value in WHEEL.items()},
    "wheels/0/shearing_radius_coefficient": "0.65",
    "model": "M1", "drive": "load", "data/slip_reference": "shearing", "priors/set": "paper-box",
}  # fmt: skip
SD = {"sinkage": "1 mm", "drawbar_pull": "1.5 N", "resistance_moment": "0.3 N m"}
NOISE = {f"noise/{name}/{key}": value for name, sd in SD.items() for key, value in (("form", "sd"), ("sd", sd))}
SCRIPT = "<script>alert(1)</script>"


def told(text: str) -> str:
    """Text of a page without its tags."""
    return re.sub(r"<[^>]+>", " ", text)


def test_a_table_becomes_a_study_that_the_command_line_opens(client: Client, folder: Path) -> None:
    """What the table cannot say is asked for, live; the rest is understood."""
    draft = client.draft(TABLE)
    assert "[wheels.Wheel1] needs" in told(client.get(f"{draft}/check").text)
    form = client.get(draft).text
    assert "157.35 mm" not in form
    assert '<form id="study" novalidate' in form  # else nothing is sent, and no message changes, before all is typed
    answer = client.post(
        draft, {**FORM, "sampling/target_ess": "500", "noise/sinkage/form": "sd", "noise/sinkage/sd": "1 mm"}
    )
    assert "The study is understood" in answer.text
    assert answer.text.count('<svg class="panel"') == 3
    assert "row 6, Wh32: 27 mm at slip 0.6" in answer.text
    assert draft in client.get("/lists").text
    assert client.post(f"{draft}/save", {"name": "mine"}).location == "/study/mine"
    assert draft not in client.get("/lists").text
    study = load_study(folder / "mine")
    assert study.sampling.target_ess == 500
    assert study.noise["sinkage"].sd == pytest.approx(1e-3)
    assert study.wheels["Wh32"].lug_count == 30
    assert client.post(f"{draft}/save", {"name": "mine"}).status == 422


def test_a_draft_may_be_thrown_away(client: Client, folder: Path) -> None:
    """It is gone from the list, and nothing else is."""
    first, second = client.draft(TABLE), client.draft(TABLE)
    before = sorted(path.name for path in folder.iterdir())
    left = client.post(f"{first}/discard", {}).text
    assert second in left
    assert first not in left
    assert "not there any more" in client.get(first).text
    assert client.post("/draft/..%2F..%2Fhit-wh32/discard", {}).status in (404, 422)
    assert client.get(second).status == 200
    assert sorted(path.name for path in folder.iterdir()) == before


def test_questions_of_a_study_are_commands(client: Client) -> None:
    """What the rows could determine, and a calibration: each a command with its options, in a folder of its name."""
    client.post("/jobs", {"verb": "identify", "subject": "hit-wh32", "prior-only": "1"})
    client.post("/jobs", {"verb": "calibrate", "subject": "hit-wh32", "number": "20"})
    jobs = client.site.queue.jobs
    assert [(job.verb, job.out, job.options) for job in jobs] == [
        ("identify", "hit-wh32-identifiability", ("--prior-only",)),
        ("calibrate", "hit-wh32-calibration", ("--number=20",)),
    ]
    assert [job.how for job in jobs] == ["prior only", "number 20"]
    for job in jobs:
        client.post(f"/jobs/{job.number}/stop", {})


def test_priors_groups_and_text_of_a_study(client: Client, folder: Path) -> None:
    """A law, a value, a role among groups; and what has no form as text."""
    table = b"wheel,slip,load [N],sinkage [mm]\nA,0.1,80,5\nA,0.3,80,9\nB,0.1,80,6\nB,0.3,80,11\n"
    draft = client.draft(table)
    form = {f"wheels/{i}/{key}": value for i in (0, 1) for key, value in WHEEL.items()} | {
        "wheels/1/name": "B",
        "wheels/0/name": "A",
    }
    form |= {"model": "M1", "drive": "load", "data/slip_reference": "shearing", "priors/set": "paper-box"}
    form |= {
        "priors/phi/form": "norm",
        "priors/phi/loc": "32 deg",
        "priors/phi/scale": "4 deg",
        "priors/phi/lower": "20 deg",
    }
    form |= {"priors/c/form": "fixed", "priors/c/value": "1 kPa", "pooling/by": "wheel", "pooling/K": "hierarchical"}
    answer = client.post(draft, form)
    assert "The study is understood" in answer.text, told(answer.text)[:500]
    assert answer.text.count('class="key shade') == 2
    assert client.post(f"{draft}/save", {"name": "pooled"}).status == 303
    study = load_study(folder / "pooled")
    assert study.pooling is not None
    assert list(study.pooling.hierarchical) == ["K"]
    assert study.prior.fixed["c"] == pytest.approx(1000.0)
    assert study.prior.laws["phi"].dist == "norm"
    text = (folder / "pooled" / "study.toml").read_text().replace('title = "measurements"', 'title = "typed"')
    assert client.post(f"{draft}/text", {"text": text}).status == 303
    assert 'value="typed"' in client.get(draft).text
    refused = client.post(f"{draft}/text", {"text": "no = = toml"})
    assert refused.status == 422
    assert "must be TOML" in refused.text


def test_soil_tests_join_a_study(client: Client, folder: Path) -> None:
    """Plates with the laws that they read, and their readings in the folder."""
    draft = client.draft(TABLE)
    rows = "\n".join(f"p{d},{d},{z},{p}" for d, z, p in ((100, 5, 10), (100, 10, 19), (200, 5, 9), (200, 10, 16)))
    readings = f"test,plate_diameter [mm],sinkage [mm],pressure [kPa]\n{rows}\n".encode()
    assert client.upload(f"{draft}/tests", "plates.csv", readings, {"test": "plate"}).status == 303
    answer = client.post(draft, FORM)
    assert "The study is understood" in answer.text, told(answer.text)[:500]
    assert client.post(f"{draft}/save", {"name": "with plates"}).status == 303
    assert list(load_study(folder / "with plates").soil_tests) == ["plates"]


@pytest.mark.parametrize("kind", ["plate", "shear"])
def test_soil_tests_alone_are_a_study(client: Client, folder: Path, kind: str) -> None:
    """With the laws that a mistake in a study file would be told."""
    plates = "test,plate_diameter [mm],sinkage [mm],pressure [kPa]\np,100,5,10\np,100,10,19\nq,200,5,9\nq,200,10,16\n"
    rings = "test,normal_stress [kPa],displacement [mm],shear_stress [kPa]\na,5,2,1\na,5,9,2\nb,9,2,2\nb,9,9,4\n"
    answer = client.upload("/tables", "t.csv", (plates if kind == "plate" else rings).encode(), {"kind": kind})
    shown = client.get(f"{answer.location}/check").text
    assert "The study is understood" in shown
    levels, reading = {
        "plate": (("plate radius 50 mm", "plate radius 100 mm"), "q: 9 kPa at 5 mm"),
        "shear": (("normal stress 5 kPa", "normal stress 9 kPa"), "b: 4 kPa at 9 mm"),
    }[kind]
    assert all(level in shown for level in levels)
    assert f"<title>{reading}</title>" in shown
    assert shown.count('class="reading shade0"') == shown.count('class="reading shade1"') == 2
    assert client.post(f"{answer.location}/save", {"name": "alone"}).status == 303
    assert not load_study(folder / "alone").wheels


def test_a_workbook_is_asked_for_its_sheet(client: Client, tmp_path: Path) -> None:
    """What a table leaves open is asked for in the form."""
    with pd.ExcelWriter(tmp_path / "x.xlsx") as book:
        for name in ("one", "two"):
            pd.read_csv(HIT / "measurements.csv").to_excel(book, sheet_name=name, index=False)
    draft = client.draft((tmp_path / "x.xlsx").read_bytes(), "x.xlsx")
    assert "sheet" in told(client.get(f"{draft}/check").text)
    assert "The study is understood" in client.post(draft, {**FORM, "data/sheet": "two"}).text


def test_the_prior_predicts_before_any_run(client: Client) -> None:
    """Bars beside the readings of each channel."""
    answer = client.post("/study/hit-wh32/prior")
    assert answer.status == 200
    assert answer.text.count("band90") == 18  # six rows of three channels


NO_NAMES = ("../x", "..", "/etc/cron.d/x", "a/b", ".hidden", "", "x\x00y", "-x", "x" * 200)


@pytest.mark.parametrize(
    ("name", "said"), [*((name, "a name must be") for name in NO_NAMES), ("hit-wh32", "is replaced")]
)
def test_names_lead_nowhere_else(client: Client, folder: Path, name: str, said: str) -> None:
    """What is saved goes into the folder, under a new name."""
    draft = client.draft(TABLE)
    client.post(draft, FORM)
    before = sorted(folder.parent.rglob("study.toml"))
    answer = client.post(f"{draft}/save", {"name": name})
    assert answer.status == 422
    assert said in answer.text
    assert sorted(folder.parent.rglob("study.toml")) == before


@pytest.mark.parametrize(
    "path",
    ["/study/..", "/study/%2e%2e", "/study/..%2f..%2fetc", "/files/hit-wh32/..%2fstudy.toml", "/files/..%2fhit/x.csv",
     "/files/hit-wh32/study.toml%00.png", "/draft/..", "/draft/../../etc", "/static/../application.py",
     "/static/%2e%2e/application.py", "/files/.bayesterra-ui/queue.json"],
)  # fmt: skip
def test_paths_lead_nowhere_else(client: Client, path: str) -> None:
    """No traversal, coded or not."""
    answer = client.get(path)
    assert answer.status in (404, 422)
    assert "root:" not in answer.text
    assert "starlette" not in answer.text


def test_links_and_references_out_of_the_folder_are_refused(client: Client, folder: Path, tmp_path: Path) -> None:
    """Neither a link nor the text of a study reaches another file."""
    secret = tmp_path / "secret.csv"
    secret.write_bytes(TABLE)
    (folder / "linked").symlink_to(tmp_path)
    (folder / "hit-wh32" / "more.csv").symlink_to(secret)
    for path in ("/study/linked", "/study/hit-wh32", "/files/hit-wh32/more.csv"):
        answer = client.get(path)
        assert answer.status == 422, path
        assert "outside the folder" in answer.text
    (folder / "hit-wh32" / "more.csv").unlink()
    draft = client.draft(TABLE)
    client.post(draft, FORM)
    text = (folder / ".bayesterra-ui" / "drafts" / draft.rpartition("/")[2] / "study.toml").read_text()
    for place in (str(secret), "../../../../secret.csv"):
        assert client.post(f"{draft}/text", {"text": text.replace("measurements.csv", place)}).status == 303
        assert "outside the folder" in client.get(f"{draft}/check").text
        assert client.post(f"{draft}/save", {"name": "stolen"}).status == 422
    stated = text.replace("[priors]", f'[[priors.from]]\nresult = "{tmp_path}"\n[priors]')
    client.post(f"{draft}/text", {"text": stated.replace("[priors]\nset", "[prior]\nset")})
    assert not (folder / "stolen").exists()


def test_a_study_that_names_code_is_refused_and_nothing_runs(client: Client, folder: Path) -> None:
    """Whatever a study names: a module beside it, or one of the system."""
    (folder / "evil.py").write_text("from pathlib import Path\nPath('ran').touch()\nclass Law: pass\n")
    text = (folder / "hit-wh32" / "study.toml").read_text()
    (folder / "hit-wh32" / "study.toml").write_text(text.replace('model = "M1"', 'model = { use = "evil:Law" }'))
    answer = client.get("/study/hit-wh32")
    assert "--allow-code" in told(answer.text)
    assert client.post("/jobs", {"verb": "run", "subject": "hit-wh32", "seed": "1 --allow-code"}).status == 422
    assert not (folder / "ran").exists()
    assert not Path("ran").exists()


def test_scripts_in_names_and_cells_are_text(client: Client) -> None:
    """Headers, cells, wheels, titles and names of files stand on the page as they were typed."""
    table = f'wheel,slip,load [N],sinkage [mm],# {SCRIPT}\n{SCRIPT},0.1,80,5,"<img src=x onerror=alert(1)>"\n'.encode()
    draft = client.draft(table)
    for answer in (client.get(draft), client.get(f"{draft}/check"), client.post(draft, {**FORM, "title": SCRIPT})):
        assert answer.status == 200
        assert "<script>alert" not in answer.text
        assert "<img" not in answer.text
        assert "&lt;script&gt;" in answer.text or "&lt;" in answer.text
    assert client.upload("/tables", f"{SCRIPT}.csv", TABLE).status == 422


@pytest.mark.parametrize(
    "content", [b"", b"\x00" * 2000, b"PK\x03\x04" + b"x" * 50, b"slip\n" + b"1," * 9000, b"a,b\n1,2\n"]
)
def test_tables_that_are_none_are_refused_in_words(client: Client, content: bytes) -> None:
    """A message in the page, and never a trace."""
    answer = client.upload("/tables", "x.csv", content)
    page = client.get(f"{answer.location}/check") if answer.status == 303 else answer
    assert page.status in (200, 422)
    assert "warning" in page.text
    assert "this is a bug" not in page.text.lower()


NO_JOBS: tuple[dict[str, str], ...] = (
    {"verb": "simulate"},
    {"verb": "run", "subject": "../x"},
    {"verb": "run"},
    {"verb": "compare", "subject1": "hit-wh32"},
    {"verb": "run", "subject": "hit-wh32", "seed": "x; rm -rf"},
    {"verb": "run", "subject": "--out"},
)


@pytest.mark.parametrize("form", NO_JOBS)
def test_jobs_are_commands_of_this_page_only(client: Client, form: dict[str, str]) -> None:
    """No other command, option or place."""
    assert client.post("/jobs", form).status == 422
    assert client.site.queue.jobs == ()


def run_by_command_line(folder: Path, name: str) -> Path:
    """Result of a study by the command line."""
    out = folder.parent / f"{name}-by-hand"
    subprocess.run(
        [sys.executable, "-m", "bayesterra", "run", str(folder / name), "--out", str(out), "--quiet"], check=True
    )
    return out


def working(folder: Path) -> int:
    """Process that works on the result; 0 where none says so."""
    status = folder / "driven-result.part" / "status.json"
    with suppress(FileNotFoundError):
        return int(json.loads(status.read_text())["pid"])
    return 0


def draws(folder: Path) -> dict[str, bytes]:
    """All draws of a result."""
    with xr.open_datatree(folder / "draws.nc", engine="h5netcdf") as tree:
        return {str(name): np.asarray(values).tobytes() for name, values in tree["posterior"].load().data_vars.items()}


@contextmanager
def page_of(folder: Path) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """`bayesterra ui` as a process of its own, and its address."""
    command = [sys.executable, "-m", "bayesterra", "ui", str(folder), "--no-browser"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            found = re.search(r"http://\S+", process.stdout.readline())
            assert found
            yield process, found[0]
        finally:
            process.send_signal(signal.SIGINT)
            process.wait(60)


@pytest.mark.slow
@pytest.mark.skipif(browser() is None, reason="there is no Chromium on this machine")
def test_the_whole_path_in_a_browser_and_a_run_that_was_killed(tmp_path: Path) -> None:
    """From the table to the report with the mouse; killed on the way, the draws are those of the command line."""
    folder = tmp_path / "work"
    folder.mkdir()
    with page_of(folder) as (process, url), opened() as page:
        page.open(url)
        page.drop("#table", HIT / "measurements.csv")
        page.click("form[action='/tables'] button")
        page.wait("location.pathname.startsWith('/draft/') && document.querySelector('#understood .warning')")
        for name, value in {**FORM, "sampling/target_ess": "500", **NOISE}.items():
            page.fill(name, value)
        page.wait("document.querySelector('#understood .good')")
        page.click("#prior-predictive button")
        page.wait("document.querySelector('#prior-predictive .band90')")
        page.fill("name", "driven")
        page.click("form[action$='/save'] button")
        page.wait("location.pathname == '/study/driven'")
        page.click(".actions form button")
        page.wait("document.querySelector('#jobs progress')")
        until = time.monotonic() + 300
        while not list((folder / "driven-result.part").rglob("*.segment")) and time.monotonic() < until:
            time.sleep(0.2)
        page.wait("Number(document.querySelector('#jobs progress')?.value) > 0")
        first = working(folder)
        page.click("#jobs button[aria-label^=Stop]")
        page.click("#jobs button[aria-label^=Go]")
        while (child := working(folder)) in (0, first) and time.monotonic() < until:
            time.sleep(0.1)
        assert page.errors == []
        assert child not in (0, first)
        os.kill(process.pid, signal.SIGKILL)
        with suppress(ProcessLookupError):  # on a busy machine it may just have ended
            os.kill(child, signal.SIGKILL)
    with page_of(folder) as (_, url), opened() as page:
        page.open(url)
        page.wait("document.querySelector('#jobs a')", 600)
        until = time.monotonic() + 60
        while not page.run("location.pathname.startsWith('/result/')") and time.monotonic() < until:
            page.click("#jobs a, .verdicts a")  # the list may just be renewed under the mouse
            time.sleep(2)
        page.wait(
            "document.querySelector('iframe.report')?.contentDocument?.querySelector('.verdicts article') != null"
        )
        page.open(url.split("/?")[0] + "/what-if/driven-result")
        before = page.run("document.querySelector('#bands').innerText")
        page.fill("load", "100")
        page.wait(f"document.querySelector('#bands').innerText != {json.dumps(before)}")
        assert page.errors == []
    assert draws(folder / "driven-result") == draws(run_by_command_line(folder, "driven"))


@pytest.mark.slow
def test_first_page_comes_with_the_token_only(folder: Path) -> None:
    """The command prints the one address that opens the page, and ends by an interruption."""
    with page_of(folder) as (process, url):
        jar = urllib.request.HTTPCookieProcessor(CookieJar())
        with urllib.request.build_opener(jar).open(url, timeout=60) as answer:
            assert b"Studies and results" in answer.read()
    assert process.returncode == 0
