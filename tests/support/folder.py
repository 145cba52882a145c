"""A small study folder that tests spoil in one place at a time."""

from collections.abc import Callable
from pathlib import Path

import pytest

STUDY = """\
title = "Small study"

[data]
file = "measurements.csv"
slip_reference = "shearing"

[wheels.A]
radius = "157.35 mm"
width = "165 mm"
lug_height = "10 mm"
lug_count = 30
shearing_radius_coefficient = 0.65

[noise]
sinkage = "1 mm"
drawbar_pull = "1.5 N"

[priors]
set = "paper-box"
c3 = 0.0
"""

TABLE = """\
slip,load [N],sinkage [mm],drawbar_pull [N]
0.1,80,5.0,14.0
0.2,80,7.5,20.0
0.4,80,14.0,
"""

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write the small study with some texts replaced, and return the study file."""

    def written(*changes: tuple[str, str], table: str = TABLE) -> Path:
        study = STUDY
        for old, new in changes:
            assert old in study or old in table, f"nothing to replace: {old}"
            study, table = study.replace(old, new), table.replace(old, new)
        (tmp_path / "study.toml").write_text(study, encoding="utf-8")
        (tmp_path / "measurements.csv").write_text(table, encoding="utf-8")
        return tmp_path / "study.toml"

    return written
