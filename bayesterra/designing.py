"""The command ``design``: which drive to command next, as a folder."""
