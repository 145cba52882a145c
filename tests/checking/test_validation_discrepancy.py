"""A run with a discrepancy: what it keeps, what its report says, and what is predicted from it."""

import re
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from bayesterra import Wheel
from bayesterra.analysis.page import data_section
from bayesterra.analysis.run import load_result, run
from bayesterra.checking.validation import Missed, missed, trades
from bayesterra.checking.validation_page import _sentence
from bayesterra.likelihood.page import conditions
from bayesterra.likelihood.posterior import posterior
from bayesterra.prediction.outlook import predict_rover
from bayesterra.prediction.prediction import predict
from bayesterra.study.model_errors import Size, SlipError
from bayesterra.study.result import Result
from tests.support.adaptation import rows_left_out_by_few
from tests.support.joint_rows import ESTIMATED, TABLE, joined
from tests.support.pages import undrawn
from tests.support.thinned import thinned

pytestmark = pytest.mark.usefixtures("little_adaptation")


@pytest.fixture(scope="module")
def result() -> Result:
    """Pulls of one wheel that lie 4 N above what M2 can say at high slip."""
    data = TABLE[TABLE["wheel"] == "A"].drop(columns=["resistance_moment [N m]", "resistance_moment_sd [N m]"])
    data = data.assign(use=1, **{"drawbar_pull [N]": [13.6, 19.0, 26.0, 24.0, 27.5]})
    curves = {"drawbar_pull": {"sd": ESTIMATED, "length": 0.2}}
    sampling = {"target_ess": 200, "walkers": 32}
    with rows_left_out_by_few():
        return run(joined("phi", "n0", data=data, discrepancy=curves, slip={"sd": 0.005}, sampling=sampling))


def test_the_result_keeps_the_density_of_the_joint_law(result: Result) -> None:
    """The log density of its draws, and a term for each row, which do not sum to it."""
    x = result.values()
    expected = posterior(result.study).log_density(x)
    assert_allclose(result.draws["sample_stats"]["lp"].to_numpy().ravel(), expected, rtol=1e-9, atol=1e-9)
    assert list(result.draws["log_likelihood"].data_vars) == ["readings"]
    assert "discrepancy_drawbar_pull" in result.names
    assert result.summary["parameter"].tolist()[:3] == ["n0", "phi", "discrepancy_drawbar_pull"]


def test_the_report_says_what_the_model_misses(result: Result, tmp_path: Path) -> None:
    """In the section of its own, and among what went in; the folder gives the same study back."""
    with undrawn():
        page = result.save(tmp_path / "out").read_text(encoding="utf-8")
    text = re.sub(r"\s+", " ", re.sub("<[^>]*>", "", re.sub("<svg.*?</svg>", "", page, flags=re.DOTALL)))
    assert "What the model misses" in text
    assert "The model may be off by a smooth curve over slip, one for each wheel: FDP (sd estimated" in text
    assert "Slips are read with an error of sd 0.005." in text
    assert "standard deviation of the model&#39;s error in drawbar pull" in text
    again = load_result(tmp_path / "out")
    assert again.study.errors == result.study.errors


def test_the_report_says_how_unknown_loads_count(result: Result) -> None:
    """To first order beside a discrepancy; the sentence is for latent loads only."""
    said = "Unknown loads count to first order"
    assert said not in str(conditions(result.study))
    assert said in str(conditions(result.study.having(load_range=(40.0, 120.0))))


def test_the_report_names_rows_where_the_first_order_is_doubtful(result: Result) -> None:
    """An error of 0.06 reaches from rows 1 and 2 to one transition slip, from row 5 to the other."""
    assert "taken to first order" not in str(data_section(result))
    rough = replace(result.study.errors, slip=SlipError(Size(sd=0.06)))
    study = copy(result.study)
    object.__setattr__(study, "errors", rough)
    shown = str(data_section(replace(result, study=study)))
    assert "Note: errors of slip (sd 0.06) are taken to first order, which is doubtful in rows 1, 2, 5" in shown


def test_predictions_hold_the_discrepancy_of_the_same_wheel(result: Result) -> None:
    """Bands of the pull at a driven slip are near the readings; another wheel's are wide."""
    own = predict(result, [0.3, 0.4])
    pull = own.modelled[:, :, 1]
    assert_allclose(pull.mean(axis=0), [24.0, 27.5], atol=1.0)
    plain = posterior(result.study).outcomes(result.values()).values[:, 3, 1]
    assert plain.std() > 3 * pull[:, 0].std()  # what φ leaves open, the discrepancy makes up for
    other = predict(result, [0.3], wheel=Wheel(0.135, 0.165, 0.015, 24, 0.7499))
    assert other.modelled[:, 0, 1].std() > 3 * pull[:, 0].std()
    assert any("own error is part of it, as its readings tell it" in one for one in own.remarks)
    assert any("as stated before any reading" in one for one in other.remarks)
    assert any("the wheel was not driven" in one for one in other.remarks)
    assert (own.readings[:, 0, 1] - pull[:, 0]).std() == pytest.approx(0.5, rel=0.25)


def test_a_rover_is_driven_with_it(result: Result) -> None:
    """Of wheels that were not tested as stated; its notes say so, and no more that it is left out."""
    rover = Path(__file__).parents[2] / "studies" / "rover" / "el-dorado-ii.toml"
    few = replace(result, draws=thinned(result.draws, keep=20))
    notes = "\n".join(predict_rover(few, rover).notes)
    assert "the model's own error is part of it, as stated before any reading" in notes
    assert "the error of the wheel-soil model itself" not in notes


def test_the_sentence_says_where_and_how_much(result: Result) -> None:
    """Too low where readings lie above the model; open where the band holds 0 everywhere."""
    slip = np.linspace(0.1, 0.4, 4)
    shift = np.array([-0.5, 0.0, 2.0, 4.0])
    bands = shift + np.array([-1.0, -0.5, 0.0, 0.5, 1.0])[:, None]
    found = Missed("A", "drawbar_pull", slip, bands, slip, shift, ())
    said = re.sub("&nbsp;", " ", str(_sentence(result, found, several=False)))
    assert said == "M2’s drawbar pull is 2.0 to 4.0 N too low from slip 0.3 on."
    high = Missed("A", "drawbar_pull", slip, -bands, slip, shift, ())
    assert "too high" in str(_sentence(result, high, several=True))
    flat = Missed("A", "drawbar_pull", slip, bands - shift, slip, shift, ())
    assert "the readings leave open" in str(_sentence(result, flat, several=False))
    assert [one.channel for one in missed(result)] == ["drawbar_pull"]


def test_trades_are_shares_of_variance() -> None:
    """A level that a parameter fixes, a tilt that has nothing to do with it; sizes do not count."""
    rng = np.random.default_rng(1)
    x, slip = rng.standard_normal((4000, 2)), np.linspace(0.1, 0.5, 9)
    tilt = rng.standard_normal((4000, 1))
    curve = 2.0 * x[:, :1] + 0.2 * rng.standard_normal((4000, 1)) + tilt * (slip - slip.mean())
    level, slope = trades(("phi", "noise_sinkage"), x, slip, curve)
    assert level.share == pytest.approx(4 / 4.04, abs=0.01)
    assert (level.parameter, slope.share < 0.01) == ("phi", True)
    assert level.correlation == pytest.approx(level.share**0.5, abs=0.01)
