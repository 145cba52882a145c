"""What the data say about each parameter beyond the prior, and what no data of this design could say.

The reference is the prior after the physical cut, never the stated box.
"""

from bayesterra.identifiability.collinearity import Collinearity, collinearity
from bayesterra.identifiability.contraction import COUPLED, DETERMINED, WEAK, Identifiability, identifiability
from bayesterra.identifiability.local import LocalAnalysis, local_analysis
from bayesterra.identifiability.sensitivities import Sensitivities, fisher_information, sensitivities
from bayesterra.identifiability.structure import Null, Structure, structure

__all__ = [
    "COUPLED",
    "DETERMINED",
    "WEAK",
    "Collinearity",
    "Identifiability",
    "LocalAnalysis",
    "Null",
    "Sensitivities",
    "Structure",
    "collinearity",
    "fisher_information",
    "identifiability",
    "local_analysis",
    "sensitivities",
    "structure",
]
