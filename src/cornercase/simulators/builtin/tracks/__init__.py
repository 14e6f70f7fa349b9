"""Lanes and trajectories that entities follow."""
