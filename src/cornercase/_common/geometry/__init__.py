"""Oriented boxes in the plane, and fast search for overlaps among many boxes."""
