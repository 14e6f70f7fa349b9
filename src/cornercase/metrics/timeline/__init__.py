"""What happened when between the ego and another entity, and what earlier braking would have changed."""
