"""Positions, trajectories and distances as scenario files define them."""
