"""State of all entities of a batch, what is asked of it, and how it changes."""
