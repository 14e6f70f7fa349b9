"""Sensors, which stand between the true traffic and a driver."""
