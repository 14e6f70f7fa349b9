"""SUMO, which drives the ego."""
