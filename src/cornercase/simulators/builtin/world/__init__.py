"""State of all entities of a batch, and functions that query or change it."""
