"""What data and design determine: structure, local information, profiles, coupling, verdicts."""
