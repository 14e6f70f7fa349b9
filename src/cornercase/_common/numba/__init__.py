"""Compile kernels (numba functions), cache their machine code on disk, and pass them arrays by address."""
