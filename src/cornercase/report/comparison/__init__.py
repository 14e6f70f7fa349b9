"""Page that compares two versions."""
