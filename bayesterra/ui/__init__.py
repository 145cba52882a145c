"""The page in a browser: a face of the other rooms, which computes nothing that they do not."""
