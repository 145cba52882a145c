"""Several groups of rows with one posterior: joint density, sampler, evidence for sharing, report.

The groups of rows are independent given what they share, and everything here uses that: proposals move one
group at a time, the evidence integrates each group out on its own, and what belongs to the soil is judged
from the groups' own posteriors.
"""
