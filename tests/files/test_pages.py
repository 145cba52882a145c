"""Texts of a study on every page and in every plot: shown, and no element, attribute or script."""

from __future__ import annotations

import base64
import json
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from unittest.mock import patch
from xml.etree import ElementTree

import numpy as np
import pandas as pd
import pytest
from numpy.random import SeedSequence, default_rng

import bayesterra as bt
from bayesterra.analysis.comparison import compare
from bayesterra.analysis.inference import run_prior
from bayesterra.checking.calibration import calibrate
from bayesterra.checking.holdout import leave_out
from bayesterra.checking.short_runs import Fitted
from bayesterra.design.recommendation import recommend
from bayesterra.identifiability.analysis import identify
from bayesterra.likelihood.posterior import posterior
from bayesterra.models import Wheel
from bayesterra.pooling.run import run_pooled
from bayesterra.prediction.outlook import predict_rover
from bayesterra.prediction.page import predictions, rover_outlook
from bayesterra.prediction.prediction import forecast
from bayesterra.report.figures import white_png
from bayesterra.sampling.adaptation import AdaptationOptions
from bayesterra.sampling.joint import PoolingOptions
from bayesterra.stats.laws import Law
from bayesterra.study.result import Result
from bayesterra.study.schema import SamplingOptions
from bayesterra.study.study import Study, soil_test_study
from tests.support.adaptation import little_leaving_out
from tests.support.thinned import thinned
from tests.support.two_wheels import few_walkers

TITLE = "<script>document.title='ran'</script>\"><img src=x onerror=document.title='ran'>{{7*7}}{% raw %}"
NAME = "\"><svg onload=x>' $\\frac{a}$ {{7*7}} <b>"
LINK = "javascript:document.title='ran' $x_$ & <a href=\"javascript:x\">"
ELEMENTS = {
    "html", "head", "meta", "title", "style", "body", "header", "h1", "h2", "h3", "p", "span", "main",
    "section", "article", "nav", "ol", "ul", "li", "a", "table", "thead", "tbody", "tr", "th", "td", "figure",
    "figcaption", "div", "img", "footer", "b", "i", "sub", "sup", "code", "svg", "g", "path", "rect",
    "circle", "line", "text", "br", "em", "strong", "caption", "details", "summary", "small", "dl", "dt", "dd",
}  # fmt: skip
"""All that the templates use; the texts above would add others."""
HELD = {"Ks": 2.5e6, "n0": 0.85, "n1": 1.06, "c": 268.0, "K": 0.0101, "c1": 0.339, "c2": -0.017}


class Page(HTMLParser):
    """What a browser would make of a page."""

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: set[str] = set()
        self.attributes: list[tuple[str, str, str]] = []
        self.words: list[str] = []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Note an element and its attributes."""
        self.elements.add(tag)
        self.attributes += [(tag, name, value or "") for name, value in attrs]

    def handle_data(self, data: str) -> None:
        """Note what is shown."""
        self.words.append(data)


def check(html: str, *texts: str) -> Page:
    """No element or attribute is there that templates do not make; the texts are shown as they are."""
    page = Page(html)
    assert page.elements <= ELEMENTS, page.elements - ELEMENTS
    for tag, name, value in page.attributes:
        assert not name.startswith("on"), (tag, name)
        if name in ("href", "src", "xlink:href"):
            assert value.startswith(("#", "data:image/png;base64,", "data:image/svg+xml;base64,")), value[:80]
        assert name not in ("srcdoc", "formaction"), (tag, name)
        assert name != "style" or re.fullmatch("background:#[0-9A-Fa-f]{6}", value), (tag, value)
    shown = " ".join(page.words)
    for text in texts:
        assert text in shown, text
    assert "49" not in [word.strip() for word in page.words]
    for picture in re.findall(r"data:image/svg\+xml;base64,([A-Za-z0-9+/=]+)", html):
        _check_drawing(base64.b64decode(picture))
    return page


def _check_drawing(svg: bytes) -> None:
    for element in ElementTree.fromstring(svg).iter():  # noqa: S314 (of our own making)
        tag = str(element.tag).rpartition("}")[2]
        assert tag not in ("script", "foreignObject", "a", "image", "img", "iframe"), tag
        for name, value in element.attrib.items():
            assert not name.rpartition("}")[2].startswith("on")
            assert "javascript:" not in value


def of_one_soil(wheels: tuple[str, ...] = (NAME,), **tables: Any) -> Study:
    """Study of φ alone, with hostile names everywhere."""
    slips = [0.1, 0.2, 0.3, 0.4]
    rows = [(wheel, NAME, slip, 80.0, 5.0 + 30 * slip, 15.0) for wheel in wheels for slip in slips]
    columns = ["wheel", "site", "slip", "load [N]", "sinkage [mm]", "drawbar_pull [N]"]
    phi = Law("uniform", lower=float(np.radians(15)), upper=float(np.radians(45)), source=LINK)
    given: dict[str, Any] = {
        "title": TITLE, "soil": LINK, "source": LINK, "date": NAME, "model": "M2",
        "slip_reference": "shearing", "noise": {"sinkage": 2e-3, "drawbar_pull": 1.5},
        "priors": {**HELD, "phi": phi},
        "published": {"source": LINK, "phi": 0.5},
    }  # fmt: skip
    known = {wheel: Wheel(0.15735 + i / 100, 0.165, 0.010, 30, 0.65) for i, wheel in enumerate(wheels)}
    return Study(pd.DataFrame(rows, columns=pd.Index(columns)), known, **{**given, **tables})


def on_grid(study: Study, seed: SeedSequence) -> Fitted:
    """Independent draws of the only free parameter."""
    target = posterior(study)
    edges = np.linspace(*study.prior.laws["phi"].range, 301)
    density = target.log_density(0.5 * (edges[1:] + edges[:-1])[:, None])
    below = np.cumsum(np.exp(density - density.max()))
    u = default_rng(seed).random(300)
    return Fitted(np.interp(u, np.append(0.0, below / below[-1]), edges)[:, None], 300.0, 1.0, True)


@pytest.fixture(scope="module", autouse=True)
def _drawn_once() -> Iterator[None]:
    """Plots of many marks are drawn small: what their texts are does not depend on it."""
    from bayesterra.report import figures as report_figures

    real = report_figures.png
    with patch("bayesterra.report.figures.png", lambda drawn, width: real(drawn, 240)):
        yield


@pytest.fixture(scope="module")
def hostile(small_result: Result) -> Result:
    """Few draws of the small result, of a study whose texts are hostile."""
    study = small_result.study
    rows, (wheel,) = study.observations, study.wheels.values()
    named = study.with_rows(replace(rows, wheel=(NAME,) * len(rows), notes=(LINK,)))
    known = replace(study.published, source=LINK) if study.published else None
    texts = {"title": TITLE, "soil": LINK, "source": LINK, "date": NAME, "published": known}
    for key, value in {**texts, "wheels": {NAME: wheel}, "notes": (LINK,)}.items():
        object.__setattr__(named, key, value)
    draws = thinned(small_result.draws, keep=60)
    draws["curves"] = draws["curves"].to_dataset().assign_coords(wheel=[NAME])
    spoilt = {"title": TITLE, "source": LINK, "made": LINK, "machine": NAME, "notes": [LINK], "refused_fits": [LINK]}
    record = {**small_result.record, **spoilt, "versions": {"bayesterra": NAME, LINK: TITLE}}
    predictive = small_result.predictive.assign(wheel=NAME)
    return replace(small_result, study=named, draws=draws, record=record, predictive=predictive)


def test_a_run(hostile: Result) -> None:
    """Title, wheel, soil, sources, notes, and what stands in the record."""
    check(hostile.page().html(), TITLE, NAME, LINK)


def test_a_comparison(hostile: Result) -> None:
    """Names of folders, in plots too."""
    check(compare({NAME: hostile, LINK: hostile}).page().html(), NAME, LINK)


def test_an_analysis_of_identifiability(hostile: Result) -> None:
    """Title and versions."""
    check(identify(hostile).page().html(), TITLE)


def test_plots_of_predictions_and_rovers(hostile: Result, tmp_path: Path) -> None:
    """Names with a dollar, a brace or a backslash are no formulas of the plots."""
    foretold = forecast(hostile, slips=[0.2], wheels=[NAME])
    assert white_png(predictions(foretold)).startswith(b"\x89PNG")
    file = Path(__file__).parents[2] / "studies" / "rover" / "small-rover.toml"
    text = re.sub(r'name = "[^"]*"', lambda _: f"name = {json.dumps(LINK)}", file.read_text(), count=1)
    text = text.replace('wheel = "Wh32"', f"wheel = {json.dumps(NAME)}")
    (tmp_path / "r.toml").write_text(text)
    sheet = predict_rover(hostile, tmp_path / "r.toml", slopes=[0.0])
    assert white_png(rover_outlook(sheet)).startswith(b"\x89PNG")


def prior_page() -> str:
    """A prior without readings."""
    return run_prior(of_one_soil(), seed=1).page().html()


def calibration_page() -> str:
    """A calibration."""
    return calibrate(of_one_soil(), n=20, fit=on_grid).page().html()


def design_page() -> str:
    """A design."""
    return recommend(of_one_soil(("A", NAME)), slips=[0.1, 0.3]).page().html()


def holdout_page() -> str:
    """Levels that are wheels, left out."""
    return leave_out(of_one_soil(("A", NAME)), "wheel", fit=on_grid).page().html()


def pooled_page() -> str:
    """Groups that are wheels."""
    study = of_one_soil(
        ("A", NAME),
        pooling={"by": "wheel", "hierarchical": {"phi": {}}},
        sampling={"target_ess": 100, "walkers": 32, "max_steps": 200},
    )
    lone = AdaptationOptions(particles=256, components=4, refinements=(2, 2), more=(), shores=0, climbs=10)
    with few_walkers(sweeps=10, draws=512, inner=8):
        return run_pooled(study, seed=1, plan=PoolingOptions((5, 10), lone)).page().html()


def soil_test_page() -> str:
    """A soil test."""
    rng, j = np.random.default_rng(5), np.geomspace(1e-3, 60e-3, 12)
    rows = [
        (
            f"{NAME} {n}",
            5e3 * n,
            x,
            (800 + 5e3 * n * 0.6) * -np.expm1(-x / 0.009) * np.exp(0.02 * rng.standard_normal()),
        )
        for n in (1, 2)
        for x in j
    ]
    priors = {
        "c": Law("uniform", lower=0.0, upper=5e3, source=LINK),
        "phi": Law("uniform", lower=0.0, upper=0.87),
        "K": Law("loguniform", lower=0.002, upper=0.05),
    }
    columns = ["test", "normal_stress [Pa]", "displacement [m]", "shear_stress [Pa]"]
    given: dict[str, Any] = {"test": "shear", "title": TITLE, "soil": LINK, "priors": priors}
    given |= {"data": {"source": LINK}, "sampling": SamplingOptions(target_ess=100, walkers=32)}
    test = soil_test_study(given, table=pd.DataFrame(rows, columns=pd.Index(columns)))
    with little_leaving_out():
        return bt.run(test, seed=1).page().html()


@pytest.mark.parametrize(
    "make",
    [prior_page, calibration_page, design_page, holdout_page]
    + [pytest.param(make, marks=pytest.mark.slow) for make in (pooled_page, soil_test_page)],
    ids=lambda make: make.__name__,
)
def test_other_pages(make: Callable[[], str]) -> None:
    """Every other page that a command writes."""
    check(make(), TITLE)


def test_a_page_that_would_run_something_is_noticed() -> None:
    """The check itself: elements, handlers and addresses from a text."""
    for html in ("<script>x</script>", "<p onclick=x>", "<a href='javascript:x'>", "<p>49</p>", "<p style='x'>"):
        with pytest.raises(AssertionError):
            check(html)
    svg = base64.b64encode(b"<svg><script/></svg>").decode()
    with pytest.raises(AssertionError):
        check(f'<img src="data:image/svg+xml;base64,{svg}">')
