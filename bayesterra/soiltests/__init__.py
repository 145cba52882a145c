"""Plates pressed into soil and shear tests (Section 3.2): their file, posterior, checks and page."""
