"""Signals, child processes and clusters."""
