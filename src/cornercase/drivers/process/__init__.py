"""Driving functions that run as external programs and exchange messages with cornercase."""
