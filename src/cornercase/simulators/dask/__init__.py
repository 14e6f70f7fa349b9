"""Simulators on a Dask cluster."""
