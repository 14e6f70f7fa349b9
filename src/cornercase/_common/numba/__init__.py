"""Kernels: compiled once, kept on disk, called with pointers."""
