"""Read, format and escape texts."""
