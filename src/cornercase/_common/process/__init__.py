"""Processes: signals, children, clusters, and what differs between platforms."""
