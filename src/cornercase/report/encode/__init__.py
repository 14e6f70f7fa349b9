"""Encode data for the scripts of the page."""
