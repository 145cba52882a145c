"""The panels of the profiles show every parameter, the thresholds, and what is possible."""

from dataclasses import replace
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes

from bayesterra.identifiability.page import profile_panels, profiles_in_words
from bayesterra.identifiability.profiles import Profiles, profiles
from bayesterra.likelihood.posterior import posterior
from bayesterra.report.figures import svg
from bayesterra.study.study import load_study

HIT = Path(__file__).parents[2] / "studies" / "hit-wh32"


@pytest.fixture(scope="module")
def hit() -> Profiles:
    """Profiles of the shipped study."""
    return profiles(posterior(load_study(HIT)), rng=np.random.default_rng(1))


@pytest.fixture(scope="module")
def panels(hit: Profiles) -> list[Axes]:
    """Its panels."""
    return list(profile_panels(hit))


def test_every_parameter_has_a_panel_in_field_units(hit: Profiles, panels: list[Axes]) -> None:
    """The panel of φ runs from 0° to 50° and says what it shows and how it is classed."""
    assert len(panels) == len(hit.names) == 8
    phi = panels[hit.names.index("phi")]
    assert phi.get_xlim() == pytest.approx((-1.5, 51.5))
    assert "deg" in phi.get_xlabel()
    assert phi.get_title() == hit.profile("phi").shape == "two-sided"


def test_curves_cross_the_thresholds_where_the_dots_are(hit: Profiles, panels: list[Axes]) -> None:
    """Each curve, interpolated, has the height of the threshold at the ends of its interval."""
    curve = panels[hit.names.index("K")].get_lines()
    longest = max(curve, key=lambda line: len(np.asarray(line.get_xdata())))
    grid, height = np.asarray(longest.get_xdata()), np.asarray(longest.get_ydata())
    for percent, level in ((68, 0.99), (95, 3.84)):
        ends = np.array(hit.profile("K").crossings(percent)) / 1e-3
        assert np.interp(ends, grid, height) == pytest.approx([level, level], rel=0.02)


def test_what_is_impossible_is_shaded(hit: Profiles, panels: list[Axes]) -> None:
    """θm above the leaving angle keeps c1 above −0.1: the rest of its range is grey, that of φ is not."""
    shaded = {name: len(ax.patches) for name, ax in zip(hit.names, panels, strict=True)}
    assert shaded == {name: int(name == "c1") for name in hit.names}
    assert panels[hit.names.index("c1")].patches[0].get_extents().width > 0


def test_the_text_names_class_and_interval(hit: Profiles) -> None:
    """The words that stand for the figure say class and interval of every parameter, with units."""
    text = profiles_in_words(hit)
    low, high = hit.profile("phi").interval(95)
    assert f"φ two-sided, 95 % from {np.degrees(low):.3g} to {np.degrees(high):.3g} deg" in text
    assert text.count("95 %") == 8


def test_the_figure_leaves_no_state_and_is_the_same_twice(hit: Profiles) -> None:
    """No figure stays with pyplot, settings are as before, and the bytes are the same."""
    before = dict(mpl.rcParams)
    first, second = (svg(profile_panels(hit)) for _ in range(2))
    assert first == second
    assert pyplot.get_fignums() == []
    assert dict(mpl.rcParams) == before


def test_points_that_were_not_solved_are_crosses_beside_the_curve(hit: Profiles) -> None:
    """A spike that failed is marked where it is; the curve passes below it, and the legend explains it."""
    at, profile = hit.names.index("K"), hit.profile("K")
    spike = int(np.flatnonzero(profile.inside)[3])
    failed = np.arange(len(profile.values)) == spike
    broken = replace(profile, rise=np.where(failed, profile.rise + 3.0, profile.rise), failed=failed)
    each = tuple(broken if one is profile else one for one in hit.found["likelihood"])
    panels = profile_panels(replace(hit, found={**hit.found, "likelihood": each}))
    lines, place = panels[at].get_lines(), broken.values[spike] / 1e-3
    crosses = [line.get_xydata()[0] for line in lines if line.get_marker() == "x" and len(line.get_xdata())]
    assert np.array(crosses) == pytest.approx(np.array([[place, broken.rise[spike]]]))
    for line in (line for line in lines if len(line.get_xdata()) > 100):
        assert np.interp(place, *line.get_xydata().T) < broken.rise[spike] - 1.0
    legends = [panels[at].figure.legends[0], profile_panels(hit)[at].figure.legends[0]]
    named = [[text.get_text() for text in legend.get_texts()].count("not solved") for legend in legends]
    assert named == [1, int(any(one.failed.any() for each in hit.found.values() for one in each))]
