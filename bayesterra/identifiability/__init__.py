"""What the data say about each parameter beyond the prior, and what no data of this design could say.

The reference is the prior after the physical cut, never the stated box.
"""

from bayesterra.identifiability.contraction import COUPLED, DETERMINED, WEAK, Identifiability, identifiability
from bayesterra.identifiability.profiles import Profile, Profiles, profiles

__all__ = [
    "COUPLED",
    "DETERMINED",
    "WEAK",
    "Identifiability",
    "Profile",
    "Profiles",
    "identifiability",
    "profiles",
]
