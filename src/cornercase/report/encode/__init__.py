"""Data of the page, as its scripts read them."""
