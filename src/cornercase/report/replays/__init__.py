"""Replays of single scenarios, as films and as pages."""
