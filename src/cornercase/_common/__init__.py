"""Helpers for all other packages of cornercase; they import none of those packages."""
