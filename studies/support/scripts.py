"""Scripts of studies as modules: they lie in no package, and many have the same name."""

from __future__ import annotations

import importlib.util
import re
import sys
from pathlib import Path
from types import ModuleType

STUDIES = Path(__file__).parents[1]


def loaded(path: Path) -> ModuleType:
    """A new module of a script; its name is made of the folder and of the file."""
    name = re.sub(r"\W", "_", "/".join(path.with_suffix("").parts[-3:]))
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # dataclasses look for their module there
    spec.loader.exec_module(module)
    return module
