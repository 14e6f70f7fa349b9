"""Recover damaged studies: read the intact rows, and rebuild the study from them."""
