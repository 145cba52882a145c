"""Least-squares identification: IM1, IM2 and IM3 of Ding et al. 2015, and joint, all channels at once."""

from bayesterra.identification.fits import FORCES, METHODS, Fit, error_figure
from bayesterra.identification.methods import fit, fit_all
from bayesterra.identification.table import print_fits, report_table

__all__ = ["FORCES", "METHODS", "Fit", "error_figure", "fit", "fit_all", "print_fits", "report_table"]
