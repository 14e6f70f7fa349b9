"""How a recorded scenario ended for the ego, and how the ego went."""
