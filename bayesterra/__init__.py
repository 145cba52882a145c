"""Bayesian inference for the mechanical parameters of planetary soil."""
