"""Replays of single scenarios, as films or as pages."""
