"""Read and write files: atomic writing, locks, and XML elements that record which parts were read."""
