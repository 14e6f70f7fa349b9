"""Compiled functions of drivers: what they see, predict and decide, and where points are along paths."""
