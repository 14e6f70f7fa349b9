"""Who caused a collision, as far as the recorded motion and the roads show it."""
