"""Kernels for tracks (curves that entities follow): poses, lengths and projections."""
