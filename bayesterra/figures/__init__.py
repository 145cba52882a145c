"""Every figure of the report as a function of a result that returns matplotlib axes.

Nothing here keeps state in pyplot; ``axes.figure.savefig`` writes any of them alone.
"""

from bayesterra.figures.before import prior_bands, prior_density
from bayesterra.figures.calibration import rank_ecdf
from bayesterra.figures.chains import ranks, trace
from bayesterra.figures.checks import predictive, residuals
from bayesterra.figures.contrast import contrast, contrast_derived, contrast_prediction
from bayesterra.figures.coupling import contraction_bars, coupling_map, group_coupling
from bayesterra.figures.design import gain_over_slip
from bayesterra.figures.forecast import prediction, predictions
from bayesterra.figures.groups import group_strip
from bayesterra.figures.holdout import all_left_out, bands_without, left_out
from bayesterra.figures.information import combinations, contraction
from bayesterra.figures.missed import discrepancy
from bayesterra.figures.posterior import corner, correlations
from bayesterra.figures.profiles import profile_panels
from bayesterra.figures.rover import rover_outlook
from bayesterra.figures.spectrum import spectrum
from bayesterra.figures.strip import parameter_strip
from bayesterra.figures.validation import loo_pit

__all__ = [
    "all_left_out",
    "bands_without",
    "combinations",
    "contraction",
    "contraction_bars",
    "contrast",
    "contrast_derived",
    "contrast_prediction",
    "corner",
    "correlations",
    "coupling_map",
    "discrepancy",
    "gain_over_slip",
    "group_coupling",
    "group_strip",
    "left_out",
    "loo_pit",
    "parameter_strip",
    "prediction",
    "predictions",
    "predictive",
    "prior_bands",
    "prior_density",
    "profile_panels",
    "rank_ecdf",
    "ranks",
    "residuals",
    "rover_outlook",
    "spectrum",
    "trace",
]
