"""Driving functions in a process of their own, which speaks a protocol."""
