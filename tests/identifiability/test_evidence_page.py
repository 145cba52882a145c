"""The coupling figures draw what the analysis found."""

import numpy as np
import pytest
from matplotlib import pyplot
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from bayesterra.identifiability.evidence_page import contraction_bars, coupling_map, group_coupling
from bayesterra.identifiability.information import Coupling, coupling, information
from bayesterra.likelihood.posterior import posterior
from bayesterra.study.result import Result


@pytest.fixture(scope="module")
def found(small_result: Result) -> Coupling:
    """The coupling in a short run."""
    prior, draws = small_result.values("prior"), small_result.values()
    return coupling(posterior(small_result.study), prior, draws, np.random.default_rng(1))


def widths(ax: Axes) -> list[float]:
    """Lengths of the bars."""
    return [bar.get_width() for bar in ax.patches if isinstance(bar, Rectangle)]


def test_posterior_stands_below_the_diagonal_and_cut_prior_above(found: Coupling) -> None:
    """The cell of φ and K below the diagonal holds the posterior's number, that above the cut prior's."""
    ax = coupling_map(found)
    texts = {text.get_position(): text.get_text().rstrip("*") for text in ax.texts}
    i, j = found.names.index("K"), found.names.index("phi")
    assert float(texts[j + 0.5, i + 0.5].replace("−", "-")) == pytest.approx(found.copula[i, j], abs=0.006)
    assert float(texts[i + 0.5, j + 0.5].replace("−", "-")) == pytest.approx(found.prior_copula[i, j], abs=0.006)
    assert len(ax.patches) == 3
    assert pyplot.get_fignums() == []


def test_stars_stand_where_the_estimates_disagree(found: Coupling) -> None:
    """As many starred numbers as flagged pairs."""
    stars = [text for text in coupling_map(found).texts if text.get_text().endswith("*")]
    assert len(stars) == found.pairs["disagree"].sum() >= 1


def test_groups_have_a_bar_under_posterior_and_prior(found: Coupling) -> None:
    """Three pairs of groups: six bars, drawn on the caller's axes."""
    ax = Figure().subplots()
    assert group_coupling(found, ax) is ax
    assert widths(ax)[:3] == pytest.approx(found.between["information"].tolist())
    assert len(ax.patches) == 6


def test_the_bars_of_the_cut_stand_beside_those_of_the_data(small_result: Result) -> None:
    """Two bars per parameter; c1's second one is three quarters long."""
    prior, draws = small_result.values("prior"), small_result.values()
    found = information(posterior(small_result.study), prior, draws, np.random.default_rng(1))
    ax = contraction_bars(found)
    count = len(small_result.names)
    assert len(ax.patches) == 2 * count
    assert widths(ax)[count + 6] == pytest.approx(0.76, abs=0.02)
