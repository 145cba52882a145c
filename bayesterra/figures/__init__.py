"""Every figure of the report as a function of a result that returns matplotlib axes.

Nothing here keeps state in pyplot; ``axes.figure.savefig`` writes any of them alone.
"""

from bayesterra.figures.before import prior_bands, prior_density
from bayesterra.figures.calibration import rank_ecdf
from bayesterra.figures.chains import ranks, trace
from bayesterra.figures.checks import predictive, residuals
from bayesterra.figures.contrast import contrast, contrast_derived, contrast_prediction
from bayesterra.figures.design import gain_over_slip
from bayesterra.figures.forecast import prediction, predictions
from bayesterra.figures.information import combinations, contraction
from bayesterra.figures.posterior import corner, correlations
from bayesterra.figures.strip import parameter_strip
from bayesterra.figures.validation import loo_pit

__all__ = [
    "combinations",
    "contraction",
    "contrast",
    "contrast_derived",
    "contrast_prediction",
    "corner",
    "correlations",
    "gain_over_slip",
    "loo_pit",
    "parameter_strip",
    "prediction",
    "predictions",
    "predictive",
    "prior_bands",
    "prior_density",
    "rank_ecdf",
    "ranks",
    "residuals",
    "trace",
]
