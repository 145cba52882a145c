"""Several groups of rows with one posterior: joint density, sampler, evidence for sharing, report."""
