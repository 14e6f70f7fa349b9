"""HTML page that compares two studies: results of an old and a new version of the tested function."""
