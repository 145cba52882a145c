"""Logs of test beds and rovers: from time series to rows of measurements and readings of plates."""
