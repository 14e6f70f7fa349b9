"""Positions, trajectories, transitions and distances as scenario files define them."""
