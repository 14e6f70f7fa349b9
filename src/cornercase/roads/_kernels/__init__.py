"""Compiled functions on roads."""
