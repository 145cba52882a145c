"""The study of two models beside the paper's: what its page says follows from its tables, and a fit comes out again."""

from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pandas as pd
import pytest

import bayesterra as bt
from bayesterra.analysis.comparison import log_evidence
from bayesterra.analysis.export import errors_said

STUDY = Path(__file__).parents[2] / "studies" / "misfit" / "other-models"


@pytest.fixture(scope="module")
def script(study_script: Callable[[str], ModuleType]) -> ModuleType:
    """Return the study's script."""
    return study_script("misfit/other-models")


@pytest.fixture(scope="module")
def fits() -> pd.DataFrame:
    """What was stored of the runs on the HIT wheel, by model."""
    table = pd.read_csv(STUDY / "fits.csv")
    return table[table["study"] == "hit-wh32"].set_index("model")


def test_the_page_holds_what_the_tables_do(script: ModuleType) -> None:
    """Both tables are those of the files."""
    text = (STUDY / "README.md").read_text(encoding="utf-8")
    for table in script.readme_tables().values():
        assert table in text


def test_the_models_are_ranked_as_the_page_says(script: ModuleType, fits: pd.DataFrame) -> None:
    """The paper's fit and explain the readings alike; without lugs the others do not."""
    assert list(fits.index) == list(script.MODELS)
    assert (fits["sampling"] == "converged").all()
    assert list(fits["fit"]) == ["fits"] * 3 + ["doubtful", "does not fit"]
    assert fits["log_evidence"][:3].max() - fits["log_evidence"][:3].min() < 1.5
    assert fits["difference"]["wong-reece"] < -10
    assert fits["difference"]["bekker-janosi"] < -100


def test_soils_for_chrono_are_off_by_what_the_page_says() -> None:
    """At the slip of its own projection a wheel without lugs pulls less and sinks less, at 0.1 by most of the pull."""
    table = pd.read_csv(STUDY / "projection.csv").query("study == 'hit-wh32'")
    own = table[table["projected_at"] == table["slip"]].set_index(["slip", "quantity"])
    assert own["error_95"][0.1, "drawbar_pull"] < -10
    assert (own.xs("sinkage", level="quantity")["error_95"] < 0).all()
    assert len(list(errors_said(table))) == 3


@pytest.mark.slow
def test_a_fit_is_remade(script: ModuleType, fits: pd.DataFrame) -> None:
    """Of the closed form, by its log evidence, within four errors."""
    changes = {**script.STUDIES["hit-wh32"], **script.OPTIONS["hit-wh32"]}
    result = bt.run(script.loaded(script.LEVELS).study("hit-wh32", "bekker-janosi", changes), seed=2)
    found, stored = log_evidence(result), fits.loc["bekker-janosi"]
    assert abs(found.value - stored["log_evidence"]) < 4 * (found.error + stored["error"])
