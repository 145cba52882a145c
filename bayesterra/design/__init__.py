"""Which measurement next: expected information of candidate drives about chosen parameters."""
