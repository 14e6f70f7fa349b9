"""Boxes in the plane, and which of many overlap."""
