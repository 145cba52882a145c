"""What the data say about each parameter beyond the prior, and what no data of this design could say.

The reference is the prior after the physical cut, never the stated box.
"""

from bayesterra.identifiability.contraction import (
    UNKNOWN,
    Identifiability,
    identifiability,
    undetermined,
)
from bayesterra.identifiability.verdicts import COUPLED, COUPLED_TO_ALL, DETERMINED, SHIFT, WEAK

__all__ = [
    "COUPLED",
    "COUPLED_TO_ALL",
    "DETERMINED",
    "SHIFT",
    "UNKNOWN",
    "WEAK",
    "Identifiability",
    "identifiability",
    "undetermined",
]
