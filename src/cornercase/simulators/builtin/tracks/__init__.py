"""What entities move along."""
