"""Kernels for tracks: poses, lengths and projections."""
