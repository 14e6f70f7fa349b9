"""Compiled steps of vehicle models."""
