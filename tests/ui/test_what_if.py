"""Sliders: bands from the draws of a result, the same as those of `predict`, and quickly."""

from __future__ import annotations

import re
import time
from copy import copy
from dataclasses import replace
from math import cos, radians, sin

import numpy as np
import pytest

from bayesterra.errors import StudyError
from bayesterra.prediction.prediction import predict, quantiles
from bayesterra.study.model_errors import Discrepancy, Size
from bayesterra.study.result import Result
from bayesterra.ui.what_if import CURVE, DRAWS, Answer, Setting, WhatIf, widest


@pytest.fixture(scope="module")
def held(small_result: Result) -> WhatIf:
    """The result of the Harbin wheel with its draws ready."""
    return WhatIf("hit", small_result)


def test_figures_are_those_of_the_command(held: WhatIf, small_result: Result) -> None:
    """Median and 90 % at a slip, from fewer of the same draws."""
    answer = held.answer(Setting(0.3, 80.0, "Wh32"))
    expected = predict(small_result, [0.3], load=80.0)
    middle = quantiles(expected.modelled[:, 0, :3])[2] / np.array([1e-3, 1.0, 1.0])
    shown = [float(row[1]) for row in answer.rows]
    assert shown == pytest.approx(middle.tolist(), rel=0.03)
    assert answer.notes == ()


def test_a_slope_takes_its_part_of_the_load(held: WhatIf) -> None:
    """The wheel carries the cosine, and its pull has to hold the sine."""
    flat, steep = Setting(0.3, 80.0, "Wh32"), Setting(0.3, 80.0, "Wh32", 10.0)
    assert (steep.normal, steep.downhill) == pytest.approx((80 * cos(radians(10)), 80 * sin(radians(10))))
    same = held.answer(Setting(0.3, steep.normal, "Wh32"))
    assert held.answer(steep).rows == same.rows
    shares = [float(held.answer(replace(flat, slope=slope)).holds.split()[0]) for slope in (0.0, 10.0, 30.0)]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] == 100
    assert shares[-1] == 0
    assert "needed" in held.answer(steep).panels[1]


def test_what_was_not_driven_is_said(held: WhatIf) -> None:
    """Another load and a slip beyond: extrapolated."""
    notes = " ".join(held.answer(Setting(0.75, 120.0, "Wh32")).notes)
    assert "slip 0.75 lies outside" in notes
    assert "120 N is not among" in notes


def test_a_stated_error_of_the_model_is_said_to_be_left_out(held: WhatIf) -> None:
    """Bands are of the model alone, whatever the study says of its error."""
    errors = replace(held.study.errors, discrepancy={"sinkage": Discrepancy("sinkage", Size(1e-3), 0.2)})
    stated = copy(held)
    stated.study = copy(held.study)
    object.__setattr__(stated.study, "errors", errors)
    setting = Setting(0.3, 80.0, "Wh32")
    (note,) = stated.answer(setting).notes
    assert note.startswith("the error of the model that the study states is not in these bands")


def test_sliders_stay_between_their_ends(held: WhatIf) -> None:
    """Whatever a request says."""
    setting = held.checked({"slip": "7", "load": "1e30", "wheel": "no", "slope": "-4"})
    assert setting == Setting(0.8, held.loads[1], "Wh32", 0.0)
    assert held.checked({"slip": "nan"}).slip == held.start().slip
    with pytest.raises(StudyError, match="must give a number"):
        held.checked({"load": "<script>"})


def test_a_move_takes_less_than_a_tenth_of_a_second(held: WhatIf) -> None:
    """A load that was never asked for, all slips of the curve, 1000 draws; of a processor, as others work here."""
    assert DRAWS == 1000
    assert len(CURVE) == 11
    held.answer(Setting(0.3, 70.0, "Wh32"))

    def seconds(load: float) -> float:
        start = time.process_time()
        held.answer(Setting(0.3, load, "Wh32", 5.0))
        return time.process_time() - start

    assert min(map(seconds, np.linspace(71, 89, 7))) < 0.1


def test_results_side_by_side_share_their_axes(held: WhatIf) -> None:
    """Two loads, as two results would be: each ends where the wider one does."""
    light, heavy = Setting(0.3, 60.0, "Wh32"), Setting(0.3, 160.0, "Wh32")
    shared = widest([held.scales(light), held.scales(heavy)])
    assert shared["sinkage"][1] == held.scales(heavy)["sinkage"][1] > held.scales(light)["sinkage"][1]
    assert shared["drawbar_pull"][0] == min(held.scales(each)["drawbar_pull"][0] for each in (light, heavy))

    def ticks(answer: Answer) -> list[str]:
        return re.findall(r'<text class="tick end"[^>]*>([^<]*)', answer.panels[0])

    assert ticks(held.answer(light, shared)) == ticks(held.answer(heavy, shared)) != ticks(held.answer(light))
