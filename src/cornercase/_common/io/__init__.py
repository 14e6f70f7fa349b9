"""Files: atomic writing, locks, and XML elements that know which of their parts were read."""
