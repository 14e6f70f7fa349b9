"""SUMO at the ego's wheel."""
