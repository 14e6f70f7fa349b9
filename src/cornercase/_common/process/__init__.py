"""Signals, child processes, and Dask clusters for parallel work."""
