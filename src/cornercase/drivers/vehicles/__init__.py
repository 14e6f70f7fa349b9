"""Vehicle models, which turn controls into motion."""
