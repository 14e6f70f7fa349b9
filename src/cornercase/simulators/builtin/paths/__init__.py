"""Places, and paths between them."""
