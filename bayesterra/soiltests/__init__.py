"""Conventional soil tests, Section 3.2: plates pressed into the soil, and annular shear.

Their likelihoods know that the readings of one test hang together, so that their posteriors do not pretend
that a test of a hundred readings were a hundred tests.
"""
