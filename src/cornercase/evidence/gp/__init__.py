"""The Gaussian process that predicts scores between scenarios."""
