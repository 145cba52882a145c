"""Bayesian inference for the mechanical parameters of planetary soil from wheel tests.

>>> import bayesterra as bt
>>> wheel = bt.Wheel(radius=0.135, width=0.165, lug_height=0.015, lug_count=24)
>>> round(wheel.shearing_radius(0.5568), 4)
0.1462
"""

from importlib import import_module

with open(f"{__file__}i", encoding="utf-8") as _stub:
    _IMPORTS = [line.split() for line in _stub if line.startswith("from bayesterra.")]
_HOME = {name: home for _, home, _, name, *_ in _IMPORTS}
__all__ = list(_HOME)


def __getattr__(name: str) -> object:
    """Import a public name where it is first used: help and version must come at once."""
    if name == "__version__":
        from importlib.metadata import version

        return version("bayesterra")
    if name not in _HOME:
        raise AttributeError(f"module 'bayesterra' has no attribute {name!r}")
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    """Public names too, so that a notebook completes them before they are imported."""
    return sorted({*globals(), *__all__, "__version__"})
