"""Sensors: models of what a driver knows about the true traffic."""
