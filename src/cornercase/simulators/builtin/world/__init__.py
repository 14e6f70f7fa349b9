"""State of all entities in a batch of scenarios, and functions that query or change this state."""
