"""Wheels, loads, slips and rovers that were not driven, predicted with the draws of a result."""
