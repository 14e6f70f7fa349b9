"""Helpers that all rooms share; imports none of them."""
