"""Every figure can be drawn alone, on given axes or its own, and leaves no state behind."""

from collections.abc import Callable

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.path import Path
from matplotlib.transforms import Bbox

from bayesterra.analysis import figures as analysis_figures
from bayesterra.checking import validation_page
from bayesterra.identifiability import evidence_page
from bayesterra.parameters import PARAMETERS
from bayesterra.report.figures import POSTERIOR, Axis, density, figure_of, png, svg
from bayesterra.study.result import Result

SINGLE: dict[str, Callable[[Result, Axes | None], Axes]] = {
    "predictive": lambda r, ax: validation_page.predictive(r, "drawbar_pull", ax),
    "residuals": lambda r, ax: validation_page.residuals(r, "sinkage", ax),
    "trace of the log density": lambda r, ax: analysis_figures.trace(r, ax=ax),
    "trace": lambda r, ax: analysis_figures.trace(r, "phi", ax),
    "ranks": lambda r, ax: analysis_figures.ranks(r, "K", ax),
    "correlations": analysis_figures.correlations,
    "contraction": evidence_page.contraction,
    "combinations": evidence_page.combinations,
}


@pytest.mark.parametrize("name", SINGLE)
def test_figures_draw_on_given_axes_and_return_them(name: str, small_result: Result) -> None:
    """A notebook's own axes come back with marks on them."""
    ax = Figure().subplots()
    assert SINGLE[name](small_result, ax) is ax
    assert ax.has_data()


@pytest.mark.parametrize("name", SINGLE)
def test_figures_make_their_own_axes_outside_pyplot(name: str, small_result: Result) -> None:
    """Without axes a new figure is made that pyplot does not keep, and settings are as before."""
    before = dict(mpl.rcParams)
    ax = SINGLE[name](small_result, None)
    assert isinstance(ax, Axes)
    assert pyplot.get_fignums() == []
    assert dict(mpl.rcParams) == before


def panel_of(patch: Patch) -> Bbox:
    """The box, on its axes, beyond which nothing of a patch is drawn."""
    box = patch.get_clip_box()
    assert box is not None
    assert patch.axes is not None
    return box.transformed(patch.axes.transData.inverted())


def test_corner_has_a_panel_for_every_pair(small_result: Result) -> None:
    """Outlines of the posterior lie in a panel for every pair of parameters, and nothing is drawn beyond a panel."""
    ax = analysis_figures.corner(small_result)
    count = len(small_result.names)
    side = 1 + analysis_figures.GAP
    blue = [patch for patch in ax.patches if patch.get_edgecolor() == to_rgba(POSTERIOR)]
    places = {(round(y / side), round(x / side)) for x, y in (panel_of(patch).min for patch in blue)}
    assert places == {(count - 1 - i, j) for i in range(count) for j in range(i + 1)}
    assert all(np.allclose(panel_of(patch).size, 1) for patch in ax.patches)


def test_outlines_of_the_corner_hold_the_mass_that_they_say(small_result: Result) -> None:
    """Half of the posterior lies within the inner outline of a pair, nine tenths within the outer one."""
    pair = ["c", "phi"]
    scale = np.array([PARAMETERS[name].scale for name in small_result.names])
    draws = small_result.values() / scale
    ax = analysis_figures.corner(small_result)
    j, i = (small_result.names.index(name) for name in pair)
    corner = (1 + analysis_figures.GAP) * np.array([j, len(small_result.names) - 1 - i])
    limits = np.array(analysis_figures._limits(small_result, draws))[[j, i]]
    (outlines,) = [
        patch for patch in ax.patches
        if patch.get_edgecolor() == to_rgba(POSTERIOR)
        and np.allclose(panel_of(patch).min, corner)
    ]  # fmt: skip
    places = corner + (draws[:, [j, i]] - limits[:, 0]) / np.ptp(limits, axis=1)
    drawn = outlines.get_path()
    drawn.should_simplify = False  # to a ninth of a dot, which is a ninth of a panel here
    shares = [Path(polygon).contains_points(places).mean() for polygon in drawn.to_polygons()]
    assert sorted(shares) == pytest.approx([0.5, 0.9], abs=0.01)


def test_ranks_and_traces_of_all_parameters_are_one_figure_each(small_result: Result) -> None:
    """Every parameter has its panel, the ranks on one scale; traces begin with the log density."""
    ranked, traced = analysis_figures.all_ranks(small_result), analysis_figures.traces(small_result)
    assert (len(ranked), len(traced)) == (len(small_result.names), len(small_result.names) + 1)
    assert len({ax.get_ylim() for ax in ranked}) == 1
    assert traced[0].get_ylabel() == "log density"
    assert all(ax.has_data() for ax in (*ranked, *traced))


def test_labels_of_saved_axes_lie_inside_their_figure(small_result: Result) -> None:
    """What :func:`own_axes` made is placed when it is saved, its wide labels included."""
    ax = analysis_figures.trace(small_result, "Ks")
    png(ax, 400)
    outer, whole = ax.get_tightbbox(), figure_of(ax).bbox
    assert outer is not None
    margins = (*np.subtract(outer.min, whole.min), *np.subtract(whole.max, outer.max))
    assert min(margins) >= 0
    assert max(margins) < 12


def test_the_same_figure_gives_the_same_bytes(small_result: Result) -> None:
    """No date, no random id: a figure drawn twice is the same file."""
    first, second = (validation_page.predictive(small_result, "sinkage") for _ in range(2))
    assert svg(first) == svg(second)
    assert png(first, 400) == png(second, 400)


def test_axes_carry_symbol_and_unit(small_result: Result) -> None:
    """Every quantity with a unit says it."""
    ax = validation_page.predictive(small_result, "resistance_moment")
    assert "[N m]" in ax.get_ylabel()
    assert "slip" in ax.get_xlabel()


def test_unknown_names_are_refused(small_result: Result) -> None:
    """A wheel, channel or parameter that the result does not hold is named, beside those that it does."""
    with pytest.raises(ValueError, match=r"'wheel' must be one of Wh32 \(got 'Wh99'\)"):
        validation_page.predictive(small_result, "sinkage", wheel="Wh99")
    with pytest.raises(ValueError, match="'channel' must be one of sinkage, drawbar_pull, resistance_moment"):
        validation_page.residuals(small_result, "normal_force")
    with pytest.raises(ValueError, match="'name' must be one of lp, Ks, n0"):
        analysis_figures.trace(small_result, "c3")


def test_density_follows_the_draws_up_to_the_ends_of_the_axis() -> None:
    """A flat law keeps its height at both ends, where an unmirrored kernel would lose half of it."""
    draws = np.random.default_rng(1).uniform(0, 1, 50_000)
    heights = density(draws, Axis(0.0, 1.0, log=False, bounds=(0.0, 1.0)))
    assert heights.min() > 0.85
    assert heights.max() == 1.0


def test_density_of_a_normal_law_has_its_shape() -> None:
    """The density of normal draws is the bell curve within a few per cent of its top."""
    draws = np.random.default_rng(2).normal(5, 0.7, 50_000)
    along = Axis(0.0, 10.0, log=False, bounds=(0.0, 10.0))
    expected = np.exp(-0.5 * ((along.grid(200) - 5) / 0.7) ** 2)
    assert np.abs(density(draws, along) - expected).max() < 0.08


def test_logarithmic_axes_place_by_ratio() -> None:
    """Half-way between 100 and 10 000 on a logarithmic axis is 1000."""
    along = Axis(100.0, 10_000.0, log=True, bounds=(100.0, 10_000.0))
    assert along.position(1000.0) == pytest.approx(0.5)
    assert along.position(50.0) < 0


def test_rows_of_a_log_are_dots(small_result: Result, monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond so many rows marks are part of a picture within the drawing, and small; else each is drawn itself."""
    plain = svg(validation_page.residuals(small_result, "sinkage"))
    assert b"<image" not in plain
    monkeypatch.setattr(validation_page, "MANY", 2)
    assert b"<image" in svg(validation_page.residuals(small_result, "sinkage"))
    assert b"<image" in svg(validation_page.predictive(small_result, "sinkage"))
