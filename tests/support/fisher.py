"""Fisher information of readings, as the product of the package's sensitivities."""

import numpy as np

from bayesterra.arrays import FloatArray
from bayesterra.likelihood.joint import Whole
from bayesterra.likelihood.sensitivities import weighted_sensitivities


def fisher_information(posterior: Whole, x: FloatArray) -> FloatArray:
    """Information (n, d, d) about the free parameters at sets ``x`` (n, d), SI; NaN without an answer."""
    weighted = weighted_sensitivities(posterior, x)
    return np.asarray(weighted.transpose(0, 2, 1) @ weighted)
