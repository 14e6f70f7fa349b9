"""Comparison of two versions of the system under test."""
