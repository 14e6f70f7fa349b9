"""Gaussian process that predicts the scores of scenarios that were not run."""
