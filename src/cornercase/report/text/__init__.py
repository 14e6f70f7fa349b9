"""Texts of the report and of `show`."""
