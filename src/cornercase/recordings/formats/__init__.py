"""Readers for recordings of other tools, one module per format."""
