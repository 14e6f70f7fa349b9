"""Texts: sources of messages, numbers, and names of foreign origin."""
