"""Choice of the drive to command next: expected information of candidates."""
