"""Plates pressed into soil and shear tests (Section 3.2): their file, posterior, checks and page.

Their likelihoods know that the readings of one test hang together, so that their posteriors do not pretend
that a test of a hundred readings were a hundred tests.
"""
