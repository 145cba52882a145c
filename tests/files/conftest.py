"""A sound result for hostile inputs to stand beside."""

import pytest

from bayesterra.study.result import Result
from tests.support.pages import plain_pages

from . import targets

collect_ignore = ["fuzz.py"]
"""A program, which needs what tests do not."""


@pytest.fixture(scope="session")
def base(small_result: Result, tmp_path_factory: pytest.TempPathFactory) -> targets.Base:
    """The small result with few of its draws, saved; targets use it."""
    with plain_pages():
        return targets.set_base(small_result, tmp_path_factory.mktemp("base"))
