"""Reference drivers that regulations define."""
