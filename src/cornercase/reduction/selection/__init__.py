"""Selection of the scenarios of a reduced set."""
