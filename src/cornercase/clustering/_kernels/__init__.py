"""Compiled functions for clustering."""
