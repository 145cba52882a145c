"""Whether a posterior can be trusted: predictive checks, rows and levels left out, calibration."""
