"""Geometry that several metrics share: boxes, tracks, gaps along the path of the ego, and compiled functions."""
