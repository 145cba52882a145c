"""The command ``identify``: what these data determine, as a folder."""
