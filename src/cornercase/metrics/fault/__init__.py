"""Rules that find whose fault a collision is, from the recorded motion and the roads."""
