"""Compiled parts of the built-in driver."""
