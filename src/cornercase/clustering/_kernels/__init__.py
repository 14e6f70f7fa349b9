"""Compiled distances of the clustering."""
