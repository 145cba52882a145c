"""Few draws in place of many, for results of which files and pages are looked at."""

from __future__ import annotations

import numpy as np
import xarray as xr


def thinned(draws: xr.DataTree, keep: int = 120) -> xr.DataTree:
    """The same groups with ``keep`` draws of every chain."""
    groups = {}
    for name, node in draws.children.items():
        group = node.to_dataset()
        if "draw" in group.sizes:
            chosen = np.linspace(0, group.sizes["draw"] - 1, keep).astype(int)
            group = group.isel(draw=chosen)
        groups[f"/{name}"] = group
    return xr.DataTree.from_dict(groups)
