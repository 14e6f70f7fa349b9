"""Selection of the scenarios to keep."""
