"""Which drive to command next: expected information of candidates."""
