"""The page of a study while it grows."""
