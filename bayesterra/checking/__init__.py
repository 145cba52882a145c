"""Checks of a posterior: predictive checks, rows and levels left out, calibration."""
