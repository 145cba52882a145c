"""Levels of several wheels: panels, refits of joint posteriors, groups that are left out whole."""

import numpy as np
from numpy.random import SeedSequence, default_rng

import bayesterra as bt
from bayesterra.checking.holdout_page import _panels, bands_without
from bayesterra.checking.short_runs import Fitted
from bayesterra.likelihood.posterior import draw_cut_prior, posterior
from bayesterra.study.study import Study
from tests.support.two_wheels import MakeStudy


def weighed(study: Study, seed: SeedSequence) -> Fitted:
    """Draws of the prior, drawn again by their likelihood: cheap, and near the posterior."""
    target, rng = posterior(study), default_rng(seed)
    x = draw_cut_prior(target, 4000, rng).x
    level = target.log_prior_and_likelihood(x)[1]
    weights = np.exp(level - level.max())
    return Fitted(x[rng.choice(len(x), 300, p=weights / weights.sum())], 300.0, 1.0, True)


def test_every_wheel_of_a_level_has_a_panel(make: MakeStudy) -> None:
    """With its own band, training rows as dots, left-out rows as rings; one for a level that is a wheel."""
    found = bt.leave_out(make(pooling=None), fit=weighed)
    titles = [title for title, _, _ in _panels(found)]
    assert titles[:3] == ["Wh11 without slip 0.100", "Wh32 without slip 0.100", "Wh11 without slip 0.250"]
    assert len(titles) == 6
    second = bands_without(found)[0, 1]
    dots, rings = (line.get_xydata().tolist() for line in second.lines[1:])
    assert rings == [[0.1, 14.0]]
    assert dots == [[0.25, 20.5], [0.5, 24.5]]
    by_wheel = bt.leave_out(make(pooling=None), "wheel", fit=weighed)
    assert [title for title, _, _ in _panels(by_wheel)] == ["without Wh11", "without Wh32"]
