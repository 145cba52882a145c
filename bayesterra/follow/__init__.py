"""A posterior that learns row by row as a rover drives, and says when the soil changes."""
