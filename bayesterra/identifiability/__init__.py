"""Identifiability of parameters by data and design: structure, information, profiles, coupling, verdicts."""
