"""What all rooms share; it imports none of them."""
