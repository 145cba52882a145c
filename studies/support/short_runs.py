"""A run of some tenths of a second, for processes that are killed again and again."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

from shipped import FILES

from bayesterra.analysis import inference
from bayesterra.analysis import page as analysis_pages
from bayesterra.analysis.result import RunRecord
from bayesterra.likelihood.posterior import draw_cut_prior
from bayesterra.report.verdicts import Failures
from bayesterra.sampling import sampler
from bayesterra.sampling.adaptation import AdaptationOptions

HELD = 'n0 = 0.85\nn1 = 1.06\nKs = "2500 kPa"\nK = "10 mm"\nc = "0.3 kPa"\nc2 = 0.0\n'
SHORT = "\n[sampling]\ntarget_ess = 2000\nwalkers = 32\nmax_steps = 30\n"
PAGE = SimpleNamespace(html=lambda: "report\n", failures=Failures())
"""Stands for every page."""


def quick_study(folder: Path) -> Path:
    """The HIT study with model M2 and two free parameters, stopped by its step budget; its file."""
    hit = FILES["hit-wh32"]
    text = hit.read_text(encoding="utf-8")
    for old, new in {
        'model = "M1"': 'model = "M2"',
        'set = "paper-box"\n': f'set = "paper-box"\n{HELD}',
        'hold = { Ks = "2500 kPa" }': 'methods = ["joint"]',
    }.items():
        assert old in text
        text = text.replace(old, new)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "study.toml").write_text(text + SHORT, encoding="utf-8")
    shutil.copy(hit.with_name("measurements.csv"), folder)
    return folder / "study.toml"


def make_runs_quick() -> None:
    """Short rounds, a small adaptation, few draws, and little but files after the sampling."""
    small = partial(AdaptationOptions, particles=128, sweeps=1, components=2, refinements=(2,))
    prior = partial(draw_cut_prior, batch=256)
    put(sampler, WARM_UP_STEPS=10, ROUND_STEPS=6, AdaptationOptions=small, draw_cut_prior=prior)
    put(inference, PRIOR_DRAWS=500, CURVE_DRAWS=50, MODE_DRAWS=200, draw_cut_prior=prior)
    put(inference, fit_all=lambda _: ({}, ()), validate=lambda *_: SimpleNamespace(record=dict))
    type.__setattr__(RunRecord, "check", lambda content, name: None)  # which now lacks the checks
    put(analysis_pages, run_page=lambda _: PAGE)


def put(module: ModuleType, **names: Any) -> None:
    """Put other things in the place of names of a module, all of which must be there."""
    gone = [name for name in names if name not in vars(module)]
    assert not gone, f"{module.__name__} has no {', '.join(gone)}"
    vars(module).update(names)
