"""Compiled functions on tracks: poses, lengths and projections."""
