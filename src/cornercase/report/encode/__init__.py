"""Encoding of recordings for the scripts of the report page."""
