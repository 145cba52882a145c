"""Shipped studies of real wheels, by the names that stored tables have for them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

STUDIES = Path(__file__).parents[1]
FILES: Mapping[str, Path] = {
    "hit-wh32": STUDIES / "hit-wh32" / "study.toml",
    "cmu-grouser": STUDIES / "cmu-grouser" / "study.toml",
    "cmu-grouser-wide": STUDIES / "cmu-grouser" / "wide.toml",
}
"""Study files; the measurements lie beside them."""
