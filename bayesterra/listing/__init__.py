"""What commands print when they are done: one module for each kind of result."""
