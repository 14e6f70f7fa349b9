"""Recordings of other tools, one module per file format."""
