"""Ending of a recorded scenario for the ego, and numbers that describe how the ego drove."""
