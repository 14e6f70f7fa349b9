"""Live page of a study that is still growing."""
