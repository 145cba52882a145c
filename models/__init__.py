"""The wheel-soil models."""
