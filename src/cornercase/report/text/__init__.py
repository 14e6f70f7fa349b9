"""Texts of the report page, and of the command ``cornercase show``."""
