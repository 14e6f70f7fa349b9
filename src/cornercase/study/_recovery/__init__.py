"""Recovery of damaged studies: read intact rows, and rebuild the study from them."""
