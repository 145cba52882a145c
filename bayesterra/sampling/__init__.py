"""From a density to draws: coordinates, adaptation, ensembles, evidence, mode, cross-check."""
