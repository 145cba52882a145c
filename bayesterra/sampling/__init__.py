"""Sampling: adaptation from the prior, then independent emcee ensembles with frozen proposals."""
