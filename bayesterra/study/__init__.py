"""The question, checked and in SI: measurements, wheels, noise, priors, and the result that answers it."""
